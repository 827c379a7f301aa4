//! `lightshaft completions SHELL`

use clap::CommandFactory;
use clap_complete::Shell;

use super::error::Result;
use super::{Cli, output};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[arg(value_enum)]
    shell: Shell,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "lightshaft", &mut script);
    output::print(&String::from_utf8_lossy(&script))
}
