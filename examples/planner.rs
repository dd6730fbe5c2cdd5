//! A planner's side of overcam: waits for each scene and prints where every marked robot is, and where it will be half a
//! second from now, when a command may take effect.
//!
//! ```text
//! cargo run --example planner -- [NAME [SCENES]]
//! ```
//!
//! `NAME` is that of `overcam --service NAME`; after `SCENES` scenes it ends. It needs the crates `scene` and `iceoryx2`, and
//! `rustix` to read the clock. `planner.py` is the same in Python.

use std::error::Error;
use std::io::Write;
use std::time::Duration;

use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::event::EventOpenError;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use rustix::time::{ClockId, clock_gettime};
use scene::{DEFAULT_SERVICE, SERVICE_SUFFIX, Scene};

/// Until a command takes effect.
const DELAY_NS: u64 = 500_000_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or(DEFAULT_SERVICE.to_owned());
    let mut remaining: u64 = arguments.next().map_or(Ok(u64::MAX), |n| n.parse())?;

    let name = ServiceName::new(&format!("{name}{SERVICE_SUFFIX}"))?;
    let node = NodeBuilder::new()
        .config(&Config::default())
        .create::<ipc::Service>()?;
    let (scenes, wakeups) = loop {
        let scenes = node
            .service_builder(&name)
            .publish_subscribe::<Scene>()
            .open();
        let wakeups = node.service_builder(&name).event().open();
        match (scenes, wakeups) {
            (Ok(scenes), Ok(wakeups)) => break (scenes, wakeups),
            (Err(PublishSubscribeOpenError::DoesNotExist), _)
            | (_, Err(EventOpenError::DoesNotExist)) => {} // overcam does not run yet
            (Err(error), _) => return Err(error.into()),
            (_, Err(error)) => return Err(error.into()),
        }
        if node.wait(Duration::from_millis(100)).is_err() {
            return Ok(()); // Ctrl-C
        }
    };
    let listener = wakeups.listener_builder().create()?;
    // The newest scene is enough: a planner that comes late has no use for those it missed.
    let subscriber = scenes.subscriber_builder().buffer_size(1).create()?;

    // Ctrl-C ends the wait, so that everything in shared memory is given back.
    while remaining > 0 && node.wait(Duration::ZERO).is_ok() {
        while let Some(scene) = subscriber.receive()? {
            print(&scene)?;
            remaining = remaining.saturating_sub(1);
        }
        match listener.timed_wait(|_| {}, Duration::from_secs(1)) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
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
