//! A run until its end, through restarts of the service.

use std::collections::BTreeSet;
use std::time::Duration;

use lightshaft_api::client::Client;
use lightshaft_api::farm::{CaseState, Run, RunCase, RunState};

use super::words::{self, Standing};
use super::{Result, output};
use crate::cli::progress::Progress;

const PAUSE: Duration = Duration::from_secs(1);
/// How often the service may be away in a row before following is given up.
const PATIENCE: u32 = 30;

/// Shows each case when it has its verdict, and answers the run when it has ended.
pub(super) async fn to_end(client: &Client, id: &str) -> Result<Run> {
    let progress = Progress::new();
    let mut told = BTreeSet::new();
    let mut failures = 0;
    loop {
        let mut pause = PAUSE;
        match client.run(id).await {
            Ok(run) => {
                failures = 0;
                let counts = &run.summary.counts;
                let message = format!("{} of {} cases", counts.finished, counts.cases);
                progress.set(f64::from(counts.finished) / f64::from(counts.cases.max(1)), message);
                for case in run.cases.iter().filter(|case| case.state == CaseState::Finished) {
                    if told.insert(case.name.clone()) {
                        progress.say(&line(case));
                    }
                }
                if run.summary.state != RunState::Running {
                    return Ok(run);
                }
            }
            Err(error) if error.is_transient() && failures < PATIENCE => {
                failures += 1;
                pause = pause.max(error.retry_after().unwrap_or_default());
            }
            Err(error) => return Err(error.into()),
        }
        tokio::time::sleep(pause).await;
    }
}

fn line(case: &RunCase) -> String {
    let said = [words::image(case), words::time(case)].into_iter().filter(|text| !text.is_empty());
    let text = format!("{:<8}  {}: {}", Standing::of(case).as_str(), case.name, said.collect::<Vec<_>>().join("; "));
    output::printable(&text)
}
