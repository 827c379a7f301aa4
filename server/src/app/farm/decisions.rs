//! What people decide: approvals, rejections, resets. Every one is kept.

use lightshaft_api::farm::{
    Baseline, BaselineReset, CaseState, Decision, DecisionKind, DecisionNote, ImageVerdict, Run, RunCase, RunKind,
    RunSummary, TimeVerdict, check_name,
};
use lightshaft_api::job::Artifact;
use lightshaft_api::problem::FieldError;
use uuid::Uuid;

use super::super::App;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::store::{Acceptance, BaselineKey, CaseDecision, DecisionQuery, PageRequest, ReferenceTimes};

impl App {
    /// Decides of one case of a run.
    pub async fn decide(&self, run: &str, case: &str, kind: DecisionKind, note: &DecisionNote) -> ApiResult<Decision> {
        check(note)?;
        let run = self.decidable(run).await?;
        let found = run.cases.iter().find(|one| one.name == case);
        let found = found.ok_or_else(|| ApiError::not_found("case of this run", case))?;
        let decision = self.case_decision(&run.summary, found, kind, note)?;
        let kept = decision.decision.clone();
        self.keep_decisions(&[decision]).await?;
        Ok(kept)
    }

    /// Decides of many cases; of all that do not pass and are undecided when none is named. Nothing unless all can be.
    pub async fn decide_many(
        &self,
        run: &str,
        names: &[String],
        kind: DecisionKind,
        note: &DecisionNote,
    ) -> ApiResult<Vec<Decision>> {
        check(note)?;
        let run = self.decidable(run).await?;
        let mut errors = Vec::new();
        let mut chosen: Vec<&RunCase> = Vec::new();
        for (i, name) in names.iter().enumerate() {
            match run.cases.iter().find(|case| case.name == *name) {
                Some(case) if chosen.iter().any(|known| known.name == case.name) => {
                    errors.push(FieldError::new(format!("/cases/{i}"), "is named twice"));
                }
                Some(case) => chosen.push(case),
                None => errors.push(FieldError::new(format!("/cases/{i}"), format!("the run has no case `{name}`"))),
            }
        }
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        if names.is_empty() {
            let undecided = |case: &&RunCase| case.ok == Some(false) && case.decision.is_none();
            let can_be = |case: &&RunCase| kind == DecisionKind::Rejected || is_approvable(case);
            chosen.extend(run.cases.iter().filter(undecided).filter(can_be));
        }
        let decisions: Vec<CaseDecision> = chosen
            .into_iter()
            .map(|case| self.case_decision(&run.summary, case, kind, note))
            .collect::<ApiResult<_>>()?;
        self.keep_decisions(&decisions).await?;
        Ok(decisions.into_iter().map(|decided| decided.decision).collect())
    }

    async fn keep_decisions(&self, decisions: &[CaseDecision]) -> ApiResult<()> {
        {
            let _in_use = self.blob_use.read().await;
            self.store.decide(decisions, self.now()).await?;
        }
        for CaseDecision { decision, .. } in decisions {
            tracing::info!(decision.id = %decision.id, kind = decision.kind.as_str(), run.id = decision.run, "decided");
        }
        self.changed();
        Ok(())
    }

    async fn decidable(&self, run: &str) -> ApiResult<Run> {
        let run = self.run(run).await?;
        if run.summary.kind == RunKind::Calibration {
            return Err(ApiError::new(Code::WrongState, "a calibration has nothing to decide of"));
        }
        Ok(run)
    }

    fn case_decision(
        &self,
        run: &RunSummary,
        case: &RunCase,
        kind: DecisionKind,
        note: &DecisionNote,
    ) -> ApiResult<CaseDecision> {
        if case.state != CaseState::Finished {
            let detail = format!("case `{}` is {}: wait for its verdict", case.name, case.state.as_str());
            return Err(ApiError::new(Code::WrongState, detail));
        }
        if kind == DecisionKind::Approved && !is_approvable(case) {
            let detail = format!("case `{}` has no picture that could be approved", case.name);
            return Err(ApiError::new(Code::WrongState, detail));
        }
        let decision = Decision {
            id: Uuid::now_v7().to_string(),
            kind,
            who: note.who.clone(),
            why: note.why.clone(),
            at: self.timestamp()?,
            baseline: run.baseline.clone(),
            suite: run.suite_name.clone(),
            case: Some(case.name.clone()),
            device_class: case.device_class.clone(),
            run: Some(run.id.clone()),
            label: Some(run.label.clone()),
            pixels: case.image.as_ref().and_then(|image| image.pixels.clone()),
        };
        let accepted = if kind == DecisionKind::Approved { acceptance(run, case) } else { None };
        Ok(CaseDecision { decision, accepted, ok: kind == DecisionKind::Approved })
    }

    /// Takes back what was accepted. The decision that says so is kept, as are those before.
    pub async fn reset_baseline(&self, baseline: &str, reset: &BaselineReset) -> ApiResult<Decision> {
        let mut errors = reset.note().validate();
        errors.extend(check_name(&reset.suite, 100, "/suite"));
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        let known = self.store.baselines(baseline, &reset.suite).await?;
        let is_meant = |one: &Baseline| {
            reset.case.as_ref().is_none_or(|case| *case == one.case)
                && reset.device_class.as_ref().is_none_or(|class| *class == one.device_class)
        };
        if !known.iter().any(is_meant) {
            let detail = format!("baseline `{baseline}` holds nothing of that");
            return Err(ApiError::new(Code::NotFound, detail));
        }
        let decision = Decision {
            id: Uuid::now_v7().to_string(),
            kind: DecisionKind::Reset,
            who: reset.who.clone(),
            why: reset.why.clone(),
            at: self.timestamp()?,
            baseline: baseline.to_owned(),
            suite: reset.suite.clone(),
            case: reset.case.clone(),
            device_class: reset.device_class.clone(),
            run: None,
            label: None,
            pixels: None,
        };
        let freed = self.store.reset_baseline(&decision).await?;
        tracing::info!(decision.id = %decision.id, kind = "reset", "decided");
        self.discard(freed);
        self.changed();
        Ok(decision)
    }

    pub async fn baselines(&self, baseline: &str, suite: &str) -> ApiResult<Vec<Baseline>> {
        Ok(self.store.baselines(baseline, suite).await?)
    }

    pub async fn decisions(&self, query: &DecisionQuery, page: &PageRequest) -> ApiResult<Vec<Decision>> {
        Ok(self.store.decisions(query, page).await?)
    }
}

fn check(note: &DecisionNote) -> ApiResult<()> {
    let errors = note.validate();
    if errors.is_empty() { Ok(()) } else { Err(ApiError::fields(errors)) }
}

fn is_approvable(case: &RunCase) -> bool {
    case.image.as_ref().is_some_and(|image| image.verdict != ImageVerdict::Failed && image.pixels.is_some())
}

/// What an approval adds to the baseline.
fn acceptance(run: &RunSummary, case: &RunCase) -> Option<Acceptance> {
    let image = case.image.as_ref()?;
    let key = BaselineKey {
        baseline: run.baseline.clone(),
        suite_name: run.suite_name.clone(),
        case: case.name.clone(),
        device_class: case.device_class.clone()?,
    };
    let is_own = |file: &&Artifact| file.name.starts_with("image.") || file.name.starts_with("sample-");
    let times = case.time.as_ref().filter(|time| !time.samples_s.is_empty()).map(|time| ReferenceTimes {
        metric: time.metric,
        samples_s: time.samples_s.clone(),
        scene: case.scene.clone(),
        settings: case.settings.clone(),
        versions: case.versions.clone(),
        label: run.label.clone(),
    });
    let verdict = case.time.as_ref().and_then(|time| time.verdict);
    Some(Acceptance {
        key,
        pixels: image.pixels.clone()?,
        source: image.source?,
        files: case.artifacts.iter().filter(is_own).cloned().collect(),
        times,
        replaces_times: matches!(verdict, Some(TimeVerdict::Slower | TimeVerdict::Faster)),
    })
}
