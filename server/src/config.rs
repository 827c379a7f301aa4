//! What a service can be told at its start.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Settings of one service process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// Address to listen on; port 0 picks a free one.
    pub listen: SocketAddr,
    /// Folder of the database, the blobs and the logs; made when it is not there.
    pub data_dir: PathBuf,
    /// Listen on an address that other machines reach, although the service has no access control.
    pub insecure_local: bool,
    /// How long a worker may be silent before its task goes to another. Heartbeats come at a third of it, or twice a second.
    pub lease_ttl: Duration,
    /// How long a job waits for a worker with the device that it demands while there are workers without. Then it fails.
    pub device_grace: Duration,
    /// Render a small picture of every new scene.
    pub thumbnails: bool,
    /// How long finished jobs are kept with what they left; for good when `None`.
    pub keep_jobs: Option<Duration>,
    /// How many runs of each suite of the farm are kept; all when `None`. What was accepted stays whatever this is.
    pub keep_runs: Option<u32>,
    /// Send messages of webhooks to loopback, private and link-local addresses, too.
    pub webhook_allow_private: bool,
    /// How long requests in progress may take to end after a shutdown was asked for.
    pub shutdown_deadline: Duration,
    pub limits: Limits,
}

/// Budgets that keep one request from taking the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of a JSON body.
    pub json_bytes: u64,
    /// Bytes of a worker's report of success, which names every mesh of the scene.
    pub report_bytes: u64,
    /// Different meshes of a scene.
    pub scene_meshes: usize,
    /// Bytes of a scene's upload, all files together.
    pub scene_bytes: u64,
    /// Files of a multipart upload.
    pub scene_files: usize,
    /// Bytes of any other blob.
    pub blob_bytes: u64,
    /// Scenes imported at the same time; further uploads wait their turn.
    pub concurrent_imports: usize,
    /// Bytes of a picture that is read or uploaded to be compared.
    pub picture_bytes: u64,
    /// Pixels of a picture whose layers are read.
    pub picture_pixels: u64,
    /// Pixels of pictures that are compared, which takes some 300 bytes each.
    pub compare_pixels: u64,
    /// Pictures decoded or compared at the same time; further requests wait their turn.
    pub concurrent_pictures: usize,
    /// What one scene may hold: triangles, texture pixels, instances and so on.
    pub import: lightshaft_engine::scene::Limits,
    /// Longest pause between two pieces of an upload.
    pub upload_stall: Duration,
}

impl Config {
    pub fn new(listen: SocketAddr, data_dir: PathBuf) -> Self {
        Self {
            listen,
            data_dir,
            insecure_local: false,
            lease_ttl: Duration::from_secs(60),
            device_grace: Duration::from_secs(10),
            thumbnails: true,
            keep_jobs: None,
            keep_runs: None,
            webhook_allow_private: false,
            shutdown_deadline: Duration::from_secs(10),
            limits: Limits::default(),
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            json_bytes: 1 << 20,
            report_bytes: 64 << 20,
            scene_meshes: 65_536,
            scene_bytes: 2 << 30,
            scene_files: 4096,
            blob_bytes: 4 << 30,
            concurrent_imports: 2,
            picture_bytes: 1 << 30,
            picture_pixels: 1 << 26,
            compare_pixels: 1 << 24,
            concurrent_pictures: 2,
            import: lightshaft_engine::scene::Limits::default(),
            upload_stall: Duration::from_secs(30),
        }
    }
}
