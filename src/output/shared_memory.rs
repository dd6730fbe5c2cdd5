//! Publishes scenes to planners on the same machine through shared memory.
//!
//! An iceoryx2 publish-subscribe service transports each [`Scene`], and an event service of the
//! same name wakes waiting subscribers. A subscriber reads the scene in place: each additional
//! subscriber costs one pointer. Subscribers map scenes read-only.
//!
//! The publisher never waits for a subscriber. A slow one loses its oldest scenes (safe overflow);
//! a stopped or killed one fills only its own queue, and the remains of a killed one are removed
//! periodically. The last scene is kept for late joiners. A service has one publisher: a second one
//! is refused while the first is alive, and takes over the remains of a killed one, including its
//! subscribers. If the files are removed while in use, the service is opened again.
//!
//! `ports` holds the open ports, `place` determines where the files are and who has access,
//! `presence` checks whether they still exist, and `leftovers` finds the programs behind a service
//! that cannot be opened.
//!
//! Deliberately absent: the configuration files of iceoryx2, which it would search for in the
//! working directory (planners use `Config::default()` or `scene::config` as well), its signal
//! handlers (the program has its own) and its log (errors are returned).

mod error;
pub(crate) mod leftovers;
mod place;
mod ports;
mod presence;

pub use error::{NameError, PublishError};
pub(crate) use place::user_name;
pub(crate) use ports::node;

use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::prelude::{LogLevel, PortFactory, ServiceName, ipc_threadsafe, set_log_level};
use scene::{SERVICE_SUFFIX, Scene};

use crate::clock::monotonic_ns;
use crate::output::shared_memory::place::{Kind, Place};
use crate::output::shared_memory::ports::{Ports, denied};
use crate::output::shared_memory::presence::Found;

/// The variant of iceoryx2's inter-process services whose ports may move to another thread.
pub(crate) type Ipc = ipc_threadsafe::Service;

/// Maximum number of simultaneous subscribers of a service.
pub const MAX_SUBSCRIBERS: usize = 16;
/// Maximum number of scenes queued for one subscriber, which may choose fewer.
pub const SUBSCRIBER_BUFFER: usize = 4;
/// Maximum number of scenes that a subscriber borrows at a time.
const SUBSCRIBER_BORROWED: usize = 2;
/// Number of scenes kept for late joiners.
const HISTORY: usize = 1;
/// Maximum shared memory for the scenes of one service; usually only two or three scenes are in
/// use.
const SEGMENT_BYTES: u64 =
    ((MAX_SUBSCRIBERS * (SUBSCRIBER_BUFFER + SUBSCRIBER_BORROWED) + HISTORY + 1)
        * size_of::<Scene>()) as u64;
/// Folder of shared memory on Linux.
const SHARED_MEMORY: &str = "/dev/shm";
/// Maximum number of processes per service: subscribers, this publisher, and some for inspection or
/// cleanup.
const MAX_NODES: usize = MAX_SUBSCRIBERS + 4;

/// How long [`Publisher::open`] waits while another process is cleaning up after a dead publisher.
const TAKEOVER_TIMEOUT: Duration = Duration::from_secs(2);
/// Minimum time between two checks for dead subscribers. A check takes about 0.2 ms per subscriber.
const CLEANUP_PERIOD_NS: u64 = 5_000_000_000;
/// Time between two checks whether the files still exist. A check takes some microseconds.
const PRESENCE_PERIOD_NS: u64 = 1_000_000_000;
/// Initial delay before unreached subscribers are retried, in the place of a group; it doubles each
/// time.
const RETRY_NS: u64 = 100_000_000;
/// Maximum such delay.
const RETRY_MAX_NS: u64 = 60_000_000_000;

/// The single publisher of a service. Everything is removed from shared memory when it is dropped.
#[derive(Debug)]
pub struct Publisher {
    name: ServiceName,
    group: Option<String>,
    place: Place,
    remark: Option<String>,
    /// `None` while it cannot be opened again after its files were removed.
    ports: Option<Ports>,
    /// The last message about that.
    lost: Option<String>,
    /// `CLOCK_MONOTONIC` of the last check of the files.
    looked_ns: u64,
    /// `CLOCK_MONOTONIC` of the last check for dead subscribers.
    cleaned_ns: u64,
    /// `CLOCK_MONOTONIC` of the next retry of unreached subscribers, and the delay after that.
    retry: (u64, u64),
}

impl Publisher {
    /// Opens the services `name/scene` for publication, after removing the remains of killed
    /// processes. Subscribers are programs of the same user, and of root.
    ///
    /// # Errors
    ///
    /// All but those of [`Publisher::send`].
    pub fn open(name: &str) -> Result<Self, PublishError> {
        Self::open_for(name, None)
    }

    /// The same; with a `group`, its members can subscribe.
    ///
    /// # Errors
    ///
    /// All but those of [`Publisher::send`].
    pub fn open_for(name: &str, group: Option<&str>) -> Result<Self, PublishError> {
        let name = service_name(name)?;
        set_log_level(LogLevel::Fatal);
        let (place, ports, remark) = open_anywhere(name, group, TAKEOVER_TIMEOUT)?;
        let now_ns = monotonic_ns();
        Ok(Self {
            name,
            group: group.map(ToOwned::to_owned),
            place,
            remark,
            ports: Some(ports),
            lost: None,
            looked_ns: now_ns,
            cleaned_ns: now_ns,
            retry: (0, RETRY_NS),
        })
    }

    /// A remark for the user if the place of publication is not the default.
    #[must_use]
    pub fn remark(&self) -> Option<&str> {
        self.remark.as_deref()
    }

    /// Publishes `scene` with [`Scene::published_ns`] set to now, and wakes waiting subscribers.
    /// Does not block, except up to 30 ms for a new member of the group.
    ///
    /// # Errors
    ///
    /// [`PublishError::Send`] and [`PublishError::Wake`]; the next call may succeed.
    /// [`PublishError::PutBack`], [`PublishError::Removed`] and [`PublishError::Lost`] report
    /// missing files; the scene was published if possible.
    pub fn send(&mut self, scene: &Scene) -> Result<(), PublishError> {
        let now_ns = monotonic_ns();
        let presence = self.check_files(now_ns);
        let Some(ports) = &mut self.ports else {
            return presence;
        };
        let n_reached = ports.send(scene, now_ns)?;
        let n_woken = ports.wake()?;
        let n_subscribers = ports.service.dynamic_config().number_of_subscribers();
        let n_listeners = ports.event.dynamic_config().number_of_listeners();
        if n_woken < n_listeners {
            self.clear_away_dead_subscribers(now_ns);
        }
        if n_woken < n_listeners || n_reached < n_subscribers {
            self.try_unreached_again(now_ns);
        } else {
            self.retry = (now_ns + RETRY_NS, RETRY_NS);
        }
        presence
    }

    /// Sends the last scene to subscribers that joined after it, and wakes them. To be called
    /// periodically while no frame arrives; [`Publisher::send`] does the same. Subscribers that
    /// already have the scene are woken too, and find nothing new.
    ///
    /// # Errors
    ///
    /// Same as [`Publisher::send`].
    pub fn serve_late_joiners(&mut self) -> Result<(), PublishError> {
        let presence = self.check_files(monotonic_ns());
        let Some(ports) = &mut self.ports else {
            return presence;
        };
        ports.update_connections()?;
        let n_woken = ports.wake()?;
        if n_woken < ports.event.dynamic_config().number_of_listeners() {
            self.try_unreached_again(monotonic_ns());
        }
        presence
    }

    /// Opens the service again if its files were removed.
    fn check_files(&mut self, now_ns: u64) -> Result<(), PublishError> {
        if now_ns.saturating_sub(self.looked_ns) < PRESENCE_PERIOD_NS {
            return Ok(());
        }
        self.looked_ns = now_ns;
        let file = match self.ports.as_mut().map(|ports| ports.presence.look()) {
            Some(Found::Whole) => {
                self.place.admit();
                return Ok(());
            }
            Some(Found::PutBack(file)) => {
                return Err(PublishError::PutBack {
                    service: self.name.to_string(),
                    file: file.display().to_string(),
                });
            }
            Some(Found::Missing(file)) => file.display().to_string(),
            None => "shared memory".to_owned(),
        };
        // Closed first, because there can be only one publisher.
        self.ports = None;
        match open_anywhere(self.name, self.group.as_deref(), Duration::ZERO) {
            Ok((place, ports, remark)) => {
                (self.place, self.ports, self.remark) = (place, Some(ports), remark);
                self.lost = None;
                Err(PublishError::Removed {
                    service: self.name.to_string(),
                    file,
                })
            }
            Err(error) => {
                let reason = error.to_string();
                if self.lost.as_ref() == Some(&reason) {
                    return Ok(());
                }
                self.lost = Some(reason.clone());
                Err(PublishError::Lost { file, reason })
            }
        }
    }

    /// The socket of a killed process rejects the wake-up. The remains of a process that died
    /// without ever waiting are removed by the next one that joins.
    fn clear_away_dead_subscribers(&mut self, now_ns: u64) {
        if let Some(ports) = &self.ports
            && now_ns.saturating_sub(self.cleaned_ns) > CLEANUP_PERIOD_NS
        {
            self.cleaned_ns = now_ns;
            ports.service.try_cleanup_dead_nodes();
        }
    }

    /// A subscriber of another user becomes reachable when it has opened its files to the group.
    /// iceoryx2 tries only once, when it joins.
    fn try_unreached_again(&mut self, now_ns: u64) {
        let (due_ns, wait_ns) = self.retry;
        if self.place.kind != Kind::Group || now_ns < due_ns {
            return;
        }
        self.retry = (now_ns + wait_ns, (2 * wait_ns).min(RETRY_MAX_NS));
        if let Some(ports) = &mut self.ports {
            ports.reconnect();
            self.place.admit();
        }
    }
}

/// Opens the service at the default place, or else at this user's own place; with a group, at the
/// place of the group.
fn open_anywhere(
    name: ServiceName,
    group: Option<&str>,
    timeout: Duration,
) -> Result<(Place, Ports, Option<String>), PublishError> {
    if let Some(group) = group {
        let place = Place::of_group(group)?;
        place.sweep();
        let ports = open_with_timeout(&place, name, timeout)?;
        return Ok((place, ports, None));
    }
    let first = Place::default().and_then(|place| match open_with_timeout(&place, name, timeout) {
        Err(PublishError::Denied { reason, .. }) => Err(reason),
        result => Ok(result.map(|ports| (place, ports, None))),
    });
    let reason = match first {
        Ok(result) => return result,
        Err(reason) => reason,
    };
    let place = Place::of_user().map_err(|own| denied(name, format!("{reason}; {own}")))?;
    let ports = open_with_timeout(&place, name, timeout)?;
    let remark = format!(
        "{reason}; publishing in {} instead, where `overcam watch` and planners that use scene::config look, too",
        place.root().display()
    );
    Ok((place, ports, Some(remark)))
}

/// Waits while another process is cleaning up after a dead publisher, then does the cleanup itself.
fn open_with_timeout(
    place: &Place,
    name: ServiceName,
    timeout: Duration,
) -> Result<Ports, PublishError> {
    let deadline = Instant::now() + timeout;
    loop {
        check_room(name)?;
        let error = match Ports::open(place, name) {
            Err(PublishError::Blocked { .. }) if Instant::now() < deadline => {
                thread::sleep(Duration::from_millis(20));
                continue;
            }
            Err(error @ (PublishError::Blocked { .. } | PublishError::Incompatible { .. })) => {
                error
            }
            result => return result,
        };
        let Some(programs) = leftovers::programs(&place.config, &name) else {
            return Ports::open(place, name);
        };
        // A blocked service has no publisher and cannot get one, even if other programs have it
        // open.
        if programs.alive && matches!(error, PublishError::Incompatible { .. }) {
            return Err(PublishError::Incompatible {
                service: name.to_string(),
                reason: programs.reason,
            });
        }
        if let Err(files) = programs.remove(&place.config) {
            return Err(PublishError::Leftover {
                service: name.to_string(),
                reason: programs.reason,
                files,
            });
        }
        return Ports::open(place, name);
    }
}

/// The iceoryx2 name of the service `name`.
pub(crate) fn service_name(name: &str) -> Result<ServiceName, NameError> {
    let max = ServiceName::max_len() - SERVICE_SUFFIX.len();
    let owned = || name.to_owned();
    if name.is_empty() {
        return Err(NameError::Empty);
    }
    if let Some(character) = name.chars().find(|c| !c.is_ascii_graphic()) {
        return Err(NameError::Character {
            name: owned(),
            character,
        });
    }
    if name.len() > max {
        return Err(NameError::TooLong {
            name: owned(),
            length: name.len(),
            max,
        });
    }
    ServiceName::new(&format!("{name}{SERVICE_SUFFIX}"))
        .map_err(|_| NameError::Reserved { name: owned() })
}

/// Memory is allocated only when a scene is written into it, and then a shortage causes a fatal
/// signal instead of an error.
fn check_room(service: ServiceName) -> Result<(), PublishError> {
    let Ok(space) = rustix::fs::statvfs(SHARED_MEMORY) else {
        return Ok(()); // errors are reported when the service is opened
    };
    let free_bytes = space.f_bavail.saturating_mul(space.f_frsize);
    if free_bytes >= SEGMENT_BYTES {
        return Ok(());
    }
    Err(PublishError::NoRoom {
        service: service.to_string(),
        needed_kib: SEGMENT_BYTES.div_ceil(1024),
        free_kib: free_bytes / 1024,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_cannot_name_a_service_are_refused_in_one_line() {
        let longest = "n".repeat(ServiceName::max_len() - SERVICE_SUFFIX.len());
        for possible in ["overcam", "hall-2/north", longest.as_str()] {
            let name = service_name(possible).expect("it is possible");
            assert_eq!(name.as_str(), format!("{possible}/scene"));
        }
        let too_long = format!("{longest}n");
        for (name, reason) in [
            ("", "is empty"),
            ("two words", "contains ' '"),
            ("caf\u{e9}", "contains 'é'"),
            ("line\nfeed", "contains '\\n'"),
            ("iox2://overcam", "reserved by iceoryx2"),
            (too_long.as_str(), "has 250 characters: at most 249"),
        ] {
            let error = Publisher::open(name)
                .expect_err("it is not possible")
                .to_string();
            assert!(error.contains(reason), "{error}");
            assert!(!error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn a_publisher_may_move_to_another_thread() {
        fn movable<T: Send>() {}
        movable::<Publisher>();
    }
}
