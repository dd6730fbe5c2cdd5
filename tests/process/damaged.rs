//! Damaged pictures among intact ones: each is skipped, reported and counted, and nothing is seen
//! in it.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use foxglove::Encode;
use foxglove::messages::{CompressedImage, Timestamp};
use imgproc::Size;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use mcap::records::MessageHeader;
use overcam::background::model::BackgroundModel;
use overcam::image::frame::{Frame, PixelFormat};
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::provenance::Provenance;
use overcam::output::mcap::record::Recorder;
use overcam::run::slot::{Next, Slot, SourceInfo};
use overcam::source::demo::Demo;
use serde_json::Value;

use crate::fixture::{Ended, folder, parse, run};

const SIZE: Size = Size {
    width: 320,
    height: 240,
};
const N_FRAMES: u64 = 60;
const PERIOD_NS: u64 = 33_333_333;

/// Frames of the demo as JPEG pictures from cameras and programs, and its empty floor.
static DEMO: LazyLock<(Vec<Vec<u8>>, BackgroundModel)> = LazyLock::new(|| {
    let mut demo = Demo::new(SIZE);
    let mut slot = Slot::empty();
    let mut floor = None;
    let pictures = (0..N_FRAMES as usize).map(|i| {
        assert_eq!(demo.next(&mut slot), Next::Frame);
        floor = floor.take().or(slot.background.take());
        assert_eq!(slot.frame.format, PixelFormat::Rgb);
        let mut jpeg = Vec::new();
        let mut encoder = Encoder::new(&mut jpeg, 92);
        encoder.set_sampling_factor(SamplingFactor::R_4_2_2);
        match i / 10 % 3 {
            0 => {}
            1 => encoder.set_restart_interval(5),
            _ => encoder.set_progressive(true),
        }
        encoder
            .encode(&slot.frame.bytes, 320, 240, ColorType::Rgb)
            .expect("it can be encoded");
        jpeg
    });
    let pictures = pictures.collect();
    (pictures, floor.expect("the demo knows its floor"))
});

/// The pictures, every tenth of them truncated somewhere. Half of these have an end marker after
/// the cut.
fn damaged() -> Vec<Vec<u8>> {
    let mut pictures = DEMO.0.clone();
    let mut state = 7_usize;
    for (i, picture) in pictures.iter_mut().skip(3).step_by(10).enumerate() {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        // Cut off more than the end marker.
        picture.truncate((state >> 33) % (picture.len() - 2));
        if i % 2 == 0 {
            picture.extend([0xff, 0xd9]);
        }
    }
    pictures
}

fn write_folder(folder: &Path, pictures: &[Vec<u8>]) {
    fs::create_dir(folder).expect("the folder can be made");
    for (i, picture) in pictures.iter().enumerate() {
        fs::write(folder.join(format!("{i}.jpg")), picture).expect("it can be written");
    }
}

/// A camera recording by another program.
fn write_foreign(path: &Path, pictures: &[Vec<u8>]) {
    let file = fs::File::create_new(path).expect("the file can be created");
    let mut mcap = mcap::Writer::new(file).expect("it can be written");
    let schema = CompressedImage::get_schema().expect("a Foxglove message has a schema");
    let schema_id = mcap
        .add_schema(&schema.name, &schema.encoding, &schema.data)
        .expect("the schema can be written");
    let channel_id = mcap
        .add_channel(schema_id, "/camera", "protobuf", &BTreeMap::new())
        .expect("the channel can be written");
    for (i, picture) in (0..).zip(pictures) {
        let moment = 1_700_000_000_000_000_000 + i * PERIOD_NS;
        let image = CompressedImage {
            timestamp: Some(Timestamp::new(
                (moment / 1_000_000_000) as u32,
                (moment % 1_000_000_000) as u32,
            )),
            frame_id: "camera".to_owned(),
            data: picture.clone().into(),
            format: "image/jpeg".to_owned(),
        };
        let mut message = Vec::new();
        image.encode(&mut message).expect("it can be encoded");
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: moment + 5_000_000,
            publish_time: 0,
        };
        mcap.write_to_known_channel(&header, &message)
            .expect("the message can be written");
    }
    mcap.finish().expect("the file can be finished");
}

/// A recording as overcam made it before it checked pictures.
fn write_recording(path: &Path, pictures: &[Vec<u8>]) {
    let info = SourceInfo {
        name: "a camera".to_owned(),
        size: SIZE,
        format: PixelFormat::Jpeg,
        rate_hz: Some(30.0),
        live: true,
        controls: None,
    };
    let provenance = Provenance {
        version: "0.1.0".to_owned(),
        source: "a camera".to_owned(),
        ..Provenance::default()
    };
    let mut recorder = Recorder::create(path, &info, &provenance, ImageMode::Lossless)
        .expect("the recording can be created");
    let mut slot = Slot::empty();
    for (sequence, picture) in (0..).zip(pictures) {
        slot.frame = Frame {
            sequence,
            stamp_ns: sequence * PERIOD_NS,
            format: PixelFormat::Jpeg,
            full_range: true,
            size: SIZE,
            bytes: picture.clone(),
        };
        recorder.write(&slot).expect("the frame can be written");
    }
    recorder.finish().expect("the recording can be finished");
}

fn locate(folder: &Path, device: &str) -> Ended {
    fs::write(folder.join("floor.png"), DEMO.1.to_png()).expect("it can be written");
    let arguments = [
        "--device",
        device,
        "--background",
        "floor.png",
        "--json",
        "--no-publish",
    ];
    let ended = run(folder, &arguments);
    assert_eq!(ended.status, Some(0), "{device}: {:?}", ended.errors);
    ended
}

/// Positions of the observed objects, by frame.
fn seen(ended: &Ended) -> BTreeMap<u64, Vec<[f64; 2]>> {
    let objects = |scene: &Value| {
        let objects = scene["objects"].as_array().expect("a list").iter();
        let observed = objects.filter(|object| object["observed"] == true);
        observed
            .map(|object| ["x", "y"].map(|key| object[key].as_f64().expect("a number")))
            .collect()
    };
    ended
        .lines
        .iter()
        .map(|line| parse(line))
        .map(|scene| {
            (
                scene["sequence"].as_u64().expect("a number"),
                objects(&scene),
            )
        })
        .collect()
}

#[test]
fn nothing_is_seen_in_truncated_pictures() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write_folder(&path("whole"), &DEMO.0);
    let truth = seen(&locate(folder.path(), "whole"));
    assert_eq!(truth.len(), 60);
    assert!(truth[&59].len() > 7, "{:?}", truth[&59]);

    let damaged = damaged();
    write_folder(&path("cut"), &damaged);
    write_foreign(&path("foreign.mcap"), &damaged);
    write_recording(&path("own.mcap"), &damaged);
    for device in ["cut", "foreign.mcap", "own.mcap"] {
        let ended = locate(folder.path(), device);
        let counted = ended.errors.iter().find(|line| line.contains("frames: "));
        let counted = counted.expect("the books are told");
        assert!(counted.ends_with(", 6 faulty"), "{device}: {counted}");
        let told = ended
            .errors
            .iter()
            .filter(|line| line.contains("passed over") && !line.contains("frames: "));
        assert_eq!(told.count(), 6, "{device}: {:?}", ended.errors);
        let found = seen(&ended);
        for sequence in found.keys() {
            assert_ne!(sequence % 10, 3, "{device}: frame {sequence} gave results");
        }
        assert_eq!(found.len(), 54, "{device}");
        for (sequence, objects) in &found {
            for [x, y] in objects {
                let near = |[other_x, other_y]: &[f64; 2]| (x - other_x).hypot(y - other_y) < 3.0;
                assert!(
                    truth[sequence].iter().any(near),
                    "{device}: frame {sequence}: {x}, {y} of {:?}",
                    truth[sequence]
                );
            }
        }
    }
}

#[test]
fn a_run_fails_when_no_picture_can_be_read() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let cut: Vec<Vec<u8>> = DEMO.0[..5]
        .iter()
        .map(|picture| picture[..picture.len() / 2].to_vec())
        .collect();
    write_folder(&path("cut"), &cut);
    write_foreign(&path("foreign.mcap"), &cut);
    write_recording(&path("own.mcap"), &cut);
    for device in ["cut", "foreign.mcap", "own.mcap"] {
        let ended = run(
            folder.path(),
            &["--device", device, "--learn", "1", "--no-publish"],
        );
        assert_eq!(ended.status, Some(1), "{device}: {:?}", ended.errors);
        let last = ended.errors.last().expect("it is told");
        assert!(
            last.starts_with("overcam: ") && last.contains("JPEG picture cut off"),
            "{last}"
        );
    }
}

#[test]
fn a_recording_with_skipped_pictures_gives_the_same_lines() {
    let folder = folder();
    write_recording(&folder.path().join("own.mcap"), &damaged());
    let learn = [
        "--device",
        "own.mcap",
        "--learn",
        "15",
        "--json",
        "--no-publish",
    ];
    let first = run(
        folder.path(),
        &[&learn[..], &["--record", "again.mcap"]].concat(),
    );
    assert_eq!(first.status, Some(0), "{:?}", first.errors);
    let again = run(
        folder.path(),
        &["--device", "again.mcap", "--json", "--no-publish"],
    );
    assert_eq!(again.lines, first.lines);
}

#[test]
fn a_floor_is_learned_from_the_pictures_that_can_be_read() {
    let folder = folder();
    write_folder(&folder.path().join("cut"), &damaged());
    let ended = run(
        folder.path(),
        &[
            "background",
            "--device",
            "cut",
            "-o",
            "floor.png",
            "--learn",
            "15",
        ],
    );
    assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
    assert!(
        ended.said("3.jpg") && ended.said("passed over"),
        "{:?}",
        ended.errors
    );
}
