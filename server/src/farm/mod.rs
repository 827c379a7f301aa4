//! The rules of the regression farm, without IO: when a picture is still right, when a time is still the same, and when a
//! slow-down is confirmed.
//!
//! ```text
//!   jobs of a case      picture against the accepted ones        ─► identical, within tolerance, changed, missing, failed
//!   (one worker,    ─►
//!    first discarded)   times against the accepted runs' times   ─► faster, same, too noisy to say
//!                                                                └► slower? ─► baseline and run in turns ─► slower (confirmed)
//!                                                                                                        └► same, too noisy
//! ```
//!
//! Nobody is told of a slow-down that the re-run does not show. Where the baseline's side cannot run any more, because
//! what rendered it is gone, a slow-down is only told when the samples leave no room for noise, and it is never called confirmed.

mod picture;
mod time;

pub use picture::{Decoded, JudgedPicture, Known, judge_picture};
pub use time::{CONFIRMATION_PAIRS, JudgedTime, confirm, judge_time, not_judged, spread, unconfirmable};

use lightshaft_api::farm::{ImageResult, TimeResult, TimeVerdict};

/// Whether a case with these results is well.
pub fn passes(image: &ImageResult, time: Option<&TimeResult>) -> bool {
    let slower = time.and_then(|time| time.verdict) == Some(TimeVerdict::Slower);
    image.verdict.passes() && !image.unsteady && !slower
}
