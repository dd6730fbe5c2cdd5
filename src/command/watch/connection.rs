//! A subscription that waits for its service, and finds it again.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use iceoryx2::port::ReceiveError;
use iceoryx2::port::listener::{Listener, ListenerCreateError, ListenerWaitError};
use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::{Config, Node, ServiceName};
use iceoryx2::sample::Sample;
use iceoryx2::service::builder::event::EventOpenError;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::publish_subscribe;
use scene::Scene;

use super::{POLL_PERIOD, WatchError};
use crate::output::shared_memory::{self, Ipc, leftovers};
use crate::run::status::log;

/// The service to watch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wanted<'a> {
    pub(super) name: ServiceName,
    /// The group for which it is published; `None`: by this user.
    pub(super) group: Option<&'a str>,
}

impl Wanted<'_> {
    /// Where to look now; `None` while the place does not exist.
    fn config(&self) -> Result<Option<Config>, WatchError> {
        let group = match self.group {
            Some(group) => Some(group.to_owned()),
            None => std::env::var(scene::GROUP_VARIABLE)
                .ok()
                .filter(|group| !group.is_empty()),
        };
        let config = match &group {
            Some(group) => scene::group_config(group),
            None => scene::config(&self.name),
        };
        match config {
            Ok(config) => Ok(Some(config)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(WatchError::Group {
                group: group.unwrap_or_default(),
                reason: error.to_string(),
            }),
        }
    }
}

/// A subscription and its event listener.
pub(super) struct Connection<'a> {
    wanted: Wanted<'a>,
    config: Config,
    // Ports are dropped before their service.
    subscriber: Subscriber<Ipc, Scene, ()>,
    listener: Listener<Ipc>,
    pub(super) service: publish_subscribe::PortFactory<Ipc, Scene, ()>,
}

impl<'a> Connection<'a> {
    /// `None` if stopped before the service existed.
    pub(super) fn wait_for(
        wanted: Wanted<'a>,
        stop: &AtomicBool,
    ) -> Result<Option<Self>, WatchError> {
        let mut node: Option<Node<Ipc>> = None;
        let mut is_announced = false;
        while !stop.load(Ordering::Relaxed) {
            // The place may be unknown until it exists.
            if let Some(config) = wanted.config()? {
                if node.as_ref().is_none_or(|node| *node.config() != config) {
                    let opened = shared_memory::node(&config);
                    node = Some(opened.map_err(|failure| denied(wanted.name, failure))?);
                }
                if let Some(node) = &node
                    && let Some(connection) = Self::try_open(node, wanted)?
                {
                    return Ok(Some(connection));
                }
            }
            if !is_announced {
                log(format_args!(
                    "watch: waiting for service `{}`: no overcam publishes it yet",
                    wanted.name
                ));
                is_announced = true;
            }
            std::thread::sleep(POLL_PERIOD);
        }
        Ok(None)
    }

    /// Closes the connection and waits for the service again. `None` if stopped before it existed.
    pub(super) fn again(self, stop: &AtomicBool) -> Result<Option<Self>, WatchError> {
        let wanted = self.wanted;
        drop(self);
        Self::wait_for(wanted, stop)
    }

    /// Whether new subscribers would find the same service.
    pub(super) fn is_current(&self) -> bool {
        scene::is_current(&self.service, &self.config)
    }

    /// `None` if the service does not exist, or is just being created or removed.
    fn try_open(node: &Node<Ipc>, wanted: Wanted<'a>) -> Result<Option<Self>, WatchError> {
        use PublishSubscribeOpenError as Open;
        let name = wanted.name;
        let service = match node
            .service_builder(&name)
            .publish_subscribe::<Scene>()
            .open()
        {
            Ok(service) => service,
            Err(
                Open::DoesNotExist
                | Open::IsMarkedForDestruction
                | Open::HangsInCreation
                | Open::Interrupt,
            ) => return Ok(None),
            Err(
                Open::IncompatibleTypes | Open::VersionMismatch | Open::ServiceInCorruptedState,
            ) => {
                // The remains of dead programs are removed by the next overcam.
                return match leftovers::programs(node.config(), &name) {
                    Some(programs) if programs.alive => Err(WatchError::Incompatible {
                        service: name.to_string(),
                        reason: programs.reason,
                    }),
                    _ => Ok(None),
                };
            }
            Err(error @ Open::InsufficientPermissions) => return Err(denied(name, error)),
            Err(Open::ExceedsMaxNumberOfNodes) => {
                return Err(WatchError::Full {
                    service: name.to_string(),
                });
            }
            Err(other) => return Err(read_error(name, other)),
        };
        let event = match node.service_builder(&name).event().open() {
            Ok(event) => event,
            Err(
                EventOpenError::DoesNotExist
                | EventOpenError::IsMarkedForDestruction
                | EventOpenError::HangsInCreation
                | EventOpenError::Interrupt,
            ) => return Ok(None),
            Err(EventOpenError::ExceedsMaxNumberOfNodes) => {
                return Err(WatchError::Full {
                    service: name.to_string(),
                });
            }
            Err(other) => return Err(read_error(name, other)),
        };
        // The listener comes first, so that no scene can arrive between the two without a wake-up.
        let listener = event.listener_builder().create();
        let listener = listener.map_err(|error| match error {
            ListenerCreateError::ExceedsMaxSupportedListeners => WatchError::Full {
                service: name.to_string(),
            },
            other => read_error(name, other),
        })?;
        let subscriber = service.subscriber_builder().create();
        let subscriber = subscriber.map_err(|error| match error {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => WatchError::Full {
                service: name.to_string(),
            },
            other => read_error(name, other),
        })?;
        // If this fails, the service admits it at the next scene.
        let _ = scene::admit(node.config());
        Ok(Some(Self {
            wanted,
            config: node.config().clone(),
            subscriber,
            listener,
            service,
        }))
    }

    pub(super) fn receive(&self) -> Result<Option<Sample<Ipc, Scene, ()>>, WatchError> {
        match self.subscriber.receive() {
            Ok(sample) => Ok(sample),
            // A publisher was killed while connecting or disconnecting; its successor gets another
            // connection.
            Err(ReceiveError::ConnectionFailure(_)) => Ok(None),
            Err(other) => Err(read_error(self.wanted.name, other)),
        }
    }

    pub(super) fn wait(&self) -> Result<(), WatchError> {
        match self.listener.timed_wait(|_| {}, POLL_PERIOD) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(other) => Err(read_error(self.wanted.name, other)),
        }
    }
}

fn denied(service: ServiceName, error: impl ToString) -> WatchError {
    WatchError::Denied {
        service: service.to_string(),
        reason: error.to_string(),
    }
}

fn read_error(service: ServiceName, error: impl ToString) -> WatchError {
    WatchError::Read {
        service: service.to_string(),
        reason: error.to_string(),
    }
}
