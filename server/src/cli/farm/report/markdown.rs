//! Markdown, as pull requests show it: what needs a look first, the rest folded away.

use std::fmt::Write;

use lightshaft_api::farm::{Run, RunCase, RunState};

use crate::cli::farm::words::{self, Standing};

pub(super) fn report(run: &Run, page: &str) -> String {
    let summary = &run.summary;
    let counts = &summary.counts;
    let mut text = String::new();
    let _ = writeln!(text, "## {}: {}\n", escape(&summary.suite_name), headline(run));
    let _ = writeln!(
        text,
        "{} of {} cases are well at **{}**, against baseline **{}** ([the run]({page})).\n",
        counts.ok,
        counts.cases,
        escape(&summary.label),
        escape(&summary.baseline),
    );
    let (well, look): (Vec<&RunCase>, Vec<&RunCase>) =
        run.cases.iter().partition(|case| matches!(Standing::of(case), Standing::Passed | Standing::Approved));
    if !look.is_empty() {
        write_table(&mut text, &look);
    }
    if !well.is_empty() {
        let _ = writeln!(text, "<details><summary>{} cases are well</summary>\n", well.len());
        write_table(&mut text, &well);
        text.push_str("</details>\n");
    }
    text
}

/// What a run comes to, in a few words.
pub(super) fn headline(run: &Run) -> String {
    let counts = &run.summary.counts;
    match (run.summary.state, run.summary.ok) {
        (RunState::Running, _) => format!("{} of {} cases judged so far", counts.finished, counts.cases),
        (RunState::Cancelled, _) => "cancelled".to_owned(),
        (RunState::Finished, Some(true)) => "all is well".to_owned(),
        (RunState::Finished, _) => {
            let rejected = counts.rejected;
            let parts = [
                (counts.changed, "changed"),
                (counts.slower, "slower"),
                (counts.failed, "failed"),
                (counts.missing, "new"),
                (rejected, "rejected"),
            ];
            let said = parts.iter().filter(|(count, _)| *count > 0).map(|(count, word)| format!("{count} {word}"));
            said.collect::<Vec<_>>().join(", ")
        }
    }
}

fn write_table(text: &mut String, cases: &[&RunCase]) {
    text.push_str("| case | stands | picture | time | figures |\n|---|---|---|---|---|\n");
    for case in cases {
        let figures = [words::figures(case), words::decision(case)];
        let figures = figures.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ");
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} |",
            escape(&case.name),
            Standing::of(case).as_str(),
            escape(&words::image(case)),
            escape(&words::time(case)),
            escape(&figures),
        );
    }
    text.push('\n');
}

/// Plain text within a table: no markup, no HTML, no new column or row.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '<' => escaped.push_str("&lt;"),
            '&' => escaped.push_str("&amp;"),
            '|' | '`' | '*' | '_' | '[' | ']' | '\\' | '#' | '~' | '@' => {
                escaped.push('\\');
                escaped.push(c);
            }
            c if c.is_control() => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}
