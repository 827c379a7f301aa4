//! Schedules: runs that begin by the clock.
//!
//! A schedule is first moved to its next time, then its run begins: of several services one begins it, and a service that is
//! killed in between skips it rather than beginning it twice. Times that passed meanwhile count once.

use croner::Cron;
use croner::parser::{CronParser, Seconds, Year};
use jiff::Timestamp;
use jiff::tz::TimeZone;
use lightshaft_api::farm::{NewRun, NewSchedule, Schedule, SchedulePatch};
use lightshaft_api::problem::FieldError;
use uuid::Uuid;

use super::super::App;
use crate::error::{ApiError, ApiResult};
use crate::queue::Millis;

/// Schedules that there may be.
const MOST_SCHEDULES: usize = 1000;

impl App {
    pub async fn create_schedule(&self, new: &NewSchedule) -> ApiResult<Schedule> {
        let mut errors = new.validate();
        let now = self.timestamp()?;
        let next_at = match read_pattern(&new.cron) {
            Ok(pattern) => next_after(&pattern, now),
            Err(error) => {
                errors.push(error);
                None
            }
        };
        for error in self.run_errors(&new.run).await? {
            let pointer = format!("/run{}", error.pointer);
            if !errors.iter().any(|known| known.pointer == pointer) {
                errors.push(FieldError::new(pointer, error.detail));
            }
        }
        if self.store.schedules(None).await?.len() >= MOST_SCHEDULES {
            errors.push(FieldError::new(
                "/name",
                format!("there are {MOST_SCHEDULES} schedules already: delete one first"),
            ));
        }
        if !errors.is_empty() {
            return Err(ApiError::fields(errors));
        }
        let schedule = Schedule {
            id: Uuid::now_v7().to_string(),
            name: new.name.clone(),
            cron: new.cron.clone(),
            run: new.run.clone(),
            paused: new.paused,
            next_at: next_at.filter(|_| !new.paused),
            begun_at: None,
            last_run: None,
            error: None,
            created_at: now,
        };
        if !self.store.add_schedule(&schedule).await? {
            return Err(ApiError::fields(vec![FieldError::new(
                "/name",
                "is the name of another schedule: delete that first",
            )]));
        }
        tracing::info!(schedule.id = %schedule.id, "schedule added");
        Ok(schedule)
    }

    pub async fn schedules(&self) -> ApiResult<Vec<Schedule>> {
        Ok(self.store.schedules(None).await?)
    }

    /// Pauses a schedule, or resumes it from now on. What is so already stays as it is, its next time too.
    pub async fn change_schedule(&self, id: &str, patch: &SchedulePatch) -> ApiResult<Schedule> {
        let known = self.schedule(id).await?;
        if known.paused == patch.paused {
            return Ok(known);
        }
        let next = if patch.paused { None } else { self.next_time(&known.cron)? };
        if !self.store.change_schedule(id, patch.paused, next.map(Timestamp::as_millisecond)).await? {
            return Err(ApiError::not_found("schedule", id));
        }
        tracing::info!(schedule.id = %id, paused = patch.paused, "schedule changed");
        self.schedule(id).await
    }

    async fn schedule(&self, id: &str) -> ApiResult<Schedule> {
        let all = self.store.schedules(None).await?;
        all.into_iter().find(|schedule| schedule.id == id).ok_or_else(|| ApiError::not_found("schedule", id))
    }

    /// The first time from now on of a pattern that is known to be one.
    fn next_time(&self, cron: &str) -> ApiResult<Option<Timestamp>> {
        let pattern = read_pattern(cron).map_err(|error| ApiError::internal(error.detail))?;
        Ok(next_after(&pattern, self.timestamp()?))
    }

    pub async fn delete_schedule(&self, id: &str) -> ApiResult<()> {
        let deleted = self.store.delete_schedule(id).await?;
        if deleted { Ok(()) } else { Err(ApiError::not_found("schedule", id)) }
    }

    /// Begins the runs that are due; returns how many.
    pub async fn begin_scheduled_runs(&self) -> ApiResult<usize> {
        let now = self.now();
        let mut begun = 0;
        for due in self.store.schedules(Some(now)).await? {
            let next = read_pattern(&due.cron).ok().and_then(|pattern| next_after(&pattern, self.timestamp().ok()?));
            let next_at: Option<Millis> = next.map(Timestamp::as_millisecond);
            if !self.store.take_schedule(&due, next_at, now).await? {
                continue;
            }
            let at = due.next_at.map(|at| at.strftime("%Y-%m-%dT%H:%MZ").to_string()).unwrap_or_default();
            let run = NewRun { label: format!("{} {at}", due.run.label), ..due.run.clone() };
            match self.create_run(&run, None).await {
                Ok((run, _)) => {
                    self.store.note_begun(&due.id, Ok(&run.summary.id)).await?;
                    begun += 1;
                }
                Err(error) => {
                    tracing::warn!(schedule.id = %due.id, error = %error, "a scheduled run could not begin");
                    self.store.note_begun(&due.id, Err(&error.to_string())).await?;
                }
            }
        }
        Ok(begun)
    }
}

/// Five fields, as crontab(5) has them.
fn read_pattern(text: &str) -> Result<Cron, FieldError> {
    let parser = CronParser::builder().seconds(Seconds::Disallowed).year(Year::Disallowed).build();
    parser.parse(text).map_err(|error| {
        let example = "expected minute, hour, day of the month, month and day of the week, such as `30 2 * * 1-5`";
        FieldError::new("/cron", format!("{error} ({example})"))
    })
}

/// The first time after this one, in UTC; `None` of a pattern such as the 30th of February.
fn next_after(pattern: &Cron, at: Timestamp) -> Option<Timestamp> {
    let next = pattern.find_next_occurrence(&at.to_zoned(TimeZone::UTC), false).ok()?;
    Some(next.timestamp())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn next(pattern: &str, after: &str) -> Option<String> {
        let next = next_after(&read_pattern(pattern).unwrap(), after.parse().unwrap());
        next.map(|at| at.to_string())
    }

    #[test]
    fn the_next_time_is_that_of_cron() {
        let monday = "2026-11-23T02:30:00Z";
        assert_eq!(next("30 2 * * *", monday).as_deref(), Some("2026-11-24T02:30:00Z"), "strictly after");
        assert_eq!(next("*/15 * * * *", monday).as_deref(), Some("2026-11-23T02:45:00Z"));
        assert_eq!(next("0 6 * * 1-5", "2026-11-27T06:00:00Z").as_deref(), Some("2026-11-30T06:00:00Z"), "a weekend");
        assert_eq!(next("0 0 29 2 *", monday).as_deref(), Some("2028-02-29T00:00:00Z"));
        assert_eq!(next("0 0 30 2 *", monday), None);
    }

    #[test]
    fn what_is_no_pattern_is_refused() {
        for wrong in ["", "* * * *", "60 * * * *", "* * * * * *", "every night", "* 25 * * *"] {
            assert_eq!(read_pattern(wrong).unwrap_err().pointer, "/cron", "{wrong}");
        }
    }
}
