//! Workers, and the worker's side of the lease protocol (see [`lease`](crate::lease)).

use std::time::Duration;

use reqwest::{Method, StatusCode};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Client, Result, segment};
use crate::lease::{
    Complete, Fail, Heartbeat, HeartbeatReply, Lease, LeaseClosed, LeaseRequest, LogAccepted, LogChunk, Release,
};
use crate::page::Page;
use crate::worker::{NewWorker, Registered, Worker};

/// How much longer than the long poll itself an answer may take.
const LEASE_GRACE: Duration = Duration::from_secs(15);

/// Longest wait for an answer to a heartbeat or a report, so that one lost packet does not cost the lease.
const REPORT_TIMEOUT: Duration = Duration::from_secs(15);

impl Client {
    pub async fn register_worker(&self, worker: &NewWorker) -> Result<Registered> {
        self.post_json("v1/workers", worker).await
    }

    pub async fn workers(&self) -> Result<Page<Worker>> {
        self.get_json("v1/workers", &()).await
    }

    pub async fn worker(&self, id: &str) -> Result<Worker> {
        self.get_json(&format!("v1/workers/{}", segment(id)), &()).await
    }

    /// Lets the worker finish what it has, and gives it nothing more.
    pub async fn drain_worker(&self, id: &str) -> Result<Worker> {
        self.post_json(&format!("v1/workers/{}/drain", segment(id)), &()).await
    }

    pub async fn undrain_worker(&self, id: &str) -> Result<Worker> {
        self.post_json(&format!("v1/workers/{}/undrain", segment(id)), &()).await
    }

    /// Says that the worker leaves: a poll of its that is waiting is answered now, and nothing is leased to it until it
    /// registers again.
    pub async fn part_worker(&self, id: &str) -> Result<()> {
        let request = self.request(Method::POST, &format!("v1/workers/{}/part", segment(id)));
        self.send(request.timeout(REPORT_TIMEOUT)).await.map(|_| ())
    }

    /// Forgets a worker; refused while it holds a lease.
    pub async fn remove_worker(&self, id: &str) -> Result<()> {
        self.send(self.request(Method::DELETE, &format!("v1/workers/{}", segment(id)))).await?;
        Ok(())
    }

    /// Waits up to `wait_s` for work; `None` when there was none.
    pub async fn lease(&self, request: &LeaseRequest) -> Result<Option<Lease>> {
        let timeout = Duration::from_secs(request.wait_s.into()) + LEASE_GRACE;
        let response = self.send(self.request(Method::POST, "v1/leases").json(request).timeout(timeout)).await?;
        if response.status() == StatusCode::NO_CONTENT {
            return Ok(None);
        }
        Self::read_json(response).await.map(Some)
    }

    pub async fn heartbeat(&self, token: &str, heartbeat: &Heartbeat) -> Result<HeartbeatReply> {
        self.report(token, "heartbeat", heartbeat).await
    }

    pub async fn append_log(&self, token: &str, chunk: &LogChunk) -> Result<LogAccepted> {
        self.report(token, "logs", chunk).await
    }

    pub async fn complete(&self, token: &str, complete: &Complete) -> Result<LeaseClosed> {
        self.report(token, "complete", complete).await
    }

    pub async fn fail(&self, token: &str, fail: &Fail) -> Result<LeaseClosed> {
        self.report(token, "fail", fail).await
    }

    pub async fn release(&self, token: &str, release: &Release) -> Result<LeaseClosed> {
        self.report(token, "release", release).await
    }

    async fn report<T: DeserializeOwned>(&self, token: &str, what: &str, body: &impl Serialize) -> Result<T> {
        let path = format!("v1/leases/{}/{what}", segment(token));
        self.send_json(self.request(Method::POST, &path).json(body).timeout(REPORT_TIMEOUT)).await
    }
}
