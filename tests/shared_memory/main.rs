//! Publication through shared memory, with real processes that come, go, stop and are killed.
//!
//! Subscribers and rival publishers are this test program itself, started again for the single test
//! [`child`] with a role in its environment. Each test has its own service name.

mod removal;

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use overcam::clock::monotonic_ns;
use overcam::command::watch::{WatchError, watch};
use overcam::output::json;
use overcam::output::shared_memory::{PublishError, Publisher, SUBSCRIBER_BUFFER};
use scene::{
    CLOCK_MONOTONIC, ForecastPoint, HAS_HEADING, KIND_MARKER, OBSERVED, SERVICE_SUFFIX, Scene,
};

const ROLE: &str = "OVERCAM_TEST_ROLE";
const SERVICE: &str = "OVERCAM_TEST_SERVICE";
/// A process that takes longer to do something counts as hung.
const PATIENCE: Duration = Duration::from_secs(30);

#[test]
#[ignore = "started by the other tests as a process of its own"]
fn child() {
    let (Ok(role), Ok(service)) = (std::env::var(ROLE), std::env::var(SERVICE)) else {
        return;
    };
    static STOP: AtomicBool = AtomicBool::new(false);
    // The parent closes standard input for a clean end. Its death has the same effect.
    thread::spawn(|| {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        STOP.store(true, Ordering::Relaxed);
    });
    let result = match role.as_str() {
        "watch" => {
            watch(&service, None, None, &STOP, &mut std::io::stdout()).map_err(|e| e.to_string())
        }
        "publish" => publish_until(&service, &STOP).map_err(|e| e.to_string()),
        other => Err(format!("no role `{other}`")),
    };
    if let Err(line) = result {
        eprintln!("{line}");
        std::process::exit(1);
    }
}

fn publish_until(service: &str, stop: &AtomicBool) -> Result<(), PublishError> {
    let mut publisher = Publisher::open(service)?;
    println!("{{published}}");
    let mut scene = Scene::EMPTY;
    while !stop.load(Ordering::Relaxed) {
        publisher.send(&scene)?;
        scene.sequence += 1;
        thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}

/// A child process whose lines arrive one by one. It is killed when dropped.
struct Process {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Receiver<String>,
    errors: Receiver<String>,
}

impl Process {
    fn start(command: &mut Command) -> Self {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the child starts");
        let lines = lines_of(child.stdout.take().expect("stdout is piped"));
        let errors = lines_of(child.stderr.take().expect("stderr is piped"));
        Self {
            stdin: child.stdin.take(),
            child,
            lines,
            errors,
        }
    }

    fn with_role(role: &str, service: &str) -> Self {
        let program = std::env::current_exe().expect("the test program has a path");
        let arguments = ["child", "--exact", "--ignored", "--nocapture", "--quiet"];
        Self::start(
            Command::new(program)
                .args(arguments)
                .env(ROLE, role)
                .env(SERVICE, service),
        )
    }

    /// The next line that starts like a JSON object, if one arrives within `patience`.
    fn poll_line(&self, patience: Duration) -> Option<String> {
        let deadline = Instant::now() + patience;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) if line.starts_with('{') => return Some(line),
                Ok(_) => {} // the test harness's own output
                Err(_) => return None,
            }
        }
    }

    /// The next line on standard error.
    fn next_error(&self) -> String {
        let line = self.errors.recv_timeout(PATIENCE);
        line.expect("the child says something on standard error")
    }

    /// The number of the next scene; sends scenes until one arrives.
    fn next_sequence(&self, publisher: &mut Publisher, scene: &mut Scene) -> u64 {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            publisher.send(scene).expect("the scene is published");
            scene.sequence += 1;
            if let Some(line) = self.poll_line(Duration::from_millis(10)) {
                return sequence_of(&line);
            }
        }
        panic!("no scene reached the subscriber");
    }

    fn signal(&self, name: &str) {
        let command = format!("kill -{name} {}", self.child.id());
        let status = Command::new("sh").args(["-c", &command]).status();
        assert!(status.expect("sh runs").success());
    }

    /// Kills it like `kill -9`: nothing it opened is released.
    fn kill(mut self) {
        self.child.kill().expect("the child can be killed");
        self.child.wait().expect("the child can be waited for");
    }

    /// Ends it cleanly. Returns its exit status and standard error.
    fn end(mut self) -> (Option<i32>, Vec<String>) {
        drop(self.stdin.take());
        self.exit()
    }

    /// Waits until it ends by itself. Returns its exit status and standard error.
    fn exit(&mut self) -> (Option<i32>, Vec<String>) {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            if let Some(status) = self.child.try_wait().expect("the child can be waited for") {
                return (status.code(), self.errors.iter().collect());
            }
            thread::sleep(Duration::from_millis(5));
        }
        panic!("the child does not end");
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn lines_of(stream: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    receiver
}

fn sequence_of(line: &str) -> u64 {
    let scene: serde_json::Value = serde_json::from_str(line).expect("a line is a JSON object");
    scene["sequence"].as_u64().expect("a scene has a number")
}

/// A name that no other test or run uses.
fn unique(name: &str) -> String {
    format!("overcam-test-{}-{name}", std::process::id())
}

fn full_name(service: &str) -> ServiceName {
    ServiceName::new(&format!("{service}{SERVICE_SUFFIX}")).expect("the name is possible")
}

fn node() -> Node<ipc::Service> {
    NodeBuilder::new()
        .config(&Config::default())
        .create()
        .expect("a node is possible")
}

fn exists(service: &str) -> bool {
    let name = full_name(service);
    let config = Config::default();
    [MessagingPattern::PublishSubscribe, MessagingPattern::Event]
        .into_iter()
        .any(|pattern| {
            ipc::Service::does_exist(&name, &config, pattern).expect("services can be listed")
        })
}

/// An arrow that drives along y, and an obstacle.
fn scene_with_robot(sequence: u64) -> Scene {
    let mut scene = Scene::EMPTY;
    scene.sequence = sequence;
    scene.clock = CLOCK_MONOTONIC;
    scene.stamp_ns = monotonic_ns();
    scene.n_objects = 2;
    scene.objects[1].track = 2;
    let robot = &mut scene.objects[0];
    robot.track = 1;
    robot.kind = KIND_MARKER;
    robot.flags = OBSERVED | HAS_HEADING;
    robot.marker[..5].copy_from_slice(b"arrow");
    (robot.x, robot.y) = (101.52, -0.000_1);
    robot.heading_rad = -2.5;
    robot.n_forecast = scene::MAX_FORECAST as u32;
    for (step, point) in robot.forecast.iter_mut().enumerate() {
        let dt_s = (step + 1) as f64 / 10.0;
        *point = ForecastPoint {
            dt_s,
            x: 101.52,
            y: sequence as f64 - 30.0 * dt_s,
            covariance: [[0.1, 0.0], [0.0, 0.1]],
        };
    }
    scene
}

#[test]
fn a_late_joiner_gets_the_last_scene_while_frames_pause() {
    let service = unique("late");
    let mut publisher = Publisher::open(&service).expect("the service is free");
    publisher.send(&scene_with_robot(6)).expect("published");
    let last = scene_with_robot(7);
    publisher.send(&last).expect("published");

    let watcher = Process::with_role("watch", &service);
    let deadline = Instant::now() + PATIENCE;
    let line = loop {
        publisher.serve_late_joiners().expect("served");
        match watcher.poll_line(Duration::from_millis(20)) {
            Some(line) => break line,
            None => assert!(Instant::now() < deadline, "the last scene never came"),
        }
    };
    let mut expected = Vec::new();
    json::write_line(&last, &mut expected).expect("a vector takes it");
    assert_eq!(
        format!("{line}\n").into_bytes(),
        expected,
        "watch prints what --json prints"
    );

    // Only once: it is not sent again.
    publisher.serve_late_joiners().expect("served");
    assert_eq!(watcher.poll_line(Duration::from_millis(300)), None);
    assert_eq!(watcher.end().0, Some(0));
    drop(publisher);
    assert!(!exists(&service), "something was left behind");
}

#[test]
fn a_stopped_subscriber_slows_nobody_and_then_gets_the_newest() {
    let service = unique("slow");
    let mut publisher = Publisher::open(&service).expect("the service is free");
    let mut scene = Scene::EMPTY;
    let slow = Process::with_role("watch", &service);
    let quick = Process::with_role("watch", &service);
    slow.next_sequence(&mut publisher, &mut scene);
    quick.next_sequence(&mut publisher, &mut scene);

    slow.signal("STOP");
    for _ in 0..500 {
        quick.next_sequence(&mut publisher, &mut scene);
    }
    let newest = scene.sequence - 1;
    slow.signal("CONT");

    let mut received = Vec::new();
    while received.last() != Some(&newest) {
        let line = slow.poll_line(PATIENCE).expect("the newest scene comes");
        received.push(sequence_of(&line));
    }
    // It may have continued to read for a moment, since the signal does not stop it at once.
    received.retain(|&sequence| sequence > newest - 250);
    assert!(
        received.len() <= SUBSCRIBER_BUFFER,
        "no more than was kept for it: {received:?}"
    );
    let (status, errors) = slow.end();
    assert_eq!(status, Some(0));
    let missed = errors.iter().any(|line| line.contains("frames without"));
    assert!(missed, "it says what it missed: {errors:?}");
    assert_eq!(quick.end().0, Some(0));
}

#[test]
fn a_killed_subscriber_is_removed_while_the_publisher_continues() {
    let service = unique("killed-subscriber");
    let mut publisher = Publisher::open(&service).expect("the service is free");
    let mut scene = Scene::EMPTY;
    let victim = Process::with_role("watch", &service);
    victim.next_sequence(&mut publisher, &mut scene);

    // Reads the counts of the service from a node that does not clean up.
    let node = node();
    let counts = node
        .service_builder(&full_name(&service))
        .publish_subscribe::<Scene>()
        .open()
        .expect("the layout is ours");
    assert_eq!(counts.dynamic_config().number_of_subscribers(), 1);
    victim.kill();
    let deadline = Instant::now() + PATIENCE;
    while counts.dynamic_config().number_of_subscribers() > 0 {
        publisher.send(&scene).expect("the publisher goes on");
        scene.sequence += 1;
        assert!(Instant::now() < deadline, "its place is never given back");
        thread::sleep(Duration::from_millis(20));
    }

    let next = Process::with_role("watch", &service);
    next.next_sequence(&mut publisher, &mut scene);
    assert_eq!(next.end().0, Some(0));
    drop((publisher, counts, node));
    assert!(!exists(&service), "something was left behind");
}

#[test]
fn a_killed_publisher_is_succeeded_and_its_subscribers_stay() {
    let service = unique("killed-publisher");
    let victim = Process::with_role("publish", &service);
    let watcher = Process::with_role("watch", &service);
    let line = watcher.poll_line(PATIENCE);
    line.expect("a scene of the first publisher");
    victim.kill();

    let mut publisher = Publisher::open(&service).expect("the place is free again");
    let mut scene = Scene::EMPTY;
    scene.sequence = 1_000_000;
    while watcher.next_sequence(&mut publisher, &mut scene) < 1_000_000 {}
    let (status, errors) = watcher.end();
    assert_eq!(status, Some(0));
    let noticed = errors.iter().any(|line| line.contains("new publisher"));
    assert!(noticed, "it says so: {errors:?}");
    drop(publisher);
    assert!(!exists(&service), "something was left behind");
}

#[test]
fn a_watcher_waits_for_the_service_and_notices_that_its_publisher_died() {
    let service = unique("waiting");
    let watcher = Process::with_role("watch", &service);
    let said = watcher.next_error();
    assert!(said.contains("waiting for service"), "{said}");
    let victim = Process::with_role("publish", &service);
    watcher.poll_line(PATIENCE).expect("a scene");
    victim.kill();
    let said = watcher.next_error();
    assert!(said.contains("nobody publishes"), "{said}");
    assert_eq!(watcher.end().0, Some(0));
    assert!(!exists(&service), "something was left behind");
}

/// A pipe whose reader disconnects after some lines.
struct ClosedPipe {
    lines_left: usize,
}

impl Write for ClosedPipe {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.lines_left == 0 {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        self.lines_left -= 1;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_watcher_ends_after_its_frames_and_with_its_pipe() {
    let service = unique("ends");
    let mut publisher = Publisher::open(&service).expect("the service is free");
    let stop = AtomicBool::new(false);
    let mut printed = Vec::new();
    let mut pipe = ClosedPipe { lines_left: 2 };
    thread::scope(|scope| {
        let counted = scope.spawn(|| watch(&service, None, Some(3), &stop, &mut printed));
        let piped = scope.spawn(|| watch(&service, None, None, &stop, &mut pipe));
        let deadline = Instant::now() + PATIENCE;
        while !(counted.is_finished() && piped.is_finished()) && Instant::now() < deadline {
            publisher.send(&Scene::EMPTY).expect("published");
            thread::sleep(Duration::from_millis(5));
        }
        stop.store(true, Ordering::Relaxed); // so that a failure does not hang
        counted.join().expect("no panic").expect("no error");
        piped.join().expect("no panic").expect("no error");
    });
    assert_eq!(printed.iter().filter(|&&byte| byte == b'\n').count(), 3);
    assert_eq!(pipe.lines_left, 0);
}

#[test]
fn a_second_publisher_is_refused_in_one_line_while_the_first_runs() {
    let service = unique("second");
    let mut first = Publisher::open(&service).expect("the service is free");
    let (status, errors) = Process::with_role("publish", &service).exit();
    assert_eq!(status, Some(1));
    let expected = format!(
        "service `{service}/scene` is already published by process {}: stop that one, or choose another name with \
         --service NAME",
        std::process::id()
    );
    assert_eq!(errors.join("\n"), expected);
    // Within the same process as well.
    let refused = Publisher::open(&service).expect_err("the place is taken");
    assert_eq!(refused.to_string(), expected);
    first.send(&Scene::EMPTY).expect("the first one goes on");

    drop(first);
    let successor = Process::with_role("publish", &service);
    let line = successor.poll_line(PATIENCE);
    line.expect("the place is free again");
    assert_eq!(successor.end().0, Some(0));
    assert!(!exists(&service), "something was left behind");
}

/// A scene as another version of the program might define it.
#[repr(C)]
#[derive(Debug, Clone, Copy, ZeroCopySend)]
#[type_name("overcam.Scene.v0")]
struct OtherScene {
    sequence: u64,
}

#[test]
fn another_layout_is_refused_and_not_misread() {
    let service = unique("layout");
    let node = node();
    let builder = || {
        node.service_builder(&full_name(&service))
            .publish_subscribe::<OtherScene>()
    };

    let other = builder().create().expect("the name is free");
    let refused = Publisher::open(&service).expect_err("another layout is in use");
    assert!(
        matches!(refused, PublishError::Incompatible { .. }),
        "{refused}"
    );
    // Who that is, and what differs.
    let expected = format!(
        "process {} has iceoryx2 0.10.0 and scene `overcam.Scene.v0` of 8 bytes; this overcam has iceoryx2 0.10.0",
        std::process::id()
    );
    assert!(refused.to_string().contains(&expected), "{refused}");
    let mut printed = Vec::new();
    let refused = watch(
        &service,
        None,
        Some(1),
        &AtomicBool::new(false),
        &mut printed,
    );
    assert!(
        matches!(refused, Err(WatchError::Incompatible { .. })),
        "{refused:?}"
    );
    assert!(printed.is_empty());
    drop(other);

    let _publisher = Publisher::open(&service).expect("the name is free again");
    assert_eq!(
        builder().open().expect_err("our layout is in use"),
        PublishSubscribeOpenError::IncompatibleTypes
    );
}

#[test]
fn a_foreign_group_is_refused_in_one_line() {
    for (group, reason) in [
        ("no-such-group-here", "there is no such group"),
        ("a/b", "cannot be the name of a group"),
        ("", "cannot be the name of a group"),
    ] {
        let refused = Publisher::open_for(&unique("group"), Some(group));
        let line = refused.expect_err("it is not possible").to_string();
        assert!(line.contains(reason) && !line.contains('\n'), "{line}");
    }
}

#[test]
fn a_planner_prints_the_published_poses() {
    print_the_published_poses(vec![&mut Command::new(example_binary("planner"))]);
}

#[test]
#[ignore = "needs python3 with iceoryx2: cargo test --test shared_memory -- --ignored python"]
fn planners_in_rust_and_python_print_the_published_poses() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/planner.py");
    print_the_published_poses(vec![
        &mut Command::new(example_binary("planner")),
        Command::new("python3").arg(script),
    ]);
}

fn print_the_published_poses(commands: Vec<&mut Command>) {
    let service = unique("planners");
    let mut planners: Vec<Process> = commands
        .into_iter()
        .map(|command| Process::start(command.args([service.as_str(), "5"])))
        .collect();
    // The planners are there first and wait. Each ends by itself after five scenes.
    let mut publisher = Publisher::open(&service).expect("the service is free");
    let deadline = Instant::now() + PATIENCE;
    let mut sequence = 0;
    while planners
        .iter_mut()
        .any(|planner| matches!(planner.child.try_wait(), Ok(None)))
    {
        assert!(Instant::now() < deadline, "a planner does not end");
        let scene = scene_with_robot(sequence);
        publisher.send(&scene).expect("published");
        sequence += 1;
        thread::sleep(Duration::from_millis(20));
    }
    for mut planner in planners {
        assert_eq!(planner.exit(), (Some(0), vec![]));
        let printed: BTreeMap<u64, (String, f64)> =
            planner.lines.iter().map(numbered_pose).collect();
        assert_eq!(printed.len(), 5, "{printed:?}");
        for (sequence, (pose, age_s)) in printed {
            let (pose, ahead_y) = pose.rsplit_once(' ').expect("a line ends with y");
            let expected = format!(
                "{sequence} arrow x 101.520 y -0.000 heading -2.500 in 0.500 s x 101.520 y"
            );
            assert_eq!(pose, expected);
            // Half a second from the time the line was printed, not from the exposure.
            let expected = sequence as f64 - 30.0 * (0.5 + age_s).min(2.0);
            let ahead_y: f64 = ahead_y.parse().expect("a number");
            assert!((ahead_y - expected).abs() < 2e-3, "{ahead_y} {expected}");
        }
    }
    drop(publisher);
    assert!(!exists(&service), "something was left behind");
}

/// A planner's line without the age, and the age in seconds, which must be that of a scene just
/// made.
fn numbered_pose(line: String) -> (u64, (String, f64)) {
    let (pose, age) = line.split_once(" age ").expect("a line ends with the age");
    let age_ms: f64 = age
        .strip_suffix(" ms")
        .and_then(|age| age.parse().ok())
        .expect("the age is a number of milliseconds");
    let patience_ms = PATIENCE.as_secs_f64() * 1e3;
    assert!(
        (0.0..patience_ms).contains(&age_ms),
        "not on one clock: {line}"
    );
    let sequence = pose.split(' ').next().and_then(|first| first.parse().ok());
    let sequence = sequence.expect("a line begins with the number of the scene");
    (sequence, (pose.to_owned(), age_ms * 1e-3))
}

/// The example's binary. A test run of this file alone does not build it.
fn example_binary(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("the test program has a path");
    let profile = test.ancestors().nth(2).expect("target/PROFILE/deps/TEST");
    let binary = profile.join("examples").join(name);
    if !binary.exists() {
        let release = profile.ends_with("release").then_some("--release");
        let status = Command::new(env!("CARGO"))
            .args(["build", "--quiet", "--offline", "--example", name])
            .args(release)
            .status();
        assert!(status.expect("cargo runs").success());
    }
    binary
}
