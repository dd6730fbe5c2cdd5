//! Scenes out to planners on the same machine, through shared memory.
//!
//! An iceoryx2 publish-subscribe service carries each [`Scene`] and an event service of the same name wakes those who wait for
//! it. A subscriber reads the scene in place: what it costs to have many subscribers is one pointer each.
//!
//! The publisher never waits for a subscriber. A slow one loses its oldest scenes (safe overflow), a stopped or killed one
//! fills its own queue and nobody else's, and what a killed one leaves behind is removed now and then. The last scene is kept
//! for late joiners. One service has one publisher: a second one is refused while the first lives, and takes over what a
//! killed first one left behind, subscribers included.
//!
//! Deliberately absent: the configuration files of iceoryx2, which it would look for in the working directory (planners use
//! `Config::default()` as well), its signal handlers (the program has its own) and its log (errors are returned).

use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::node::NodeCreationFailure;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::{Publisher as ScenePort, PublisherCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::{
    BackpressureStrategy, CallbackProgression, Config, LogLevel, Node, NodeBuilder, NodeState,
    PortFactory, ServiceName, SignalHandlingMode, ipc_threadsafe, set_log_level,
};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use scene::{SERVICE_SUFFIX, Scene};

/// The variant of iceoryx2's inter-process services whose ports may move to another thread.
pub(crate) type Ipc = ipc_threadsafe::Service;

/// Most subscribers of one service at a time.
pub const MAX_SUBSCRIBERS: usize = 16;
/// Most scenes that wait for one subscriber; it chooses how many of them it wants.
pub const SUBSCRIBER_BUFFER: usize = 4;
/// Most scenes that one subscriber looks at a time.
const SUBSCRIBER_BORROWED: usize = 2;
/// Scenes kept for late joiners.
const HISTORY: usize = 1;
/// Shared memory that the scenes of one service take at most; usually it is two or three scenes.
const SEGMENT_BYTES: u64 =
    ((MAX_SUBSCRIBERS * (SUBSCRIBER_BUFFER + SUBSCRIBER_BORROWED) + HISTORY + 1)
        * size_of::<Scene>()) as u64;
/// Where Linux keeps shared memory.
const SHARED_MEMORY: &str = "/dev/shm";
/// Most processes on one service: subscribers, this publisher, and some that come to look or to clean up.
const MAX_NODES: usize = MAX_SUBSCRIBERS + 4;

/// How long [`Publisher::open`] waits while another process still clears away a dead publisher.
const TAKEOVER_PATIENCE: Duration = Duration::from_secs(2);
/// Shortest time between two looks for subscribers that died. A look takes about 0.2 ms a subscriber.
const CLEANUP_PERIOD_NS: u64 = 5_000_000_000;

/// Why a name cannot name a service.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// There is nothing in front of the suffix.
    #[error("the name of a service is empty: give one with --service NAME")]
    Empty,
    /// The name does not fit.
    #[error("service name `{name}` has {length} characters: at most {max} are possible")]
    TooLong {
        /// The name.
        name: String,
        /// Its length in bytes.
        length: usize,
        /// The greatest possible length in bytes.
        max: usize,
    },
    /// The name holds something other than visible ASCII characters.
    #[error(
        "service name {name:?} contains {character:?}: use letters, digits and punctuation of ASCII, without spaces"
    )]
    Character {
        /// The name.
        name: String,
        /// The first character that is not possible.
        character: char,
    },
    /// The middleware keeps such names for itself.
    #[error(
        "service name `{name}` is reserved by iceoryx2: choose one that does not start with `iox2://`"
    )]
    Reserved {
        /// The name.
        name: String,
    },
}

/// Why scenes cannot be published. None of them is a reason to stop processing frames.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The name cannot name a service.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Another process publishes on this service.
    #[error(
        "service `{service}` is already published by process {pid}: stop that one, or choose another name with --service NAME"
    )]
    Taken {
        /// The service.
        service: String,
        /// The process that publishes.
        pid: i32,
    },
    /// A publisher died and could not be cleared away.
    #[error(
        "service `{service}` is blocked by a publisher that died: try again, or choose another name with --service NAME"
    )]
    Blocked {
        /// The service.
        service: String,
    },
    /// Subscribers, or another version of the program, keep the service open with another layout or other capacities.
    #[error(
        "service `{service}` is in use by programs of another version ({reason}): stop them, or choose another name with --service NAME"
    )]
    Incompatible {
        /// The service.
        service: String,
        /// What differs, in the middleware's words.
        reason: String,
    },
    /// The files of the middleware cannot be written, as a rule because they belong to another user.
    #[error(
        "service `{service}` cannot be opened ({reason}): do /tmp/iceoryx2 and /dev/shm/iox2_* belong to another user? run as that user, or with --no-publish"
    )]
    Denied {
        /// The service.
        service: String,
        /// What failed, in the middleware's words.
        reason: String,
    },
    /// There is too little shared memory left. Going on would end the program in the middle of a scene.
    #[error(
        "service `{service}` needs {needed_kib} KiB in {SHARED_MEMORY} and {free_kib} KiB are free: enlarge it (docker: --shm-size), or use --no-publish"
    )]
    NoRoom {
        /// The service.
        service: String,
        /// What the service may take.
        needed_kib: u64,
        /// What is left.
        free_kib: u64,
    },
    /// The service could not be opened for another reason.
    #[error("service `{service}` cannot be opened ({reason}): --no-publish does without it")]
    Open {
        /// The service.
        service: String,
        /// What failed, in the middleware's words.
        reason: String,
    },
    /// One scene did not reach all subscribers; the next one may.
    #[error("scene {sequence} was not published on `{service}` ({reason})")]
    Send {
        /// The service.
        service: String,
        /// Number of the scene's frame.
        sequence: u64,
        /// What failed, in the middleware's words.
        reason: String,
    },
    /// Subscribers could not be connected or woken; they see the next scene later, or not at all.
    #[error("subscribers of `{service}` were not woken ({reason})")]
    Wake {
        /// The service.
        service: String,
        /// What failed, in the middleware's words.
        reason: String,
    },
}

/// The one publisher of a service. Everything is removed from shared memory when it is dropped.
#[derive(Debug)]
pub struct Publisher {
    // Ports go before the services they belong to, and these before the node.
    port: ScenePort<Ipc, Scene, ()>,
    notifier: Notifier<Ipc>,
    service: publish_subscribe::PortFactory<Ipc, Scene, ()>,
    event: event::PortFactory<Ipc>,
    /// `CLOCK_MONOTONIC` of the last look for dead subscribers.
    cleaned_ns: u64,
}

impl Publisher {
    /// Opens the services `name/scene` for publication, and first clears away what killed processes left behind.
    ///
    /// # Errors
    ///
    /// All but [`PublishError::Send`] and [`PublishError::Wake`].
    pub fn open(name: &str) -> Result<Self, PublishError> {
        let service = service_name(name)?;
        set_log_level(LogLevel::Fatal);
        let deadline = Instant::now() + TAKEOVER_PATIENCE;
        loop {
            check_room(service)?;
            match Self::try_open(service) {
                Err(PublishError::Blocked { .. }) if Instant::now() < deadline => {
                    thread::sleep(Duration::from_millis(20));
                }
                result => return result,
            }
        }
    }

    fn try_open(name: ServiceName) -> Result<Self, PublishError> {
        let node = node().map_err(|failure| PublishError::Denied {
            service: name.to_string(),
            reason: failure.to_string(),
        })?;
        let service = node
            .service_builder(&name)
            .publish_subscribe::<Scene>()
            .max_publishers(1)
            .max_subscribers(MAX_SUBSCRIBERS)
            .subscriber_max_buffer_size(SUBSCRIBER_BUFFER)
            .subscriber_max_borrowed_samples(SUBSCRIBER_BORROWED)
            .history_size(HISTORY)
            .enable_safe_overflow(true)
            .max_nodes(MAX_NODES)
            .open_or_create()
            .map_err(|error| scene_service_error(name, error))?;
        let port = service
            .publisher_builder()
            .max_loaned_samples(1)
            // With safe overflow nothing is ever undeliverable, unless a subscriber's queue is damaged: pass over it then.
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|error| match error {
                PublisherCreateError::ExceedsMaxSupportedPublishers => taken(name, &service),
                other => open_error(name, other),
            })?;
        let event = event_service(&node, name)?;
        let notifier = event
            .notifier_builder()
            .create()
            .map_err(|error| open_error(name, error))?;
        Ok(Self {
            port,
            notifier,
            service,
            event,
            cleaned_ns: monotonic_ns(),
        })
    }

    /// Publishes `scene` with [`Scene::published_ns`] set to now, and wakes those who wait for it. Waits for nobody.
    ///
    /// # Errors
    ///
    /// [`PublishError::Send`] and [`PublishError::Wake`]; the next call may succeed.
    pub fn send(&mut self, scene: &Scene) -> Result<(), PublishError> {
        let failed = |reason: String| PublishError::Send {
            service: self.service.name().to_string(),
            sequence: scene.sequence,
            reason,
        };
        let loan = self
            .port
            .loan_uninit()
            .map_err(|error| failed(error.to_string()))?;
        let mut sample = loan.write_payload(*scene);
        let now_ns = monotonic_ns();
        sample.payload_mut().published_ns = now_ns;
        sample.send().map_err(|error| failed(error.to_string()))?;
        let n_woken = self.wake()?;
        self.clear_away_dead_subscribers(n_woken, now_ns);
        Ok(())
    }

    /// Hands the last scene to subscribers that came after it, and wakes them. To be called now and then while no frame
    /// comes; [`Publisher::send`] does the same. Those who have the scene already are woken too, and find nothing new.
    ///
    /// # Errors
    ///
    /// [`PublishError::Wake`]; the next call may succeed.
    pub fn serve_late_joiners(&self) -> Result<(), PublishError> {
        self.port
            .update_connections()
            .map_err(|error| self.not_woken(error))?;
        self.wake()?;
        Ok(())
    }

    /// Returns how many were woken.
    fn wake(&self) -> Result<usize, PublishError> {
        self.notifier
            .notify()
            .map_err(|error| self.not_woken(error))
    }

    /// Looks only where fewer were woken than registered, as a killed process's socket refuses its wake-up. What a process
    /// leaves that died without ever waiting is cleared away by the next one that comes.
    fn clear_away_dead_subscribers(&mut self, n_woken: usize, now_ns: u64) {
        let n_registered = self.event.dynamic_config().number_of_listeners();
        if n_woken < n_registered && now_ns.saturating_sub(self.cleaned_ns) > CLEANUP_PERIOD_NS {
            self.cleaned_ns = now_ns;
            self.service.try_cleanup_dead_nodes();
        }
    }

    fn not_woken(&self, error: impl ToString) -> PublishError {
        PublishError::Wake {
            service: self.service.name().to_string(),
            reason: error.to_string(),
        }
    }
}

/// `CLOCK_MONOTONIC`, the clock of the cameras' time stamps, which all processes of this machine share.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// The name under which `name` is known to iceoryx2.
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

/// A participant that follows no configuration file and leaves signals alone. Creating it clears away dead ones.
pub(crate) fn node() -> Result<Node<Ipc>, NodeCreationFailure> {
    NodeBuilder::new()
        .config(&Config::default())
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()
}

/// Memory is only taken when a scene is written into it, and there is no way to refuse it then but a fatal signal.
fn check_room(service: ServiceName) -> Result<(), PublishError> {
    let Ok(space) = rustix::fs::statvfs(SHARED_MEMORY) else {
        return Ok(()); // what is wrong with it will be said when the service is opened
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

fn event_service(
    node: &Node<Ipc>,
    name: ServiceName,
) -> Result<event::PortFactory<Ipc>, PublishError> {
    node.service_builder(&name)
        .event()
        .max_notifiers(1)
        .max_listeners(MAX_SUBSCRIBERS)
        .max_nodes(MAX_NODES)
        .open_or_create()
        .map_err(|error| open_error(name, error))
}

/// Who has the place of the one publisher: a living process, or the remains of a dead one.
fn taken(
    name: ServiceName,
    service: &publish_subscribe::PortFactory<Ipc, Scene, ()>,
) -> PublishError {
    let mut owner = None;
    service.dynamic_config().list_publishers(|publisher| {
        owner = Some(publisher.node_id);
        CallbackProgression::Stop
    });
    let mut alive = false;
    let listed = service.nodes(|state| {
        alive |= Some(*state.node_id()) == owner && !matches!(state, NodeState::Dead(_));
        CallbackProgression::Continue
    });
    match owner.map(|node| node.pid::<Ipc>()) {
        Some(Ok(pid)) if alive && listed.is_ok() => PublishError::Taken {
            service: name.to_string(),
            pid: pid.value(),
        },
        _ => PublishError::Blocked {
            service: name.to_string(),
        },
    }
}

fn scene_service_error(
    service: ServiceName,
    error: PublishSubscribeOpenOrCreateError,
) -> PublishError {
    use PublishSubscribeOpenError as Open;
    match error {
        PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
            reason @ (Open::IncompatibleTypes
            | Open::VersionMismatch
            | Open::IncompatibleOverflowBehavior
            | Open::DoesNotSupportRequestedMinBufferSize
            | Open::DoesNotSupportRequestedMinHistorySize
            | Open::DoesNotSupportRequestedAmountOfPublishers
            | Open::DoesNotSupportRequestedAmountOfSubscribers
            | Open::DoesNotSupportRequestedAmountOfNodes),
        ) => PublishError::Incompatible {
            service: service.to_string(),
            reason: format!("{reason:?}"),
        },
        PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
            reason @ Open::InsufficientPermissions,
        ) => PublishError::Denied {
            service: service.to_string(),
            reason: reason.to_string(),
        },
        other => open_error(service, other),
    }
}

fn open_error(service: ServiceName, error: impl ToString) -> PublishError {
    PublishError::Open {
        service: service.to_string(),
        reason: error.to_string(),
    }
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
