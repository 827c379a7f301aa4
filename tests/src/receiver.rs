//! Somebody who is told things: an HTTP server that takes every POST, and remembers it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

/// A request that was taken.
#[derive(Clone, Debug)]
pub struct Told {
    /// Names in lower case.
    pub headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl Told {
    /// A header, or nothing.
    pub fn header(&self, name: &str) -> &str {
        self.headers.iter().find(|(known, _)| known == name).map_or("", |(_, value)| value)
    }
}

pub struct Receiver {
    address: SocketAddr,
    told: Arc<Mutex<Vec<Told>>>,
}

impl Receiver {
    /// Listens at an address; port 0 picks one.
    ///
    /// # Panics
    /// When the address is in use.
    pub fn start(address: SocketAddr) -> Self {
        let listener = TcpListener::bind(address).expect("the address is free");
        let receiver =
            Self { address: listener.local_addr().expect("an address"), told: Arc::new(Mutex::new(Vec::new())) };
        let told = Arc::clone(&receiver.told);
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                // Whoever breaks off is heard again.
                if let Ok(request) = take(stream) {
                    told.lock().unwrap_or_else(PoisonError::into_inner).push(request);
                }
            }
        });
        receiver
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Everything so far.
    pub fn told(&self) -> Vec<Told> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn take(stream: TcpStream) -> std::io::Result<Told> {
    let mut reader = BufReader::new(&stream);
    let mut headers = Vec::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        match line.trim_end().split_once(": ") {
            Some((name, value)) => headers.push((name.to_lowercase(), value.to_owned())),
            None if line.trim_end().is_empty() => break,
            // The request line.
            None => {}
        }
    }
    let mut told = Told { headers, body: Vec::new() };
    let length = told.header("content-length").parse().map_err(std::io::Error::other)?;
    reader.take(length).read_to_end(&mut told.body)?;
    (&stream).write_all(b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n")?;
    Ok(told)
}
