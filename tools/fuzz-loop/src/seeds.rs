//! Small whole files of each kind, made by overcam itself where it writes such files.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;

use foxglove::Encode;
use foxglove::messages::{CompressedImage, RawImage, Timestamp};
use imgproc::Size;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use mcap::read::ChunkFlattener;
use mcap::records::{MessageHeader, Record};
use mcap::{Attachment, WriteOptions, Writer};
use overcam::background::model::BackgroundModel;
use overcam::image::frame::{Frame, Picture, PixelFormat};
use overcam::image::picture_file::write_png;
use overcam::marker::built_in_files;
use overcam::output::foxglove::image_message::ImageMode;
use overcam::output::mcap::provenance::Provenance;
use overcam::output::mcap::record::Recorder;
use overcam::run::slot::{Slot, SourceInfo};
use overcam::settings::Settings;
use scene::Scene;

use crate::folder::Folder;

const SIZE: Size = Size {
    width: 16,
    height: 12,
};

/// Bytes of a gradient with something in it.
fn pixels(n: usize) -> Vec<u8> {
    (0..n).map(|i| (i * 7 % 251) as u8).collect()
}

fn picture() -> Picture {
    let plane = pixels(SIZE.area());
    Picture {
        size: SIZE,
        red: plane.clone(),
        green: plane.iter().rev().copied().collect(),
        blue: plane,
    }
}

/// Streams of each layout that is read.
#[must_use]
pub fn y4m() -> Vec<Vec<u8>> {
    let stream = |tags: &str, n_bytes: usize| {
        let mut stream = format!("YUV4MPEG2 W16 H12 F30:1 {tags}\n").into_bytes();
        for _ in 0..3 {
            stream.extend(b"FRAME\n");
            stream.extend(pixels(n_bytes));
        }
        stream
    };
    vec![
        stream("Ip A1:1 C420jpeg XYSCSS=420JPEG XCOLORRANGE=FULL", 288),
        stream("Ip A0:0 C422 XCOLORRANGE=LIMITED", 384),
        stream("C444", 576),
        stream("Cmono", 192),
        stream("", 288),
    ]
}

/// Recordings as overcam writes them, and files of other programs; each also without compression
/// and check sums, so that a change gets past them.
#[must_use]
pub fn mcap() -> Vec<Vec<u8>> {
    let mut files = vec![
        recording(PixelFormat::Yuyv, &pixels(2 * SIZE.area())),
        recording(PixelFormat::Jpeg, &jpeg()[0]),
    ];
    for use_chunks in [false, true] {
        let bare: Vec<_> = files[..2]
            .iter()
            .map(|file| bare(file, use_chunks))
            .collect();
        files.extend(bare);
        files.push(foreign(use_chunks, "/image", raw_image));
        files.push(foreign(use_chunks, "/image", compressed_image));
    }
    files
}

fn recording(format: PixelFormat, bytes: &[u8]) -> Vec<u8> {
    let folder = Folder::new();
    let path = folder.path().join("run.mcap");
    let info = SourceInfo {
        name: "camera".to_owned(),
        size: SIZE,
        format,
        rate_hz: Some(30.0),
        live: false,
        controls: Some("locked gain 3".to_owned()),
    };
    let provenance = Provenance {
        version: "0.1.0".to_owned(),
        source: "camera".to_owned(),
        settings: toml::to_string(&Settings::default()).expect("settings can be written"),
        markers: built_in_files()[..2].to_vec(),
        calibration: Some(CALIBRATION.to_owned()),
        region: Some(write_png(&picture())),
        floor_from_image: Some([[0.01, 0.0, -1.0], [0.0, -0.01, 2.0], [0.0, 0.0, 1.0]]),
    };
    let mut recorder = Recorder::create(&path, &info, &provenance, ImageMode::Lossless)
        .expect("the recording can be created");
    for i in 0..3 {
        let mut scene = Box::new(Scene::EMPTY);
        (scene.sequence, scene.stamp_ns) = (i, i * 33_333_333);
        let slot = Slot {
            frame: Frame {
                sequence: i,
                stamp_ns: i * 33_333_333,
                format,
                full_range: false,
                size: SIZE,
                bytes: bytes.to_vec(),
            },
            skipped: i == 1,
            background: (i == 0).then(|| BackgroundModel::from_picture(&picture())),
            floor_in_use: None,
            scene,
        };
        recorder.write(&slot).expect("the frame can be written");
    }
    recorder.finish().expect("the recording can be finished");
    fs::read(path).expect("the recording can be read")
}

fn writer(use_chunks: bool) -> Writer<Cursor<Vec<u8>>> {
    WriteOptions::new()
        .compression(None)
        .use_chunks(use_chunks)
        .calculate_chunk_crcs(false)
        .calculate_data_section_crc(false)
        .calculate_summary_section_crc(false)
        .calculate_attachment_crcs(false)
        .create(Cursor::new(Vec::new()))
        .expect("memory can be written")
}

fn closed(mut writer: Writer<Cursor<Vec<u8>>>) -> Vec<u8> {
    writer.finish().expect("memory can be written");
    writer.into_inner().into_inner()
}

/// A file with all that is in another one.
fn bare(file: &[u8], use_chunks: bool) -> Vec<u8> {
    let mut writer = writer(use_chunks);
    let mut schemas = BTreeMap::new();
    let mut channels = BTreeMap::new();
    for record in ChunkFlattener::new(file).expect("a whole file") {
        let written = match record.expect("a whole file") {
            Record::Schema { header, data } => writer
                .add_schema(&header.name, &header.encoding, &data)
                .map(|id| _ = schemas.insert(header.id, id)),
            Record::Channel(channel) => writer
                .add_channel(
                    schemas[&channel.schema_id],
                    &channel.topic,
                    &channel.message_encoding,
                    &channel.metadata,
                )
                .map(|id| _ = channels.insert(channel.id, id)),
            Record::Message { mut header, data } => {
                header.channel_id = channels[&header.channel_id];
                writer.write_to_known_channel(&header, &data)
            }
            Record::Attachment { header, data, .. } => writer.attach(&Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data,
            }),
            Record::Metadata(metadata) => writer.write_metadata(&metadata),
            // The summary, which says all that again.
            Record::DataEnd(_) => break,
            _ => Ok(()),
        };
        written.expect("memory can be written");
    }
    closed(writer)
}

type Message = (Option<foxglove::Schema>, Vec<u8>);

fn message<T: Encode>(image: &T) -> Message {
    let mut bytes = Vec::new();
    image.encode(&mut bytes).expect("memory can be written");
    (T::get_schema(), bytes)
}

fn raw_image(i: u32) -> Message {
    message(&RawImage {
        timestamp: Some(Timestamp::new(100, i * 1_000_000)),
        width: 4,
        height: 2,
        encoding: "rgb8".to_owned(),
        step: 12,
        data: pixels(24).into(),
        ..RawImage::default()
    })
}

fn compressed_image(i: u32) -> Message {
    message(&CompressedImage {
        timestamp: Some(Timestamp::new(100, i * 1_000_000)),
        data: jpeg().swap_remove(0).into(),
        format: "jpeg".to_owned(),
        ..CompressedImage::default()
    })
}

fn foreign(use_chunks: bool, topic: &str, image: fn(u32) -> Message) -> Vec<u8> {
    let mut writer = writer(use_chunks);
    for i in 0..3 {
        let (schema, bytes) = image(i);
        let schema = schema.expect("an image has a schema");
        let schema_id = writer.add_schema(&schema.name, &schema.encoding, &schema.data);
        let schema_id = schema_id.expect("memory can be written");
        let channel_id = writer.add_channel(schema_id, topic, "protobuf", &BTreeMap::new());
        let header = MessageHeader {
            channel_id: channel_id.expect("memory can be written"),
            sequence: i,
            log_time: 1_000_000 * u64::from(i),
            publish_time: 0,
        };
        let written = writer.write_to_known_channel(&header, &bytes);
        written.expect("memory can be written");
    }
    closed(writer)
}

/// Pictures of each kind that cameras and programs write: sub-sampled, grey, progressive, with
/// restarts, without tables.
#[must_use]
pub fn jpeg() -> Vec<Vec<u8>> {
    let encoded = |colour: ColorType, set: fn(&mut Encoder<&mut Vec<u8>>)| {
        let mut file = Vec::new();
        let mut encoder = Encoder::new(&mut file, 90);
        set(&mut encoder);
        let n = if colour == ColorType::Luma { 1 } else { 3 };
        encoder
            .encode(
                &pixels(n * SIZE.area()),
                SIZE.width as u16,
                SIZE.height as u16,
                colour,
            )
            .expect("a picture can be encoded");
        file
    };
    let mut files = vec![
        encoded(ColorType::Rgb, |e| {
            e.set_sampling_factor(SamplingFactor::F_2_1);
        }),
        encoded(ColorType::Rgb, |e| {
            e.set_sampling_factor(SamplingFactor::F_2_2);
        }),
        encoded(ColorType::Luma, |_| {}),
        encoded(ColorType::Rgb, |e| e.set_progressive(true)),
        encoded(ColorType::Rgb, |e| e.set_restart_interval(1)),
    ];
    files.push(without_tables(&files[0]));
    files
}

/// The picture without its Huffman tables, as cameras leave them out.
fn without_tables(jpeg: &[u8]) -> Vec<u8> {
    const DEFINE_TABLES: u8 = 0xc4;
    const START_OF_SCAN: u8 = 0xda;
    let (mut at, mut left) = (2, jpeg[..2].to_vec());
    while let [0xff, marker, high, low, ..] = jpeg[at..]
        && marker != START_OF_SCAN
    {
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker != DEFINE_TABLES {
            left.extend(&jpeg[at..end]);
        }
        at = end;
    }
    left.extend(&jpeg[at..]);
    left
}

/// A floor with its noise, a picture, and what other programs write: grey, a palette, and 16 bits
/// of which not all are used.
#[must_use]
pub fn png() -> Vec<Vec<u8>> {
    let encoded = |colour, depth, bytes: &[u8], set: fn(&mut png::Encoder<&mut Vec<u8>>)| {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, SIZE.width as u32, SIZE.height as u32);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        set(&mut encoder);
        let mut writer = encoder.write_header().expect("memory can be written");
        writer
            .write_image_data(bytes)
            .expect("memory can be written");
        writer.finish().expect("memory can be written");
        file
    };
    let deep: Vec<u8> = (0..SIZE.area() as u16)
        .flat_map(|i| (i * 5).to_be_bytes())
        .collect();
    vec![
        BackgroundModel::from_picture(&picture()).to_png(),
        write_png(&picture()),
        encoded(
            png::ColorType::Grayscale,
            png::BitDepth::Sixteen,
            &deep,
            |_| {},
        ),
        encoded(
            png::ColorType::GrayscaleAlpha,
            png::BitDepth::Eight,
            &pixels(2 * SIZE.area()),
            |_| {},
        ),
        encoded(
            png::ColorType::Indexed,
            png::BitDepth::Two,
            &pixels(SIZE.area() / 4),
            |encoder| {
                encoder.set_palette(pixels(12));
                encoder.set_trns(vec![255, 128, 0, 255]);
            },
        ),
    ]
}

/// The built-in markers, and drawings with what drawing programs add.
#[must_use]
pub fn svg() -> Vec<Vec<u8>> {
    let mut files: Vec<Vec<u8>> = built_in_files()
        .into_iter()
        .map(|file| file.svg.into_bytes())
        .collect();
    let drawings = [
        "<rect width='100' height='100' fill='#fff'/><g transform='translate(50 50) rotate(30) scale(.5)'>\
         <path id='a' fill='#000' d='M-40-40L40-20C30 10 20 30 0 40A30 30 0 0 1-40-40z'/></g>",
        "<style>.a{fill:#000}</style><defs><path id='p' d='M20 20h50l10 40-30 20z'/></defs><use class='a' href='#p'/>",
        "<defs><clipPath id='c'><rect width='90' height='90'/></clipPath></defs><polygon clip-path='url(#c)' \
         points='20,20 70,30 60,80 30,60'/>",
    ];
    files.extend(drawings.map(|drawing| {
        let head = "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 100 100'>";
        format!("<?xml version='1.0'?>{head}{drawing}</svg>").into_bytes()
    }));
    files
}

const CALIBRATION: &str = "\
[[points]]
pixel = [0.0, 0.0]
floor = [0.0, 4.8]

[[points]]
pixel = [639.0, 0.0]
floor = [6.39, 4.8]

[[points]]
pixel = [639.0, 479.0]
floor = [6.39, 0.01]

[[points]]
pixel = [0.0, 479.0]
floor = [0.0, 0.01]
";

/// Four points, as few as there may be, and five that do not quite agree.
#[must_use]
pub fn calibration() -> Vec<Vec<u8>> {
    let fifth = "\n[[points]]\npixel = [320.0, 240.0]\nfloor = [3.21, 2.41]\n";
    vec![CALIBRATION.into(), [CALIBRATION, fifth].concat().into()]
}

/// Those that recordings have.
#[must_use]
pub fn settings() -> Vec<Vec<u8>> {
    let with_plates = Settings {
        plate_mm: Some(60.0),
        ..Settings::default()
    };
    [Settings::default(), with_plates]
        .iter()
        .map(|settings| toml::to_string(settings).expect("settings can be written"))
        .map(String::into_bytes)
        .collect()
}
