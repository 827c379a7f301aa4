//! Whole tasks through the executor, on the CPU device and generated scenes.

mod common;
mod layers;
mod line_spaces;
mod policies;
mod tasks;
