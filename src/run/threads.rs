//! Constants shared by the threads.

use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context;

/// Total number of slots. With 8, a slow process stage and a stalled recorder together lost frames;
/// with 16 they lost none.
pub(crate) const SLOTS: usize = 16;

/// Maximum wait before checking the stop flag and late subscribers.
pub(crate) const POLL: Duration = Duration::from_millis(100);

pub(crate) fn spawn<T: Send + 'static>(
    name: &str,
    body: impl FnOnce() -> T + Send + 'static,
) -> anyhow::Result<JoinHandle<T>> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(body)
        .with_context(|| format!("the {name} thread cannot start"))
}

pub(crate) fn joined<T>(thread: JoinHandle<T>, name: &str) -> anyhow::Result<T> {
    thread.join().map_err(|_| {
        anyhow::anyhow!("the {name} thread ended by a fault of the program; please report it")
    })
}
