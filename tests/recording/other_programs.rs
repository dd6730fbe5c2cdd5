//! Files from other programs, and our files in other programs.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use foxglove::Encode;
use foxglove::messages::{Log, RawImage};
use mcap::records::MessageHeader;
use overcam::image::frame::PixelFormat;
use overcam::output::mcap::provenance::Provenance;
use overcam::output::mcap::recover::recover;
use overcam::source::replay::{Recording, ReplayError};

use crate::fixture::{
    Played, SIZE, assert_one_line, eventful_slots, folder, info, play, record, scene,
};

/// An MCAP file from another program: messages on two topics in turn.
fn foreign(path: &Path, topics: [&str; 2], finish: bool) {
    fn channel<T: Encode>(mcap: &mut mcap::Writer<fs::File>, topic: &str) -> u16 {
        let schema = T::get_schema().expect("a Foxglove message has a schema");
        let schema_id = mcap
            .add_schema(&schema.name, &schema.encoding, &schema.data)
            .expect("the schema can be written");
        mcap.add_channel(schema_id, topic, "protobuf", &BTreeMap::new())
            .expect("the channel can be written")
    }
    let file = fs::File::create_new(path).expect("the file can be created");
    let mut mcap = mcap::Writer::new(file).expect("the file can be written");
    for i in 0..4_u32 {
        let topic = topics[i as usize % 2];
        let mut message = Vec::new();
        let channel_id = if topic.contains("image") {
            let image = RawImage {
                width: 2,
                height: 1,
                encoding: "mono8".to_owned(),
                step: 2,
                data: vec![i as u8; 2].into(),
                ..RawImage::default()
            };
            image.encode(&mut message).expect("it can be encoded");
            channel::<RawImage>(&mut mcap, topic)
        } else {
            let log = Log::default();
            log.encode(&mut message).expect("it can be encoded");
            channel::<Log>(&mut mcap, topic)
        };
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: 1_000 + u64::from(i),
            publish_time: 0,
        };
        mcap.write_to_known_channel(&header, &message)
            .expect("the message can be written");
    }
    mcap.flush().expect("the file can be written");
    if finish {
        mcap.finish().expect("the file can be finished");
    } else {
        // Otherwise the writer would complete the file on drop.
        let _ = mcap.into_inner();
    }
}

#[test]
fn the_only_image_topic_of_another_program_is_played() {
    let folder = folder();
    let path = folder.path().join("foreign.mcap");
    foreign(&path, ["/log", "/front/image"], true);
    let (frames, error) = play(&path);
    assert!(error.is_none(), "{error:?}");
    let key = |frame: &Played| (frame.sequence, frame.stamp_ns, frame.bytes.clone());
    let keys: Vec<_> = frames.iter().map(key).collect();
    assert_eq!(keys, [(0, 0, vec![1, 1]), (1, 2, vec![3, 3])]);
    let recording = Recording::open(&path).expect("the file can be opened");
    assert_eq!(*recording.provenance(), Provenance::default());
}

#[test]
fn other_files_of_other_programs_are_refused_with_their_topics() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);

    foreign(&path("two.mcap"), ["/front/image", "/back/image"], true);
    let error = play(&path("two.mcap")).1.expect("two topics are too many");
    assert_one_line(&error, &path("two.mcap"));
    assert!(
        error.to_string().contains("/back/image, /front/image"),
        "{error}"
    );

    foreign(&path("none.mcap"), ["/log", "/log2"], true);
    let error = play(&path("none.mcap")).1.expect("no images");
    assert_one_line(&error, &path("none.mcap"));
    let topics = "/log (foxglove.Log, protobuf), /log2 (foxglove.Log, protobuf)";
    assert!(error.to_string().contains(topics), "{error}");
}

#[test]
fn a_summary_is_neither_needed_nor_trusted() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    foreign(&path("open.mcap"), ["/log", "/front/image"], false);
    let (frames, error) = play(&path("open.mcap"));
    assert_eq!(frames.len(), 2);
    let error = error.expect("the file has no end");
    assert!(matches!(error, ReplayError::Truncated { .. }), "{error}");
    let report = recover(&path("open.mcap"), &path("closed.mcap")).expect("an index can be added");
    assert_eq!(
        (report.messages, report.images, report.duration_ns),
        (4, 2, 3)
    );
    assert_eq!(play(&path("closed.mcap")).0.len(), 2);

    // The summary of another file, which has other topics.
    let summary = |name: &str| {
        let content = fs::read(path(name)).expect("it can be read");
        // A footer of 20 bytes, preceded by 9 bytes, and the magic bytes. It starts with the offset
        // of the summary.
        let footer = content.len() - 8 - 20;
        let place = content[footer..footer + 8].try_into().expect("eight bytes");
        (u64::from_le_bytes(place) as usize, content)
    };
    foreign(&path("other.mcap"), ["/log", "/log2"], true);
    let (place, content) = summary("closed.mcap");
    let (other_place, other) = summary("other.mcap");
    let mut mixed = [&content[..place], &other[other_place..]].concat();
    let footer = mixed.len() - 8 - 20;
    mixed[footer..footer + 8].copy_from_slice(&(place as u64).to_le_bytes());
    fs::write(path("mixed.mcap"), mixed).expect("it can be written");
    let (frames, error) = play(&path("mixed.mcap"));
    assert!(error.is_none(), "{error:?}");
    assert_eq!(frames.len(), 2);
}

#[test]
#[ignore = "needs python3 with mcap and mcap-protobuf-support: cargo test --test recording -- --ignored python"]
fn a_reader_in_python_decodes_every_message() {
    let folder = folder();
    let whole = folder.path().join("run.mcap");
    let mut slots = eventful_slots(PixelFormat::Yuyv, 0);
    // Frames without results of their own: the slot still holds an older scene.
    for slot in &mut slots[..3] {
        slot.scene = scene(1_000, 0);
    }
    record(&whole, &info(PixelFormat::Yuyv, SIZE, true), &slots);
    let recovered = folder.path().join("recovered.mcap");
    recover(&whole, &recovered).expect("a whole recording can be rewritten");
    for path in [whole, recovered] {
        let output = Command::new("python3")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_mcap.py"))
            .arg(&path)
            .output()
            .expect("python3 can be run");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
        assert_eq!(String::from_utf8_lossy(&output.stdout), READ_BY_OTHERS);
    }
}

const READ_BY_OTHERS: &str = "\
metadata overcam controls floor_from_image height images live rate_hz settings source source_format stored_format version \
wall_offset_ns width
attachment markers/drop.svg image/svg+xml
attachment markers/arrow.svg image/svg+xml
attachment calibration.toml application/toml
attachment region.png image/png
attachment background.png image/png
attachment background.png image/png
topic /camera/image foxglove.RawImage 38
topic /camera/passed_over foxglove.RawImage 2
topic /overcam/annotations foxglove.ImageAnnotations 35
topic /overcam/forecasts foxglove.SceneUpdate 35
topic /overcam/log foxglove.Log 1
topic /overcam/obstacles foxglove.SceneUpdate 35
topic /overcam/poses foxglove.PosesInFrame 35
topic /overcam/robots foxglove.SceneUpdate 35
topic /tf foxglove.FrameTransform 1
";
