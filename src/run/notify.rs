//! Notifications to systemd: start, watchdog and status.
//!
//! The protocol of `sd_notify(3)`: datagrams to the socket named in the environment. Without one,
//! as when a user starts the program, nothing is sent. Nothing here blocks, and errors are ignored:
//! systemd detects missing messages itself.

use std::ffi::OsString;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Minimum time between two status messages.
const STATUS_PERIOD: Duration = Duration::from_secs(10);

/// The connection to systemd, if there is one.
#[derive(Debug, Default)]
pub(crate) struct Notify {
    socket: Option<UnixDatagram>,
    /// Watchdog interval.
    period: Option<Duration>,
    beat: Option<Instant>,
    status_sent: Option<Instant>,
}

impl Notify {
    /// Reads `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID` from the environment.
    pub(crate) fn from_environment() -> Self {
        let number = |name| std::env::var(name).ok()?.parse::<u64>().ok();
        let for_us = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        let limit_us = number("WATCHDOG_USEC").filter(|&limit| limit > 0 && for_us);
        Self {
            socket: std::env::var_os("NOTIFY_SOCKET").and_then(|path| connect(path).ok()),
            // Half of the limit is usual; a quarter allows for a slow frame.
            period: limit_us.map(|limit| Duration::from_micros(limit / 4)),
            ..Self::default()
        }
    }

    /// The run has started.
    pub(crate) fn started(&mut self) {
        self.send("READY=1");
    }

    /// The run is about to end, by itself or on request.
    pub(crate) fn stopping(&mut self) {
        self.send("STOPPING=1");
    }

    /// Sends a watchdog message. To be called often; `status` is called only if a status message is
    /// due.
    pub(crate) fn alive(&mut self, status: impl FnOnce() -> String) {
        if self.socket.is_none() {
            return;
        }
        let now = Instant::now();
        let due = |last: Option<Instant>, period| last.is_none_or(|last| now - last >= period);
        if let Some(period) = self.period
            && due(self.beat, period)
        {
            self.beat = Some(now);
            self.send("WATCHDOG=1");
        }
        if due(self.status_sent, STATUS_PERIOD) {
            self.status_sent = Some(now);
            self.send(&format!("STATUS={}", status()));
        }
    }

    fn send(&mut self, word: &str) {
        if let Some(socket) = &self.socket {
            let _ = socket.send(word.as_bytes());
        }
    }
}

/// A path, or a name in the abstract namespace after an `@`.
fn connect(address: OsString) -> io::Result<UnixDatagram> {
    let address = match address.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name)?,
        None => SocketAddr::from_pathname(&address)?,
    };
    let socket = UnixDatagram::unbound()?;
    socket.connect_addr(&address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn received(socket: &UnixDatagram) -> Vec<String> {
        socket.set_nonblocking(true).expect("set");
        let mut words = Vec::new();
        let mut buffer = [0; 256];
        while let Ok(length) = socket.recv(&mut buffer) {
            words.push(String::from_utf8_lossy(&buffer[..length]).into_owned());
        }
        words
    }

    #[test]
    fn systemd_is_notified_at_a_path_and_at_an_abstract_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("notify");
        let name = format!("overcam-test-{}", std::process::id());
        let abstract_name = SocketAddr::from_abstract_name(&name).expect("a name");
        for (socket, address) in [
            (
                UnixDatagram::bind(&path).expect("bound"),
                path.into_os_string(),
            ),
            (
                UnixDatagram::bind_addr(&abstract_name).expect("bound"),
                format!("@{name}").into(),
            ),
        ] {
            let mut notify = Notify {
                socket: connect(address).ok(),
                period: Some(Duration::ZERO),
                ..Notify::default()
            };
            notify.started();
            notify.alive(|| "3 frames".to_owned());
            notify.alive(|| unreachable!("it was told just now"));
            notify.stopping();
            assert_eq!(
                received(&socket),
                [
                    "READY=1",
                    "WATCHDOG=1",
                    "STATUS=3 frames",
                    "WATCHDOG=1",
                    "STOPPING=1"
                ]
            );
        }
    }

    #[test]
    fn nothing_is_sent_without_a_listener() {
        assert!(connect("/no/such/socket".into()).is_err());
        let mut notify = Notify::default();
        notify.started();
        notify.alive(|| unreachable!("nobody asks"));
    }
}
