//! What a running task shows of itself: progress, and a preview that is uploaded beside the rendering.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lightshaft_api::client::Client;
use tokio::sync::Notify;

use super::log::LogBuffer;
use crate::executor::{Observer, Progress};

/// Shared between the rendering thread, the heartbeats and the uploads.
#[derive(Debug, Default)]
pub(super) struct Live {
    state: Mutex<State>,
    preview_waits: Notify,
    /// Whether the last heartbeat was not answered.
    service_is_away: AtomicBool,
    pub(super) log: LogBuffer,
}

#[derive(Debug, Default)]
struct State {
    progress: Progress,
    /// Rendered, not yet uploaded.
    preview: Option<Vec<u8>>,
    uploading: bool,
    /// Uploaded, not yet told.
    uploaded: Option<String>,
}

impl Live {
    /// For a heartbeat: the progress, and the blob of a preview that the service does not know yet.
    pub(super) fn snapshot(&self) -> (Progress, Option<String>) {
        let mut state = self.state();
        (state.progress, state.uploaded.take())
    }

    /// Notes whether the service answered a heartbeat.
    pub(super) fn note_answer(&self, answered: bool) {
        self.service_is_away.store(!answered, Ordering::Relaxed);
    }

    /// Whether the service answered the last heartbeat.
    pub(super) fn service_answers(&self) -> bool {
        !self.service_is_away.load(Ordering::Relaxed)
    }

    /// Uploads previews until dropped; one that does not arrive is no loss.
    pub(super) async fn upload_previews(self: Arc<Self>, client: Client) {
        loop {
            self.preview_waits.notified().await;
            let Some(png) = self.take_preview() else { continue };
            let hash = blake3::hash(&png).to_hex().to_string();
            let stored = client.put_blob(&hash, png).await;
            let mut state = self.state();
            state.uploading = false;
            if stored.is_ok() {
                state.uploaded = Some(hash);
            }
        }
    }

    fn take_preview(&self) -> Option<Vec<u8>> {
        let mut state = self.state();
        let png = state.preview.take()?;
        state.uploading = true;
        Some(png)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for Live {
    fn progress(&self, progress: Progress) {
        let mut state = self.state();
        let fraction = progress.fraction.max(state.progress.fraction);
        state.progress = Progress { fraction, spp: progress.spp.max(state.progress.spp), ..progress };
    }

    fn log(&self, line: String) {
        self.log.push(line);
    }

    fn wants_preview(&self) -> bool {
        let state = self.state();
        state.preview.is_none() && !state.uploading
    }

    fn preview(&self, png: Vec<u8>) {
        self.state().preview = Some(png);
        self.preview_waits.notify_one();
    }
}
