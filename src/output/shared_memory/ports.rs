//! The ports of a publisher, and the translation of errors when opening them.

use std::fs;
use std::os::unix::fs::MetadataExt;

use iceoryx2::node::NodeCreationFailure;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::{Publisher as ScenePort, PublisherCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::{
    BackpressureStrategy, CallbackProgression, Config, MessagingPattern, Node, NodeBuilder,
    NodeState, PortFactory, ServiceName, SignalHandlingMode,
};
use iceoryx2::service::builder::event::{EventCreateError, EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use scene::Scene;

use super::place::{Kind, Place, user_name};
use super::presence::Presence;
use super::{
    HISTORY, Ipc, MAX_NODES, MAX_SUBSCRIBERS, PublishError, SUBSCRIBER_BORROWED, SUBSCRIBER_BUFFER,
};

/// The open ports in shared memory.
#[derive(Debug)]
pub(super) struct Ports {
    // Ports are dropped before their services, and these before the node.
    port: ScenePort<Ipc, Scene, ()>,
    /// `None` only if it could not be created again.
    notifier: Option<Notifier<Ipc>>,
    pub(super) service: publish_subscribe::PortFactory<Ipc, Scene, ()>,
    pub(super) event: event::PortFactory<Ipc>,
    pub(super) presence: Presence,
}

impl Ports {
    pub(super) fn open(place: &Place, name: ServiceName) -> Result<Self, PublishError> {
        let node = node(&place.config).map_err(|failure| match failure {
            NodeCreationFailure::InsufficientPermissions => denied(name, failure),
            other => open_error(name, other),
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
            .map_err(|error| scene_service_error(place, name, error))?;
        if place.kind == Kind::Default {
            refuse_foreign(place, name)?;
        }
        let port = service
            .publisher_builder()
            .max_loaned_samples(1)
            // With safe overflow, delivery fails only if a subscriber's queue is damaged; it is
            // then skipped.
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|error| match error {
                PublisherCreateError::ExceedsMaxSupportedPublishers => occupied(name, &service),
                other => open_error(name, other),
            })?;
        let event = event_service(place, &node, name)?;
        let notifier = event
            .notifier_builder()
            .create()
            .map_err(|error| open_error(name, error))?;
        place.admit();
        let numbers = [
            port.id().value(),
            service.unique_service_id().value(),
            event.unique_service_id().value(),
        ];
        let presence = Presence::of(&place.config, &name, node.id().value(), &numbers);
        Ok(Self {
            port,
            notifier: Some(notifier),
            service,
            event,
            presence,
        })
    }

    /// Returns the number of subscribers reached.
    pub(super) fn send(&self, scene: &Scene, now_ns: u64) -> Result<usize, PublishError> {
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
        sample.payload_mut().published_ns = now_ns;
        sample.send().map_err(|error| failed(error.to_string()))
    }

    /// Returns the number of subscribers woken.
    pub(super) fn wake(&mut self) -> Result<usize, PublishError> {
        if self.notifier.is_none() {
            self.notifier = self.event.notifier_builder().create().ok();
        }
        match self.notifier.as_ref().map(Notifier::notify) {
            Some(Ok(n_woken)) => Ok(n_woken),
            Some(Err(error)) => Err(self.not_woken(error)),
            None => Err(self.not_woken("there is no notifier")),
        }
    }

    pub(super) fn update_connections(&self) -> Result<(), PublishError> {
        self.port
            .update_connections()
            .map_err(|error| self.not_woken(error))
    }

    /// Makes iceoryx2 retry all subscribers to which it could not connect when they joined: it
    /// connects when a subscriber joins or leaves, and a notifier connects when it is created.
    pub(super) fn reconnect(&mut self) {
        self.notifier = None;
        self.notifier = self.event.notifier_builder().create().ok();
        if let Ok(_one_that_comes) = self.service.subscriber_builder().buffer_size(1).create() {
            // Retried later.
            let _ = self.port.update_connections();
        }
    }

    fn not_woken(&self, error: impl ToString) -> PublishError {
        PublishError::Wake {
            service: self.service.name().to_string(),
            reason: error.to_string(),
        }
    }
}

/// Files of another user are not used: only that user could read the scenes, and the files may be
/// malicious.
fn refuse_foreign(place: &Place, name: ServiceName) -> Result<(), PublishError> {
    let file = scene::static_file(&place.config, &name, MessagingPattern::PublishSubscribe);
    match fs::symlink_metadata(&file) {
        Ok(found) if found.uid() != rustix::process::geteuid().as_raw() => {
            Err(foreign(place, name))
        }
        _ => Ok(()),
    }
}

/// A node without configuration file and signal handlers. Creating it removes dead nodes.
pub(crate) fn node(config: &Config) -> Result<Node<Ipc>, NodeCreationFailure> {
    NodeBuilder::new()
        .config(config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create()
}

fn event_service(
    place: &Place,
    node: &Node<Ipc>,
    name: ServiceName,
) -> Result<event::PortFactory<Ipc>, PublishError> {
    node.service_builder(&name)
        .event()
        .max_notifiers(1)
        .max_listeners(MAX_SUBSCRIBERS)
        .max_nodes(MAX_NODES)
        .open_or_create()
        .map_err(|error| event_service_error(place, name, error))
}

/// The owner of the single publisher slot: a living process, or the remains of a dead one.
fn occupied(
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
    place: &Place,
    service: ServiceName,
    error: PublishSubscribeOpenOrCreateError,
) -> PublishError {
    use PublishSubscribeCreateError as Create;
    use PublishSubscribeOpenError as Open;
    use PublishSubscribeOpenOrCreateError as Both;
    match error {
        Both::PublishSubscribeOpenError(
            Open::IncompatibleTypes
            | Open::VersionMismatch
            | Open::ServiceInCorruptedState
            | Open::IncompatibleMessagingPattern
            | Open::IncompatibleOverflowBehavior
            | Open::DoesNotSupportRequestedMinBufferSize
            | Open::DoesNotSupportRequestedMinHistorySize
            | Open::DoesNotSupportRequestedMinSubscriberBorrowedSamples
            | Open::DoesNotSupportRequestedAmountOfPublishers
            | Open::DoesNotSupportRequestedAmountOfSubscribers
            | Open::DoesNotSupportRequestedAmountOfNodes,
        ) => incompatible(service, error),
        Both::PublishSubscribeOpenError(Open::HangsInCreation | Open::IsMarkedForDestruction)
        | Both::PublishSubscribeCreateError(
            Create::HangsInCreation
            | Create::IsBeingCreatedByAnotherInstance
            | Create::ServiceInCorruptedState,
        )
        | Both::SystemInFlux => blocked(service),
        Both::PublishSubscribeOpenError(Open::InsufficientPermissions)
        | Both::PublishSubscribeCreateError(Create::InsufficientPermissions) => {
            foreign(place, service)
        }
        other => open_error(service, other),
    }
}

fn event_service_error(
    place: &Place,
    service: ServiceName,
    error: EventOpenOrCreateError,
) -> PublishError {
    use EventCreateError as Create;
    use EventOpenError as Open;
    use EventOpenOrCreateError as Both;
    match error {
        Both::EventOpenError(
            Open::VersionMismatch
            | Open::ServiceInCorruptedState
            | Open::IncompatibleMessagingPattern
            | Open::DoesNotSupportRequestedAmountOfNotifiers
            | Open::DoesNotSupportRequestedAmountOfListeners
            | Open::DoesNotSupportRequestedMaxEventId
            | Open::DoesNotSupportRequestedAmountOfNodes,
        ) => incompatible(service, error),
        Both::EventOpenError(Open::HangsInCreation | Open::IsMarkedForDestruction)
        | Both::EventCreateError(
            Create::IsBeingCreatedByAnotherInstance | Create::ServiceInCorruptedState,
        )
        | Both::SystemInFlux => blocked(service),
        Both::EventOpenError(Open::InsufficientPermissions)
        | Both::EventCreateError(Create::InsufficientPermissions) => foreign(place, service),
        other => open_error(service, other),
    }
}

/// The difference is determined later.
fn incompatible(service: ServiceName, error: impl ToString) -> PublishError {
    PublishError::Incompatible {
        service: service.to_string(),
        reason: error.to_string(),
    }
}

fn blocked(service: ServiceName) -> PublishError {
    PublishError::Blocked {
        service: service.to_string(),
    }
}

pub(super) fn denied(service: ServiceName, reason: impl ToString) -> PublishError {
    PublishError::Denied {
        service: service.to_string(),
        reason: reason.to_string(),
    }
}

/// The service's files belong to another user.
fn foreign(place: &Place, service: ServiceName) -> PublishError {
    let file = scene::static_file(&place.config, &service, MessagingPattern::PublishSubscribe);
    let reason = match fs::symlink_metadata(&file) {
        Ok(found) => format!(
            "{} belongs to user {}",
            file.display(),
            user_name(found.uid())
        ),
        Err(_) => format!("files in {} belong to another user", place.root().display()),
    };
    denied(service, reason)
}

fn open_error(service: ServiceName, error: impl ToString) -> PublishError {
    PublishError::Open {
        service: service.to_string(),
        reason: error.to_string(),
    }
}
