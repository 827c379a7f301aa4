//! What is said of a case, for people: the same words on the terminal and in every report.

use lightshaft_api::farm::{CaseState, ConfirmationState, DecisionKind, RunCase, TimeVerdict};

/// How a case stands, decisions included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Standing {
    Failed,
    Rejected,
    /// No verdict yet, or never: the run was cancelled.
    Open,
    Approved,
    Passed,
}

impl Standing {
    pub(super) fn of(case: &RunCase) -> Self {
        match (case.ok, case.decision.as_ref().map(|decision| decision.kind)) {
            (_, Some(DecisionKind::Rejected)) => Self::Rejected,
            (Some(true), Some(DecisionKind::Approved)) => Self::Approved,
            (Some(true), _) => Self::Passed,
            (Some(false), _) => Self::Failed,
            (None, _) => Self::Open,
        }
    }

    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Failed => "failed",
            Self::Rejected => "rejected",
            Self::Open => "open",
            Self::Approved => "approved",
            Self::Passed => "passed",
        }
    }
}

/// Such as `changed: mean FLIP is 0.1134, and may be 0.01`.
pub(super) fn image(case: &RunCase) -> String {
    let Some(image) = &case.image else { return state(case.state).to_owned() };
    let mut text = image.verdict.as_str().replace('_', " ");
    if let Some(reason) = &image.reason {
        text.push_str(": ");
        text.push_str(reason);
    }
    if image.unsteady {
        text.push_str(" (repetitions differ)");
    }
    text
}

/// Such as `slower, 1.31 times (1.25 to 1.38), confirmed`.
pub(super) fn time(case: &RunCase) -> String {
    let Some(time) = &case.time else { return String::new() };
    let Some(verdict) = time.verdict else { return "not judged".to_owned() };
    let mut text = verdict.as_str().replace('_', " ");
    if let Some(ratio) = &time.ratio {
        text.push_str(&format!(", {:.2} times ({:.2} to {:.2})", ratio.value, ratio.low, ratio.high));
    }
    text.push_str(match time.confirmation.state {
        ConfirmationState::NotNeeded => "",
        ConfirmationState::Running => ", being confirmed",
        ConfirmationState::Confirmed => ", confirmed",
        ConfirmationState::Refuted => ", refuted",
        ConfirmationState::Impossible if verdict == TimeVerdict::Slower => ", could not be confirmed",
        ConfirmationState::Impossible => "",
    });
    text
}

/// Figures of the picture, in one line; empty where there is nothing to say.
pub(super) fn figures(case: &RunCase) -> String {
    let Some(image) = &case.image else { return String::new() };
    let mut parts = Vec::new();
    if let Some(figures) = &image.figures {
        parts.push(format!("FLIP {:.4} (99 %: {:.4})", figures.flip_mean, figures.flip_p99));
        parts.push(format!("RMSE {:.5}", figures.rmse));
        parts.push(format!("SSIM {:.4}", figures.ssim));
        let share = 100.0 * figures.differing_pixels as f64 / figures.pixels.max(1) as f64;
        parts.push(format!("{} of {} pixels differ ({share:.2} %)", figures.differing_pixels, figures.pixels));
        if let Some([x, y]) = figures.max_at {
            parts.push(format!("most at {x}, {y}: {:.4}", figures.max_difference));
        }
    }
    if let Some(test) = &image.z_test {
        let (pixels, blocks) = (test.failing_pixels, test.failing_blocks());
        parts.push(format!("Z-test: {pixels} of {} pixels and {blocks} blocks fail", test.pixels));
    }
    parts.join(", ")
}

/// Who decided what and why; empty without a decision.
pub(super) fn decision(case: &RunCase) -> String {
    case.decision.as_ref().map_or_else(String::new, |decision| {
        let why = if decision.why.is_empty() { String::new() } else { format!(": {}", decision.why) };
        format!("{} by {}{why}", decision.kind.as_str(), decision.who)
    })
}

/// Seconds as people read them.
pub(super) fn seconds(seconds: f64) -> String {
    match seconds {
        s if s >= 100.0 => format!("{s:.0} s"),
        s if s >= 1.0 => format!("{s:.2} s"),
        s => format!("{:.1} ms", s * 1e3),
    }
}

fn state(state: CaseState) -> &'static str {
    match state {
        CaseState::Rendering => "rendering",
        CaseState::Confirming => "confirming a slow-down",
        CaseState::Finished => "without a verdict",
        CaseState::Cancelled => "cancelled",
    }
}
