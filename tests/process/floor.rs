//! The empty floor: learned into a file, relearned during a run, and limited to a region of the
//! picture.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use imgproc::Size;
use overcam::background::model::BackgroundModel;
use overcam::image::frame::Picture;
use overcam::image::picture_file::write_png;
use overcam::run::slot::{Next, Slot};
use overcam::source::replay::Recording;
use random::SplitMix64;
use serde_json::Value;

use crate::fixture::{
    HEIGHT, PLAIN, Running, WIDTH, folder, overcam, parse, printed, run, write_y4m, y4m,
};
use crate::refusals::assert_refused;

const SIZE: Size = Size {
    width: WIDTH,
    height: HEIGHT,
};

const FRAME: &[u8] = b"FRAME\n";

/// Size of a 4:2:0 frame with its header.
const FRAME_BYTES: usize = FRAME.len() + WIDTH * HEIGHT * 3 / 2;

/// Frames of an empty, noisy floor, followed by those of [`y4m`].
fn empty_then_busy(n_empty: usize, n_busy: usize) -> Vec<u8> {
    let mut stream = y4m(n_empty + n_busy);
    let first = stream.len() - (n_empty + n_busy) * FRAME_BYTES;
    let mut random = SplitMix64(1);
    for frame in stream[first..].chunks_mut(FRAME_BYTES).take(n_empty) {
        let (luma, chroma) = frame[FRAME.len()..].split_at_mut(WIDTH * HEIGHT);
        for value in luma {
            *value = 108 + random.byte() % 5;
        }
        chroma.fill(128);
    }
    stream
}

#[test]
fn a_floor_from_a_file_gives_the_results_of_one_that_was_just_learned() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("run.y4m"), empty_then_busy(30, 20)).expect("it can be written");
    let device = ["--device", "run.y4m"];
    let print = [&PLAIN[..], &device, &["--json"]].concat();
    let learned = printed(folder.path(), &[&print[..], &["--learn", "30"]].concat());
    assert_eq!(learned.len(), 20);

    let background = [
        &["background", "-o", "floor.png", "--learn", "30"],
        &device[..],
    ]
    .concat();
    let said = printed(folder.path(), &background);
    let [said] = said.as_slice() else {
        panic!("not one line: {said:?}");
    };
    let expected = "floor.png: 160 x 120, learned from 30 frames; median noise 1.";
    assert!(said.starts_with(expected), "{said}");
    // An existing file is replaced, and no other file is left.
    fs::write(path("floor.png"), "old").expect("it can be written");
    printed(folder.path(), &background);
    let floor = BackgroundModel::read(&path("floor.png"), None).expect("it is a floor");
    assert!(floor.noise.iter().all(|&noise| noise > 0));
    let names = fs::read_dir(folder.path()).expect("it can be listed");
    assert_eq!(names.count(), 3, "the stream, the floor and the markers");

    // The same pictures without the preceding empty ones, to which the floor would adapt.
    let stream = empty_then_busy(30, 20);
    let header = stream.len() - 50 * FRAME_BYTES;
    let busy = [
        &stream[..header],
        &stream[stream.len() - 20 * FRAME_BYTES..],
    ]
    .concat();
    fs::write(path("busy.y4m"), busy).expect("it can be written");
    let device = [
        "--device",
        "busy.y4m",
        "--background",
        "floor.png",
        "--json",
    ];
    let given = printed(folder.path(), &[&PLAIN[..], &device].concat());
    let found = |lines: &[String]| -> Vec<_> {
        let found = |line: &String| {
            let scene = parse(line);
            ["light", "gain", "objects"].map(|key| scene[key].clone())
        };
        lines.iter().map(found).collect()
    };
    assert_eq!(found(&given), found(&learned));
    assert!(given.iter().all(|line| objects(line).len() >= 2));
}

fn objects(line: &str) -> Vec<Value> {
    let scene = parse(line);
    scene["objects"].as_array().expect("a list").clone()
}

#[test]
fn a_floor_is_learned_from_all_frames_of_a_file_that_has_fewer() {
    let folder = folder();
    write_y4m(&folder.path().join("run.y4m"), 20);
    let arguments = ["background", "--device", "run.y4m", "-o", "floor.png"];
    let said = printed(folder.path(), &arguments);
    let expected = "learned from 20 frames, which are all (60 were asked for)";
    assert!(said[0].contains(expected), "{said:?}");
    assert!(folder.path().join("floor.png").exists());
}

#[test]
fn an_incompletely_learned_floor_is_not_written() {
    let folder = folder();
    fs::write(folder.path().join("floor.png"), "old").expect("it can be written");
    let arguments = ["background", "--device", "-", "-o", "floor.png"];
    let mut learning = Running::start(overcam(folder.path(), &arguments).stdin(Stdio::piped()));
    let mut pipe = learning.stdin.take().expect("standard input is piped");
    pipe.write_all(&y4m(9)).expect("it is read");
    learning.hear("learning the empty floor from 60 frames");
    learning.signal("INT");
    learning.hear("nothing is written");
    let ended = learning.end();
    assert_eq!(ended.status, Some(0));
    assert!(ended.lines.is_empty());
    drop(pipe);

    // A truncated stream is an error, and so is one without frames.
    let mut cut = y4m(5);
    cut.truncate(cut.len() - 100);
    fs::write(folder.path().join("cut.y4m"), cut).expect("it can be written");
    fs::write(folder.path().join("none.y4m"), y4m(0)).expect("it can be written");
    for (device, reason) in [
        ("cut.y4m", "cut.y4m: cut off"),
        ("none.y4m", "none.y4m: there is no frame to learn from"),
    ] {
        let arguments = ["background", "--device", device, "-o", "floor.png"];
        let ended = run(folder.path(), &arguments);
        assert_eq!(ended.status, Some(1), "{:?}", ended.errors);
        assert!(ended.said(reason), "{:?}", ended.errors);
    }
    let old = fs::read(folder.path().join("floor.png")).expect("it is there");
    assert_eq!(old, b"old");
    let names = fs::read_dir(folder.path()).expect("it can be listed");
    assert_eq!(names.count(), 4, "two streams, the floor and the markers");
}

#[test]
fn the_floor_is_relearned_on_a_signal_and_the_recording_replays() {
    let folder = folder();
    let arguments = [
        &PLAIN[..],
        &["--size", "320x240", "--learn", "45", "--json"],
        &["--record", "run.mcap"],
    ]
    .concat();
    let running = Running::start(&mut overcam(folder.path(), &arguments));
    let mut lines = vec![running.next_line()];
    running.signal("USR1");
    running.hear("learning the empty floor again from the 45 frames after frame");
    running.signal("USR1");
    running.hear("already being learned");
    running.hear("the empty floor was learned again");
    running.signal("INT");
    let ended = running.end();
    assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
    lines.extend(ended.lines);
    // Results continued in the meantime.
    assert!(lines.len() > 45, "{} lines", lines.len());

    let replayed = printed(
        folder.path(),
        &["--device", "run.mcap", "--json", "--no-publish"],
    );
    assert!(replayed == lines, "{} frames", replayed.len());
    let mut recording = Recording::open(&folder.path().join("run.mcap")).expect("it can be opened");
    let (mut slot, mut floors) = (Slot::empty(), Vec::new());
    while recording.next(&mut slot).expect("it is whole") == Next::Frame {
        floors.extend(slot.background.take());
    }
    assert_eq!(floors.len(), 2);
    assert!(floors[0] != floors[1]);
    assert!(floors.iter().all(|floor| floor.median_noise().is_some()));
}

#[test]
fn pixels_outside_the_region_are_ignored() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write_y4m(&path("run.y4m"), 40);
    let whole = ["--device", "run.y4m", "--learn", "15", "--json"];
    let whole = [&PLAIN[..], &whole].concat();
    // The bright rectangle covers the rows 20 to 33, the red one those from 80 on.
    for (n_light_rows, lowest) in [(60, 33.5), (27, 26.5)] {
        write_region(&path("region.png"), n_light_rows);
        let recording = format!("{n_light_rows}.mcap");
        let region = ["--region", "region.png", "--record", &recording];
        let lines = printed(folder.path(), &[&whole[..], &region].concat());
        for line in &lines {
            let objects = objects(line);
            assert_eq!(objects.len(), 1, "{line}");
            let outline = objects[0]["outline"].as_array().expect("an outline");
            let rows = outline
                .iter()
                .map(|point| point[1].as_f64().expect("a row"));
            let found = rows.fold(0.0, f64::max);
            assert!((found - lowest).abs() < 1.0, "{found}: {line}");
        }
        // The recording is enough.
        fs::remove_file(path("region.png")).expect("it can be removed");
        let replay = ["--device", &recording, "--json", "--no-publish"];
        assert_eq!(printed(folder.path(), &replay), lines);
    }
    // Unless another region is given.
    write_region(&path("region.png"), HEIGHT);
    let all = printed(folder.path(), &whole);
    let replay = ["--device", "27.mcap", "--json", "--no-publish"];
    let replay = [&replay[..], &["--region", "region.png"]].concat();
    assert_eq!(printed(folder.path(), &replay), all);
}

#[test]
fn regions_and_floors_that_cannot_be_used_are_refused() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write_y4m(&path("run.y4m"), 5);
    write_region(&path("dark.png"), 0);
    write_region(&path("light.png"), HEIGHT);
    fs::write(path("notes.txt"), "once upon a time").expect("it can be written");
    fs::create_dir(path("taken.png")).expect("it can be made");
    std::os::unix::fs::symlink("/dev/null", path("null.png")).expect("a link can be made");
    for (device, file, reason) in [
        ("run.y4m", "nowhere.png", "No such file"),
        ("run.y4m", "notes.txt", "neither a PNG nor a JPEG file"),
        ("run.y4m", "dark.png", "nothing in it is light"),
        (
            "demo",
            "light.png",
            "it is 160 x 120, but the frames are 640 x 480",
        ),
    ] {
        let arguments = [&PLAIN[..], &["--device", device, "--region", file]].concat();
        assert_refused(folder.path(), &arguments, &[file, reason]);
    }
    for (file, reason) in [
        ("nowhere/floor.png", "No such file"),
        ("taken.png", "no regular file"),
        ("null.png", "no regular file"),
    ] {
        let arguments = ["background", "--device", "run.y4m", "-o", file];
        assert_refused(folder.path(), &arguments, &[file, reason]);
    }
    let ended = run(folder.path(), &["background", "--device", "run.y4m"]);
    assert_eq!(ended.status, Some(2), "{:?}", ended.errors);
}

/// A region for the frames of [`y4m`]: its upper rows are light.
fn write_region(path: &Path, n_light_rows: usize) {
    let plane: Vec<u8> = (0..SIZE.area())
        .map(|i| if i / WIDTH < n_light_rows { 255 } else { 0 })
        .collect();
    let picture = Picture {
        size: SIZE,
        red: plane.clone(),
        green: plane.clone(),
        blue: plane,
    };
    fs::write(path, write_png(&picture)).expect("it can be written");
}
