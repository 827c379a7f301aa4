//! `lightshaft openapi`

use super::error::Result;
use super::output;

pub(crate) fn run() -> Result<()> {
    output::print_json(&lightshaft_server::routes::document())
}
