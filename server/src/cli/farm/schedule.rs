//! `lightshaft farm schedule …`

use lightshaft_api::client::Client;
use lightshaft_api::farm::{NewSchedule, Schedule, SchedulePatch};

use super::run::Wanted;
use super::{Global, Result, output};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Begin a run of a suite by the clock.
    Add(Box<AddArgs>),
    /// List schedules, and how their last runs began.
    List,
    /// Have a schedule begin nothing until it is resumed.
    Pause {
        /// Its id.
        id: String,
    },
    /// Let a paused schedule begin runs again, from now on.
    Resume {
        /// Its id.
        id: String,
    },
    /// Delete a schedule; runs that it began stay.
    Delete {
        /// Its id.
        id: String,
    },
}

#[derive(Debug, clap::Args)]
pub(crate) struct AddArgs {
    /// Its name.
    name: String,
    /// Minute, hour, day of the month, month and day of the week, in UTC: '30 2 * * 1-5'.
    #[arg(long)]
    cron: String,
    /// Begin nothing until it is resumed.
    #[arg(long)]
    paused: bool,
    #[command(flatten)]
    wanted: Wanted,
}

pub(super) async fn run(command: &Command, client: &Client, global: &Global) -> Result<()> {
    match command {
        Command::Add(args) => {
            let run = args.wanted.bring(client).await?;
            let new = NewSchedule { name: args.name.clone(), cron: args.cron.clone(), run, paused: args.paused };
            show(client.create_schedule(&new).await?, global)
        }
        Command::List => {
            let schedules = client.schedules().await?.items;
            if global.json { output::print_json(&schedules) } else { print(&schedules) }
        }
        Command::Pause { id } => show(client.change_schedule(id, &SchedulePatch { paused: true }).await?, global),
        Command::Resume { id } => show(client.change_schedule(id, &SchedulePatch { paused: false }).await?, global),
        Command::Delete { id } => Ok(client.delete_schedule(id).await?),
    }
}

fn show(schedule: Schedule, global: &Global) -> Result<()> {
    if global.json { output::print_json(&schedule) } else { print(&[schedule]) }
}

fn print(schedules: &[Schedule]) -> Result<()> {
    let mut table = output::Table::new(&["id", "name", "cron", "next", "last run", "error"]);
    for schedule in schedules {
        table.row([
            schedule.id.clone(),
            schedule.name.clone(),
            schedule.cron.clone(),
            match schedule.next_at {
                Some(at) => format!("{at:.0}"),
                None if schedule.paused => "paused".to_owned(),
                None => "never".to_owned(),
            },
            schedule.last_run.clone().unwrap_or_default(),
            schedule.error.clone().unwrap_or_default(),
        ]);
    }
    table.print()
}
