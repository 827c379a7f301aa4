//! JUnit XML, as CI servers read it: a test for each case.

use std::fmt::Write;

use lightshaft_api::farm::{ImageVerdict, Run, RunCase};

use crate::cli::farm::words::{self, Standing};

pub(super) fn report(run: &Run, page: &str) -> String {
    let summary = &run.summary;
    let count = |is: fn(&RunCase) -> bool| run.cases.iter().filter(|case| is(case)).count();
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let total_s: f64 = run.cases.iter().map(duration_s).sum();
    let _ = writeln!(
        xml,
        "<testsuites>\n  <testsuite name=\"{}\" tests=\"{}\" failures=\"{}\" errors=\"{}\" skipped=\"{}\" time=\"{total_s:.6}\" \
         timestamp=\"{:.0}\">",
        escape(&summary.suite_name),
        run.cases.len(),
        count(is_failure),
        count(is_error),
        count(is_open),
        summary.created_at,
    );
    let properties = [("label", &summary.label), ("baseline", &summary.baseline), ("run", &summary.id)];
    let labels = summary.labels.iter().map(|(name, value)| (name.as_str(), value));
    xml.push_str("    <properties>\n");
    for (name, value) in properties.into_iter().chain(labels) {
        let _ = writeln!(xml, "      <property name=\"{}\" value=\"{}\"/>", escape(name), escape(value));
    }
    let _ = writeln!(xml, "      <property name=\"page\" value=\"{}\"/>\n    </properties>", escape(page));
    for case in &run.cases {
        write_case(&mut xml, case, &summary.suite_name);
    }
    xml.push_str("  </testsuite>\n</testsuites>\n");
    xml
}

fn write_case(xml: &mut String, case: &RunCase, suite: &str) {
    let _ = write!(
        xml,
        "    <testcase classname=\"{}\" name=\"{}\" time=\"{:.6}\"",
        escape(suite),
        escape(&case.name),
        duration_s(case)
    );
    let element = match case {
        case if is_error(case) => "error",
        case if is_failure(case) => "failure",
        case if is_open(case) => {
            let _ = writeln!(xml, "><skipped message=\"{}\"/></testcase>", escape(&words::image(case)));
            return;
        }
        _ => {
            xml.push_str("/>\n");
            return;
        }
    };
    let lines = [words::image(case), words::time(case), words::figures(case), words::decision(case)];
    let said: Vec<String> = lines.into_iter().filter(|line| !line.is_empty()).collect();
    let message = escape(&said[..said.len().min(2)].join("; "));
    let _ = writeln!(
        xml,
        ">\n      <{element} message=\"{message}\">{}</{element}>\n    </testcase>",
        escape(&said.join("\n"))
    );
}

fn is_error(case: &RunCase) -> bool {
    Standing::of(case) == Standing::Failed
        && case.image.as_ref().is_some_and(|image| image.verdict == ImageVerdict::Failed)
}

fn is_failure(case: &RunCase) -> bool {
    matches!(Standing::of(case), Standing::Failed | Standing::Rejected) && !is_error(case)
}

fn is_open(case: &RunCase) -> bool {
    Standing::of(case) == Standing::Open
}

/// All repetitions together.
fn duration_s(case: &RunCase) -> f64 {
    case.time.as_ref().map_or(0.0, |time| time.samples_s.iter().sum())
}

/// Text of XML 1.0, which has no place for most control characters.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\n' => escaped.push_str("&#10;"),
            '\t' => escaped.push('\t'),
            c if c.is_control() || c == '\u{fffe}' || c == '\u{ffff}' => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}
