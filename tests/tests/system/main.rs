//! Lightshaft from the outside: the real binary, HTTP, signals, a browser.

mod bad_requests;
mod bad_uploads;
mod benchmarks;
mod bisect;
mod command_line;
mod comparisons;
mod dashboard;
mod devices;
mod documentation;
mod failures;
mod farm;
mod farm_disturbed;
mod farm_noise;
mod farm_sampled;
mod farm_suite;
mod farm_webhooks;
mod http;
mod jobs;
mod outages;
mod scenes;
