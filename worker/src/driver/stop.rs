//! The wish that a task ends before its end, as seen by the threads that render and by the calls that wait.

use std::sync::atomic::{AtomicBool, Ordering};

use tokio_util::sync::CancellationToken;

#[derive(Debug, Default)]
pub(super) struct Stop {
    flag: AtomicBool,
    token: CancellationToken,
}

impl Stop {
    pub(super) fn ask(&self) {
        self.flag.store(true, Ordering::Relaxed);
        self.token.cancel();
    }

    /// For those who look now and then.
    pub(super) fn flag(&self) -> &AtomicBool {
        &self.flag
    }

    /// Ends once the task is to stop.
    pub(super) async fn asked(&self) {
        self.token.cancelled().await;
    }
}
