//! Blobs that nothing names any more: pictures in progress that have been followed by others, parts of a merged picture,
//! what a deleted job or scene left.
//!
//! A blob gets its bytes first and its name later, and whoever puts it may have found it there already. So none is
//! deleted that was put within the last minutes, whoever else has let go of it.

use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};

use futures::{StreamExt, TryStreamExt};
use jiff::Timestamp;

use super::App;
use super::leases::timestamp;
use crate::error::{ApiError, ApiResult};
use crate::queue::Millis;

/// How long a blob that nothing names yet is left alone: far longer than from a worker's first upload to its report.
const NAMING_GRACE_MS: Millis = 300_000;

/// Blobs that somebody has let go of, to be looked at. Lost at a restart: the sweep finds them all the same, later.
#[derive(Debug, Default)]
pub(super) struct Discarded(Mutex<HashSet<String>>);

impl Discarded {
    fn add(&self, hashes: impl IntoIterator<Item = String>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(hashes);
    }

    fn take(&self) -> HashSet<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

enum Fate {
    Deleted,
    InUse,
    /// Put too recently to tell.
    Fresh,
}

impl App {
    /// Lets go of blobs; [`Self::delete_discarded`] deletes those that nothing else names.
    pub(super) fn discard(&self, hashes: impl IntoIterator<Item = String>) {
        self.discarded.add(hashes);
    }

    /// Deletes what was discarded and is neither named nor new; returns how many. New ones are looked at again.
    pub async fn delete_discarded(&self) -> ApiResult<u64> {
        let mut waiting = self.discarded.take();
        if waiting.is_empty() {
            return Ok(0);
        }
        let before = timestamp(self.now() - NAMING_GRACE_MS)?;
        let mut deleted = 0;
        for hash in waiting.clone() {
            match self.delete_unused(&hash, before).await {
                Ok(Fate::Fresh) => continue,
                Ok(Fate::InUse) => {}
                Ok(Fate::Deleted) => deleted += 1,
                Err(error) => {
                    self.discarded.add(waiting);
                    return Err(error);
                }
            }
            waiting.remove(&hash);
        }
        self.discarded.add(waiting);
        Ok(deleted)
    }

    /// The same after a change that stands whatever comes of this.
    pub(super) async fn clean_up(&self) {
        if let Err(error) = self.delete_discarded().await {
            tracing::error!(error = %error, "unused blobs were not deleted; they will be, later");
        }
    }

    /// Deletes blobs that were last put before a time and that nothing names; returns how many.
    pub async fn sweep_blobs(&self, before: Timestamp) -> ApiResult<u64> {
        let mut old = self.blobs.older_than(before).map_err(ApiError::internal);
        let mut deleted = 0;
        while let Some(hash) = old.next().await {
            if matches!(self.delete_unused(&hash?, before).await?, Fate::Deleted) {
                deleted += 1;
            }
        }
        Ok(deleted)
    }

    /// The reader's look first: most blobs are in use, and need not stop everyone else.
    async fn delete_unused(&self, hash: &str, before: Timestamp) -> ApiResult<Fate> {
        if self.is_blob_named(hash).await? {
            return Ok(Fate::InUse);
        }
        let _alone = self.blob_use.write().await;
        let put_at = self.blobs.put_at(hash).await.map_err(ApiError::internal)?;
        if put_at.is_some_and(|put_at| put_at >= before) {
            return Ok(Fate::Fresh);
        }
        if self.is_blob_named(hash).await? {
            return Ok(Fate::InUse);
        }
        self.blobs.delete(hash).await.map_err(ApiError::internal)?;
        Ok(Fate::Deleted)
    }

    async fn is_blob_named(&self, hash: &str) -> ApiResult<bool> {
        Ok(self.live.shows(hash) || self.store.is_blob_used(hash).await?)
    }
}
