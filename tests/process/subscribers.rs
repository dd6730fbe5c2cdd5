//! Processes that read what another process publishes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::fixture::{Running, folder, overcam, parse, run, sequence_of, unique};

#[test]
fn a_watcher_prints_the_same_lines_as_the_publisher() {
    let folder = folder();
    let service = unique("watch");
    let watch = ["watch", "--service", &service, "--frames", "10"];
    let watcher = Running::start(&mut overcam(folder.path(), &watch));
    watcher.hear("waiting for service");
    let locate = ["--json", "--service", &service, "--markers", "one"];
    let publisher = Running::start(&mut overcam(folder.path(), &locate));
    let watched = watcher.end();
    assert_eq!(watched.status, Some(0));
    assert_eq!(watched.lines.len(), 10);
    publisher.signal("INT");
    let published = publisher.end();
    assert_eq!(published.status, Some(0));
    let first = sequence_of(&watched.lines[0]) as usize;
    let missed = watched.said("frames without a scene");
    for (n, line) in watched.lines.iter().enumerate() {
        let sequence = sequence_of(line) as usize;
        assert!(
            missed || sequence == first + n,
            "{sequence} is out of order"
        );
        assert_eq!(*line, published.lines[sequence]);
    }
}

#[test]
fn publisher_and_subscribers_survive_each_other() {
    let folder = folder();
    let service = unique("killed");
    let watch = ["watch", "--service", &service];
    let locate = ["--json", "--service", &service, "--markers", "one"];
    let first_watcher = Running::start(&mut overcam(folder.path(), &watch));
    let publisher = Running::start(&mut overcam(folder.path(), &locate));
    first_watcher.next_line();
    first_watcher.kill();
    let after_kill = sequence_of(&publisher.next_line());
    let watcher = Running::start(&mut overcam(folder.path(), &watch));
    assert!(sequence_of(&watcher.next_line()) >= after_kill);

    // No frame was skipped in the meantime.
    for _ in 0..10 {
        watcher.next_line();
    }
    let numbers: Vec<u64> = publisher
        .kill()
        .iter()
        .filter_map(|line| number(line))
        .collect();
    assert!(numbers.is_sorted() && numbers.windows(2).all(|pair| pair[1] == pair[0] + 1));

    // Its successor starts with frame 0, and the watcher sees it.
    let successor = Running::start(&mut overcam(folder.path(), &locate));
    watcher.hear("new publisher");
    while sequence_of(&watcher.next_line()) > 5 {}
    for running in [successor, watcher] {
        running.signal("INT");
        let ended = running.end();
        assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
    }
}

/// The sequence number of a line. `None` for a line cut off by a kill.
fn number(line: &str) -> Option<u64> {
    let scene: Value = serde_json::from_str(line).ok()?;
    scene["sequence"].as_u64()
}

#[test]
fn a_second_program_on_a_service_is_refused_and_leaves_nothing() {
    let folder = folder();
    let service = unique("second");
    let locate = ["--json", "--service", &service, "--markers", "one"];
    let first = Running::start(&mut overcam(folder.path(), &locate));
    first.next_line();
    let second = run(
        folder.path(),
        &[&locate[..], &["--record", "second.mcap"]].concat(),
    );
    assert_eq!(second.status, Some(1));
    let expected = format!(
        "overcam: service `{service}/scene` is already published by process {}: stop that one, or choose another name with \
         --service NAME",
        first.id()
    );
    assert_eq!(second.errors, [expected]);
    assert!(!folder.path().join("second.mcap").exists());
    // The first one continues without a gap.
    let mut numbers: Vec<u64> = (0..40).map(|_| sequence_of(&first.next_line())).collect();
    first.signal("INT");
    let ended = first.end();
    assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
    numbers.extend(ended.lines.iter().map(|line| sequence_of(line)));
    assert!(numbers.iter().copied().eq(1..=numbers.len() as u64));
}

#[test]
fn a_planner_reads_the_poses_of_the_json_lines() {
    reads_the_poses(&mut Command::new(example("planner")));
}

#[test]
#[ignore = "needs python3 with iceoryx2: cargo test --test process -- --ignored python"]
fn a_planner_in_python_reads_the_poses_of_the_json_lines() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/planner.py");
    reads_the_poses(Command::new("python3").arg(script));
}

/// The planner prints for five scenes what the JSON lines say.
fn reads_the_poses(planner: &mut Command) {
    let folder = folder();
    let service = unique("planners");
    let planner = Running::start(planner.args([service.as_str(), "5"]));
    let publisher = Running::start(&mut overcam(
        folder.path(),
        &["--json", "--service", &service],
    ));
    let planner = planner.end();
    publisher.signal("INT");
    let published = publisher.end().lines;
    assert_eq!((planner.status, planner.errors), (Some(0), vec![]));
    let mut robots_of = BTreeMap::<usize, u32>::new();
    for line in &planner.lines {
        *robots_of.entry(assert_pose(line, &published)).or_default() += 1;
    }
    assert!(robots_of.len() == 5 && robots_of.values().all(|&robots| robots == 6));
}

/// Checks that a planner's line matches the JSON line of its scene. Returns the index of the scene.
fn assert_pose(line: &str, published: &[String]) -> usize {
    let words: Vec<&str> = line.split(' ').collect();
    let (&[sequence, name], numbers) = words.split_first_chunk().expect("a number and a name");
    let sequence: usize = sequence.parse().expect("the number of a scene");
    let value = |key: &str| -> f64 {
        let at = numbers.iter().position(|word| *word == key).expect(key);
        numbers[at + 1].parse().expect("a number")
    };
    let scene = parse(&published[sequence]);
    let objects = scene["objects"].as_array().expect("objects are a list");
    let robot = objects.iter().find(|object| object["marker"] == name);
    let robot = robot.expect("the robot is in the scene");
    for key in ["x", "y", "heading"] {
        let published = robot[key].as_f64().expect("a number");
        // The lines have three decimals here and six digits there.
        assert!(
            (value(key) - published).abs() < 1.1e-3,
            "{key}: {line}, {robot}"
        );
    }
    sequence
}

/// The example's binary. A test run of this file alone does not build it.
fn example(name: &str) -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_overcam"));
    let profile = program.parent().expect("target/PROFILE/overcam");
    let example = profile.join("examples").join(name);
    if !example.exists() {
        let release = profile.ends_with("release").then_some("--release");
        let status = Command::new(env!("CARGO"))
            .args(["build", "--quiet", "--offline", "--example", name])
            .args(release)
            .status();
        assert!(status.expect("cargo runs").success());
    }
    example
}
