//! The whole program with a camera that shows the demo floor: feeds for a loopback camera, and
//! checks of the results.
//!
//! `tests/camera/run` runs the program in a virtual machine between the two parts.
//! `OVERCAM_CAMERA_TEST` names its folder. A recording holds the camera's frames byte for byte, so
//! each is looked up in the feed and compared with the demo's truth at exactly that time,
//! regardless of frames that the camera dropped or the program skipped.

use std::collections::HashMap;
use std::path::PathBuf;
use std::{env, fs};

use imgproc::Size;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use overcam::image::frame::Frame;
use overcam::run::slot::{Next, Slot};
use overcam::source::demo::{Floor, Truth};
use overcam::source::replay::Recording;
use serde_json::Value;

const SEED: u64 = 5;

/// Small, because the program is emulated; `tests/camera/run` says it to the machine. The smallest
/// plate has 15 pixels.
const SIZE: Size = Size {
    width: 400,
    height: 300,
};

/// From red, green and blue to the camera's format.
type Encode = fn(&[u8]) -> Vec<u8>;

/// Frames of the demo that are played, forwards and then backwards, so that the loop has no jump.
const N_DRAWN: u64 = 24;

/// Step between them: nine seconds of the demo in all, so that nothing covers a place for half of
/// the frames.
const STEP: u64 = 12;

/// Maximum error of a pose: five times the root mean square of the demo's own frames, which is
/// tested elsewhere.
const CENTRE_MAX_PX: f64 = 1.25;
const HEADING_MAX_RAD: f64 = 0.13;

/// Minimum share of the markers that is found, as documented.
const FOUND_MIN: f64 = 0.98;

/// Fewer scenes than this prove nothing.
const SCENES_MIN: usize = 8;

fn file(name: &str) -> PathBuf {
    let folder = env::var_os("OVERCAM_CAMERA_TEST").expect("OVERCAM_CAMERA_TEST names a folder");
    PathBuf::from(folder).join(name)
}

fn drawn(sequence: u64) -> Frame {
    let mut frame = Frame::empty();
    Floor::new(SIZE, SEED).render(sequence, &mut frame);
    frame
}

/// Luma and blue and red difference in limited range (BT.601, 2.5.3), as cameras deliver them.
fn yuyv(rgb: &[u8]) -> Vec<u8> {
    let ycc = |pixel: &[u8]| {
        let [r, g, b] = [pixel[0], pixel[1], pixel[2]].map(|c| f64::from(c) / 255.0);
        let luma = 0.299 * r + 0.587 * g + 0.114 * b;
        let blue = 128.0 + 224.0 * (b - luma) / 1.772;
        let red = 128.0 + 224.0 * (r - luma) / 1.402;
        [16.0 + 219.0 * luma, blue, red]
    };
    rgb.chunks_exact(6)
        .flat_map(|pair| {
            let (first, second) = (ycc(&pair[..3]), ycc(&pair[3..]));
            let mean = |i: usize| (first[i] + second[i]) / 2.0;
            [first[0], mean(1), second[0], mean(2)].map(|value| value.round() as u8)
        })
        .collect()
}

/// With one chroma sample for two pixels, as in webcams.
fn jpeg(rgb: &[u8]) -> Vec<u8> {
    let mut jpeg = Vec::new();
    let mut encoder = Encoder::new(&mut jpeg, 90);
    encoder.set_sampling_factor(SamplingFactor::F_2_1);
    encoder
        .encode(rgb, SIZE.width as u16, SIZE.height as u16, ColorType::Rgb)
        .expect("encodes");
    jpeg
}

/// Frame numbers of the demo in one round of the feed.
fn round() -> impl Iterator<Item = u64> {
    (0..N_DRAWN).chain((1..N_DRAWN - 1).rev()).map(|i| i * STEP)
}

/// The frames of the feed as the camera delivers them, and their frame numbers in the demo.
fn feed(encode: Encode) -> HashMap<Vec<u8>, u64> {
    (0..N_DRAWN)
        .map(|i| i * STEP)
        .map(|sequence| (encode(&drawn(sequence).bytes), sequence))
        .collect()
}

fn write_feed(name: &str, encode: Encode) {
    let frames: HashMap<u64, Vec<u8>> = feed(encode)
        .into_iter()
        .map(|(bytes, sequence)| (sequence, bytes))
        .collect();
    let bytes: Vec<u8> = round().flat_map(|i| frames[&i].clone()).collect();
    fs::write(file(name), bytes).expect("written");
}

/// A feed of JPEG pictures in which every tenth is truncated somewhere but still has an end marker.
fn write_damaged_feed(name: &str) {
    const END_MARKER: [u8; 2] = [0xff, 0xd9];
    let pictures = round().enumerate().map(|(i, sequence)| {
        let mut picture = jpeg(&drawn(sequence).bytes);
        if i % 10 == 5 {
            // After the headers, which take a few hundred bytes.
            let cut = 1000 + (i * 7919) % (picture.len() - 2000);
            picture.truncate(cut);
            // Half of a marker would combine with the end marker into another one.
            while picture.last() == Some(&0xff) {
                picture.pop();
            }
            picture.extend(END_MARKER);
        }
        picture
    });
    fs::write(file(name), pictures.flatten().collect::<Vec<u8>>()).expect("written");
}

#[test]
#[ignore = "part of tests/camera/run"]
fn write_feeds() {
    write_feed("yuyv.raw", yuyv);
    write_feed("mjpg.mjpg", jpeg);
    write_damaged_feed("damaged.mjpg");
    let floor = Floor::new(SIZE, SEED).background().to_png();
    fs::write(file("floor.png"), floor).expect("written");
}

/// Which frame of the demo each frame of the recording shows.
fn shown(run: &str, feed: &HashMap<Vec<u8>, u64>) -> HashMap<u64, u64> {
    let mut recording = Recording::open(&file(&format!("{run}.mcap"))).expect("a recording");
    let (mut slot, mut shown) = (Slot::empty(), HashMap::new());
    while recording.next(&mut slot).expect("readable to its end") == Next::Frame {
        let frame = feed.get(&slot.frame.bytes);
        let frame = frame.expect("every frame is recorded as the camera delivered it");
        shown.insert(slot.frame.sequence, *frame);
    }
    shown
}

/// The scenes with a frame: an emulated camera may be silent for a while.
fn scenes(run: &str) -> Vec<Value> {
    fs::read_to_string(file(&format!("{run}.json")))
        .expect("JSON lines")
        .lines()
        .map(|line| serde_json::from_str(line).expect("valid JSON"))
        .filter(|scene: &Value| scene["source"] == "running")
        .collect()
}

fn number(object: &Value, key: &str) -> f64 {
    object[key].as_f64().expect("a number")
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad - (angle_rad / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

/// Comparison of a run's scenes with the truth.
#[derive(Debug, Default)]
struct Tally {
    scenes: usize,
    markers: usize,
    markers_found: usize,
    obstacles: usize,
    obstacles_found: usize,
    /// Number of objects where there is none.
    n_false: usize,
    centre_px2: f64,
    heading_rad2: f64,
}

impl Tally {
    /// Adds a scene. Fails on a marker that is absent or different.
    fn add(&mut self, scene: &Value, truth: &[Truth]) {
        self.scenes += 1;
        let objects = scene["objects"].as_array().expect("objects");
        let observed: Vec<&Value> = objects.iter().filter(|o| o["observed"] == true).collect();
        for object in &observed {
            let Some(name) = object["marker"].as_str() else {
                continue;
            };
            let real = truth.iter().find(|t| t.marker == Some(name));
            let real = real.unwrap_or_else(|| panic!("there is no {name}: {object}"));
            let centre_px = (number(object, "x") - real.x).hypot(number(object, "y") - real.y);
            let heading_rad = wrapped(number(object, "heading") - real.heading_rad);
            assert!(
                centre_px < CENTRE_MAX_PX && heading_rad.abs() < HEADING_MAX_RAD,
                "{centre_px} px and {heading_rad} rad between {object} and {real:?}"
            );
            self.markers_found += 1;
            self.centre_px2 += centre_px.powi(2);
            self.heading_rad2 += heading_rad.powi(2);
        }
        let is_real = |object: &Value| {
            truth.iter().any(|real| {
                let away = (number(object, "x") - real.x).hypot(number(object, "y") - real.y);
                away < real.radius_px
            })
        };
        self.n_false += observed.iter().filter(|object| !is_real(object)).count();
        for real in truth {
            if real.marker.is_some() {
                self.markers += 1;
                continue;
            }
            self.obstacles += 1;
            let found = observed.iter().any(|object| {
                let away = (number(object, "x") - real.x).hypot(number(object, "y") - real.y);
                object["kind"] == "obstacle" && away < real.radius_px / 2.0
            });
            self.obstacles_found += usize::from(found);
        }
    }

    fn check(&self) {
        let n = self.markers_found as f64;
        println!(
            "{self:?}: centre {:.3} px, heading {:.2} degrees (root mean square)",
            (self.centre_px2 / n).sqrt(),
            (self.heading_rad2 / n).sqrt().to_degrees()
        );
        assert!(self.scenes >= SCENES_MIN, "{self:?}");
        assert!(n >= FOUND_MIN * self.markers as f64, "{self:?}");
        assert_eq!(self.obstacles_found, self.obstacles, "{self:?}");
        assert_eq!(self.n_false, 0, "{self:?}");
    }
}

/// Which part of the floor a run can see.
#[derive(Clone, Copy)]
enum Visible {
    Everything,
    /// Obstacles that never move are learned as floor. Parked robots are read all the same.
    RobotsAndWhatMoves,
}

impl Visible {
    /// Whether each of the demo's objects is seen, in order.
    fn of(self, floor: &Floor) -> Vec<bool> {
        let places = |sequence| {
            floor
                .truth(sequence)
                .map(|t| (t.x, t.y, t.marker))
                .collect::<Vec<_>>()
        };
        let first = places(0);
        let is_robot = |i: usize| first[i].2.is_some();
        let moves = |i: usize| round().any(|sequence| places(sequence)[i] != first[i]);
        (0..first.len())
            .map(|i| matches!(self, Self::Everything) || is_robot(i) || moves(i))
            .collect()
    }
}

fn compare(run: &str, encode: Encode, visible: Visible) {
    let shown = shown(run, &feed(encode));
    let floor = Floor::new(SIZE, SEED);
    let visible = visible.of(&floor);
    let mut tally = Tally::default();
    for scene in scenes(run) {
        let sequence = scene["sequence"].as_u64().expect("a number");
        // In emulation, learning is so slow that frames are missing from the recording.
        let Some(&frame) = shown.get(&sequence) else {
            continue;
        };
        let truth: Vec<Truth> = floor
            .truth(frame)
            .zip(&visible)
            .filter_map(|(real, visible)| visible.then_some(real))
            .collect();
        tally.add(&scene, &truth);
    }
    tally.check();
}

#[test]
#[ignore = "part of tests/camera/run"]
fn yuyv_shows_everything() {
    compare("yuyv", yuyv, Visible::Everything);
}

#[test]
#[ignore = "part of tests/camera/run"]
fn mjpg_shows_everything() {
    compare("mjpg", jpeg, Visible::Everything);
}

#[test]
#[ignore = "part of tests/camera/run"]
fn damaged_shows_everything_and_nothing_else() {
    compare("damaged", jpeg, Visible::Everything);
}

#[test]
#[ignore = "part of tests/camera/run"]
fn learned_shows_what_moves() {
    compare("learned", yuyv, Visible::RobotsAndWhatMoves);
}
