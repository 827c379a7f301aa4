//! Who may tell a worker to leave: signals, and the process that started it.

use std::io::Read;
use std::time::Duration;

use tokio::sync::mpsc::{self, UnboundedReceiver, UnboundedSender};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// Finish the task in hand first.
    Drain,
    /// Give the task in hand back.
    Leave,
}

pub(super) struct Orders {
    orders: UnboundedReceiver<Order>,
    /// Keeps the channel open.
    _sender: UnboundedSender<Order>,
}

impl Orders {
    /// SIGTERM drains, and after `drain_timeout` orders to leave; SIGINT orders to leave, as does the end of standard
    /// input when `supervised`.
    pub(super) fn new(supervised: bool, drain_timeout: Duration) -> Self {
        let (sender, orders) = mpsc::unbounded_channel();
        tokio::spawn(interrupt(sender.clone()));
        #[cfg(unix)]
        tokio::spawn(terminate(sender.clone(), drain_timeout));
        #[cfg(not(unix))]
        let _ = drain_timeout;
        if supervised {
            watch_parent(sender.clone());
        }
        Self { orders, _sender: sender }
    }

    pub(super) async fn next(&mut self) -> Order {
        match self.orders.recv().await {
            Some(order) => order,
            None => std::future::pending().await,
        }
    }
}

async fn interrupt(orders: UnboundedSender<Order>) {
    while tokio::signal::ctrl_c().await.is_ok() {
        if orders.send(Order::Leave).is_err() {
            return;
        }
    }
}

#[cfg(unix)]
async fn terminate(orders: UnboundedSender<Order>, drain_timeout: Duration) {
    let signal = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate());
    let Ok(mut signal) = signal else { return };
    if signal.recv().await.is_some() && orders.send(Order::Drain).is_ok() {
        tokio::select! {
            () = tokio::time::sleep(drain_timeout) => {}
            _ = signal.recv() => {}
        }
        let _ = orders.send(Order::Leave);
    }
}

/// The parent holds the other end of standard input and never writes: its end closes when the parent closes it or dies,
/// however it dies. A thread of its own, because a read cannot be cancelled.
fn watch_parent(orders: UnboundedSender<Order>) {
    std::thread::spawn(move || {
        let mut buffer = [0; 64];
        while std::io::stdin().read(&mut buffer).is_ok_and(|read| read > 0) {}
        let _ = orders.send(Order::Leave);
    });
}
