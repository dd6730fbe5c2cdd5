//! What the tests record, and what they read back.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use imgproc::Size;
use overcam::background::model::BackgroundModel;
use overcam::image::frame::{Frame, Picture, PixelFormat};
use overcam::marker::MarkerFile;
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::provenance::Provenance;
use overcam::output::mcap::record::{Recorder, Summary};
use overcam::run::slot::{Next, Slot, SourceInfo};
use overcam::source::replay::{Recording, ReplayError};
use random::SplitMix64;
use scene::{
    FRAME_FLOOR, ForecastPoint, HAS_HEADING, KIND_MARKER, KIND_OBSTACLE, OBSERVED, Object, Scene,
};
use tempfile::TempDir;

pub(crate) const SIZE: Size = Size {
    width: 64,
    height: 48,
};
pub(crate) const PERIOD_NS: u64 = 33_333_333;

pub(crate) fn info(format: PixelFormat, size: Size, live: bool) -> SourceInfo {
    SourceInfo {
        name: "test source".to_owned(),
        size,
        format,
        rate_hz: Some(30.0),
        live,
        controls: Some("locked exposure 15600 us".to_owned()),
    }
}

pub(crate) fn provenance() -> Provenance {
    let marker = |name: &str| MarkerFile {
        name: name.to_owned(),
        svg: format!("<svg><title>{name}</title></svg>"),
    };
    Provenance {
        version: "0.1.0".to_owned(),
        source: "test source".to_owned(),
        settings: "threshold = 24\n".to_owned(),
        markers: vec![marker("drop"), marker("arrow")],
        calibration: Some("points = []\n".to_owned()),
        region: Some(noise(300, 50)),
        floor_from_image: Some([[0.01, 0.0, -1.0], [0.0, -0.01, 2.0], [0.0, 0.0, 1.0]]),
    }
}

/// Bytes without a pattern that a compressor could use.
pub(crate) fn noise(seed: u64, n_bytes: usize) -> Vec<u8> {
    let mut random = SplitMix64(seed);
    (0..n_bytes).map(|_| random.byte()).collect()
}

pub(crate) fn floor(seed: u64, size: Size) -> BackgroundModel {
    let picture = Picture {
        size,
        red: noise(seed, size.area()),
        green: noise(seed + 1, size.area()),
        blue: noise(seed + 2, size.area()),
    };
    BackgroundModel {
        picture,
        noise: noise(seed + 3, size.area()),
    }
}

/// A robot and an obstacle, in metres.
pub(crate) fn scene(sequence: u64, stamp_ns: u64) -> Box<Scene> {
    let mut robot = Object {
        track: 3,
        x: 0.5,
        y: 1.0,
        heading_rad: 1.0,
        size: 0.2,
        kind: KIND_MARKER,
        flags: OBSERVED | HAS_HEADING,
        n_outline: 3,
        n_forecast: 1,
        ..Object::EMPTY
    };
    robot.marker[..4].copy_from_slice(b"drop");
    robot.outline[..3].copy_from_slice(&[[0.4, 0.9], [0.6, 0.9], [0.5, 1.1]]);
    robot.forecast[0] = ForecastPoint {
        dt_s: 0.1,
        x: 0.6,
        y: 1.1,
        ..ForecastPoint::EMPTY
    };
    let obstacle = Object {
        track: 5,
        size: 0.1,
        kind: KIND_OBSTACLE,
        ..Object::EMPTY
    };
    let mut scene = Box::new(Scene::EMPTY);
    (scene.sequence, scene.stamp_ns) = (sequence, stamp_ns);
    scene.frame = FRAME_FLOOR;
    scene.n_objects = 2;
    scene.objects[..2].copy_from_slice(&[robot, obstacle]);
    scene
}

pub(crate) fn slot(format: PixelFormat, size: Size, sequence: u64, stamp_ns: u64) -> Slot {
    // Writing and reading never decode a JPEG picture.
    let n_bytes = format.frame_bytes(size).unwrap_or(777);
    Slot {
        frame: Frame {
            sequence,
            stamp_ns,
            format,
            full_range: false,
            size,
            bytes: noise(sequence, n_bytes),
        },
        skipped: false,
        background: None,
        floor_in_use: None,
        scene: scene(sequence, stamp_ns),
    }
}

/// Frames at 30 per second from `first_ns` on.
pub(crate) fn slots(format: PixelFormat, n: u64, first_ns: u64) -> Vec<Slot> {
    (0..n)
        .map(|i| slot(format, SIZE, i, first_ns + i * PERIOD_NS))
        .collect()
}

/// A run with every kind of event: gaps, skipped frames, another background, another colour range.
pub(crate) fn eventful_slots(format: PixelFormat, first_ns: u64) -> Vec<Slot> {
    let mut slots = slots(format, 40, first_ns);
    slots[0].background = Some(floor(100, SIZE));
    slots[7].skipped = true;
    slots[20].background = Some(floor(200, SIZE));
    slots[20].skipped = true;
    slots[21].frame.full_range = true;
    for slot in &mut slots[30..] {
        slot.frame.sequence += 5;
        slot.frame.stamp_ns += 3_000_000_001;
        slot.scene = scene(slot.frame.sequence, slot.frame.stamp_ns);
    }
    slots
}

pub(crate) fn record(path: &Path, info: &SourceInfo, slots: &[Slot]) -> Summary {
    let mut recorder = Recorder::create(path, info, &provenance(), ImageMode::Lossless)
        .expect("the recording can be created");
    for slot in slots {
        recorder.write(slot).expect("the frame can be written");
    }
    recorder.finish().expect("the recording can be finished")
}

/// Everything in a slot that a recording restores.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Played {
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: u64,
    pub(crate) format: PixelFormat,
    pub(crate) full_range: bool,
    pub(crate) size: Size,
    pub(crate) bytes: Vec<u8>,
    pub(crate) skipped: bool,
    pub(crate) background: Option<BackgroundModel>,
}

pub(crate) fn played(slot: &Slot) -> Played {
    Played {
        sequence: slot.frame.sequence,
        stamp_ns: slot.frame.stamp_ns,
        format: slot.frame.format,
        full_range: slot.frame.full_range,
        size: slot.frame.size,
        bytes: slot.frame.bytes.clone(),
        skipped: slot.skipped,
        background: slot.background.clone(),
    }
}

pub(crate) fn play(path: &Path) -> (Vec<Played>, Option<ReplayError>) {
    let mut recording = match Recording::open(path) {
        Ok(recording) => recording,
        Err(error) => return (Vec::new(), Some(error)),
    };
    // Leftovers of an earlier frame must not show.
    let mut slot = slot(PixelFormat::Rgb, SIZE, 999, 999);
    slot.skipped = true;
    slot.background = Some(floor(1, SIZE));
    let mut frames = Vec::new();
    loop {
        match recording.next(&mut slot) {
            Ok(Next::Frame) => frames.push(played(&slot)),
            Ok(Next::End) => return (frames, None),
            Ok(Next::Nothing) => panic!("a file has no pauses"),
            Err(error) => {
                let after = recording.next(&mut slot);
                assert!(matches!(after, Ok(Next::End)), "{after:?} after {error}");
                return (frames, Some(error));
            }
        }
    }
}

pub(crate) fn assert_one_line(error: &dyn std::error::Error, object: &Path) {
    let line = error.to_string();
    assert!(!line.contains('\n'), "{line}");
    assert!(line.contains(&object.display().to_string()), "{line}");
}

pub(crate) fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder can be made")
}

/// The bytes of a recording of 40 eventful frames, and the frames.
pub(crate) static EVENTFUL: LazyLock<(Vec<u8>, Vec<Played>)> = LazyLock::new(|| {
    let folder = folder();
    let path = folder.path().join("whole.mcap");
    let slots = eventful_slots(PixelFormat::Grey, 0);
    record(&path, &info(PixelFormat::Grey, SIZE, false), &slots);
    let content = fs::read(&path).expect("the file can be read");
    (content, slots.iter().map(played).collect())
});
