//! The network between a worker and its service, with a knife and a brake.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, watch};
use tokio::task::JoinHandle;

/// Forwards TCP connections to a service until it is told not to. Ends when dropped.
pub struct Proxy {
    address: SocketAddr,
    wire: Arc<Wire>,
    accepting: JoinHandle<()>,
}

struct Wire {
    upstream: String,
    connected: watch::Sender<bool>,
    /// A request whose head contains this text is not forwarded.
    hold: Mutex<Option<String>>,
    held: Notify,
    released: Notify,
}

impl Proxy {
    /// # Panics
    /// When no port is free.
    pub async fn to(url: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("an address");
        let upstream = url.trim_start_matches("http://").to_owned();
        let (connected, _) = watch::channel(true);
        let wire = Arc::new(Wire {
            upstream,
            connected,
            hold: Mutex::default(),
            held: Notify::new(),
            released: Notify::new(),
        });
        let accepting = tokio::spawn({
            let wire = Arc::clone(&wire);
            async move {
                while let Ok((client, _)) = listener.accept().await {
                    tokio::spawn(Arc::clone(&wire).forward(client));
                }
            }
        });
        Self { address, wire, accepting }
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Breaks all connections, and every new one at once.
    pub fn cut(&self) {
        self.wire.connected.send_replace(false);
    }

    pub fn mend(&self) {
        self.wire.connected.send_replace(true);
    }

    /// From now on, requests whose first line begins so are not forwarded and not answered.
    pub fn hold_at(&self, request: &str) {
        *self.wire.hold.lock().unwrap_or_else(PoisonError::into_inner) = Some(request.to_owned());
    }

    /// Lets the request go that is held for the longest time.
    pub fn release(&self) {
        self.wire.released.notify_one();
    }

    /// Waits until a request was held.
    pub async fn held(&self) {
        self.wire.held.notified().await;
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.accepting.abort();
    }
}

impl Wire {
    async fn forward(self: Arc<Self>, client: TcpStream) {
        let mut connected = self.connected.subscribe();
        if !*connected.borrow_and_update() {
            return;
        }
        let Ok(server) = TcpStream::connect(&self.upstream).await else { return };
        let (from_client, to_client) = client.into_split();
        let (from_server, to_server) = server.into_split();
        tokio::select! {
            () = self.copy(from_client, to_server) => {}
            () = copy(from_server, to_client) => {}
            _ = connected.wait_for(|connected| !connected) => {}
        }
    }

    async fn copy(&self, mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin) {
        let mut buffer = vec![0; 64 << 10];
        while let Ok(count @ 1..) = from.read(&mut buffer).await {
            if self.is_held(&buffer[..count]) {
                self.held.notify_one();
                self.released.notified().await;
            }
            if to.write_all(&buffer[..count]).await.is_err() {
                return;
            }
        }
    }

    fn is_held(&self, bytes: &[u8]) -> bool {
        let hold = self.hold.lock().unwrap_or_else(PoisonError::into_inner);
        hold.as_ref().is_some_and(|hold| bytes.starts_with(hold.as_bytes()))
    }
}

async fn copy(mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin) {
    let _ = tokio::io::copy(&mut from, &mut to).await;
}
