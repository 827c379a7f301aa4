//! The `lightshaft` binary: the service, the worker, and the commands that talk to them.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
