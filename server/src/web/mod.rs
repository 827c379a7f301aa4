//! What every route shares: the request's context, extractors that answer with problems, and files with ranges.

pub mod body;
pub mod context;
pub mod file;
pub mod observe;
pub mod page;
pub mod read_on;
