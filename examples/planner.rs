//! A planner's side of overcam: waits for each scene and prints where every marked robot is, and
//! where it will be half a second from now, when a command may take effect.
//!
//! ```text
//! cargo run --example planner -- [NAME [SCENES]]
//! ```
//!
//! `NAME` is that of `overcam --service NAME`. The program ends after `SCENES` scenes. If overcam
//! runs with `--group GROUP`, set `OVERCAM_GROUP=GROUP`. It needs the crates `scene` and
//! `iceoryx2`, and `rustix` to read the clock. `planner.py` is the same in Python.

use std::error::Error;
use std::io::{ErrorKind, Write};
use std::time::Duration;

use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::event::EventOpenError;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::publish_subscribe;
use rustix::time::{ClockId, clock_gettime};
use scene::{DEFAULT_SERVICE, SERVICE_SUFFIX, Scene};

/// Delay until a command takes effect.
const DELAY_NS: u64 = 500_000_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or(DEFAULT_SERVICE.to_owned());
    let mut remaining: u64 = arguments.next().map_or(Ok(u64::MAX), |n| n.parse())?;

    let name = ServiceName::new(&format!("{name}{SERVICE_SUFFIX}"))?;
    while let Some(overcam) = Subscription::wait_for(&name)? {
        loop {
            // Ctrl-C ends the wait, so that all shared memory is released.
            if remaining == 0 || overcam.node.wait(Duration::ZERO).is_err() {
                return Ok(());
            }
            let mut heard = false;
            while let Some(scene) = overcam.subscriber.receive()? {
                print(&scene)?;
                remaining = remaining.saturating_sub(1);
                heard = true;
            }
            match overcam.listener.timed_wait(|_| {}, Duration::from_secs(1)) {
                // Silence: the service's files may have been removed, and overcam has created new
                // ones.
                Ok(0) if !heard && !overcam.is_current() => break,
                Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
    Ok(())
}

/// Ports must be dropped before the services they belong to, and these before the node.
struct Subscription {
    subscriber: Subscriber<ipc::Service, Scene, ()>,
    listener: Listener<ipc::Service>,
    scenes: publish_subscribe::PortFactory<ipc::Service, Scene, ()>,
    node: Node<ipc::Service>,
}

impl Subscription {
    /// Waits until overcam runs. `None` after Ctrl-C.
    fn wait_for(name: &ServiceName) -> Result<Option<Self>, Box<dyn Error>> {
        loop {
            // With the environment variable OVERCAM_GROUP, where `overcam --group` publishes; that
            // may not exist yet.
            let config = match scene::config(name) {
                Ok(config) => config,
                Err(error) if error.kind() == ErrorKind::NotFound => Config::default(),
                Err(error) => return Err(error.into()),
            };
            let node = NodeBuilder::new()
                .config(&config)
                .create::<ipc::Service>()?;
            let scenes = node
                .service_builder(name)
                .publish_subscribe::<Scene>()
                .open();
            let wakeups = node.service_builder(name).event().open();
            match (scenes, wakeups) {
                (Ok(scenes), Ok(wakeups)) => {
                    let listener = wakeups.listener_builder().create()?;
                    // The newest scene is enough: a late planner has no use for those it missed.
                    let subscriber = scenes.subscriber_builder().buffer_size(1).create()?;
                    // Gives overcam access to the ports if it runs as another user of the group.
                    scene::admit(&config)?;
                    return Ok(Some(Self {
                        subscriber,
                        listener,
                        scenes,
                        node,
                    }));
                }
                (Err(PublishSubscribeOpenError::DoesNotExist), _)
                | (_, Err(EventOpenError::DoesNotExist)) => {} // overcam is not running yet
                (Err(error), _) => return Err(error.into()),
                (_, Err(error)) => return Err(error.into()),
            }
            if node.wait(Duration::from_millis(100)).is_err() {
                return Ok(None);
            }
        }
    }

    fn is_current(&self) -> bool {
        scene::is_current(&self.scenes, self.node.config())
    }
}

fn print(scene: &Scene) -> std::io::Result<()> {
    let now = clock_gettime(ClockId::Monotonic);
    let now_ns = now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64;
    let age_ms = scene.age_ns(now_ns) as f64 / 1e6;
    for robot in scene.objects() {
        let (Some(name), Some(heading)) = (robot.marker_name(), robot.heading()) else {
            continue; // an obstacle
        };
        let then = scene.pose_at(robot, now_ns + DELAY_NS);
        writeln!(
            std::io::stdout(),
            "{} {name} x {:.3} y {:.3} heading {heading:.3} in {:.3} s x {:.3} y {:.3} age {age_ms:.3} ms",
            scene.sequence,
            robot.x,
            robot.y,
            DELAY_NS as f64 / 1e9,
            then.x,
            then.y,
        )?;
    }
    Ok(())
}
