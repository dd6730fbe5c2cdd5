//! One function for each kind of file. Each returns whether the file was read to its end.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use imgproc::Size;
use overcam::background::model::BackgroundModel;
use overcam::background::region::Region;
use overcam::geometry::calibration::Calibration;
use overcam::image::frame::{Frame, Picture, PixelFormat, decode};
use overcam::image::jpeg as jpeg_pictures;
use overcam::marker::drawing::read_drawing;
use overcam::marker::read_folder;
use overcam::output::mcap::recover::recover;
use overcam::run::slot::{Next, Slot};
use overcam::settings::Settings;
use overcam::source::replay::Recording;
use overcam::source::y4m::Y4m;

use crate::folder::Folder;

/// Frames that are read of one file: more of them go the same ways.
const FRAMES_MAX: usize = 64;

/// A Y4M stream.
pub fn y4m(file: &[u8]) -> bool {
    let Ok(mut stream) = Y4m::new("fuzz".to_owned(), Cursor::new(file)) else {
        return false;
    };
    let (mut frame, mut picture) = (Frame::empty(), Picture::new(EMPTY));
    for _ in 0..FRAMES_MAX {
        match stream.next(&mut frame) {
            Ok(Next::Frame) => {
                decode(&frame, &mut picture).expect("a frame of a stream has its size");
            }
            Ok(_) => return true,
            Err(_) => return false,
        }
    }
    true
}

/// An MCAP file, overcam's own or not: as a source of frames, with everything that a replay reads
/// of it, and rewritten by `overcam recover`.
pub fn mcap(file: &[u8]) -> bool {
    let folder = Folder::new();
    let path = folder.path().join("fuzz.mcap");
    fs::write(&path, file).expect("a file can be written there");
    let recovered = folder.path().join("recovered.mcap");
    let is_recovered = recover(&path, &recovered).is_ok();
    let is_played = play(&path);
    if is_recovered {
        play(&recovered);
    }
    is_played && is_recovered
}

fn play(path: &Path) -> bool {
    let Ok(mut recording) = Recording::open(path) else {
        return false;
    };
    let (mut slot, mut picture) = (Slot::empty(), Picture::new(EMPTY));
    for _ in 0..FRAMES_MAX {
        match recording.next(&mut slot) {
            Ok(Next::Frame) => {
                // A damaged JPEG picture in overcam's own recording is found only here.
                let _ = decode(&slot.frame, &mut picture);
            }
            Ok(_) => break,
            Err(_) => return false,
        }
    }
    let provenance = recording.provenance();
    settings(provenance.settings.as_bytes());
    if let Some(text) = &provenance.calibration {
        calibration(text.as_bytes());
    }
    if let Some(png) = &provenance.region {
        let _ = Region::from_png(png, "fuzz", recording.info().size);
    }
    true
}

/// A JPEG picture.
pub fn jpeg(file: &[u8]) -> bool {
    let Ok(size) = jpeg_pictures::size(file) else {
        return false;
    };
    let frame = Frame {
        format: PixelFormat::Jpeg,
        size,
        bytes: file.to_vec(),
        ..Frame::empty()
    };
    let mut picture = Picture::new(EMPTY);
    decode(&frame, &mut picture).is_ok()
}

/// A PNG picture of the floor or of a region. Twice: once as it is, once with right check sums,
/// which a mutation hardly meets.
pub fn png(file: &[u8]) -> bool {
    let read = |file: &[u8]| {
        let floor = BackgroundModel::from_png(file);
        if let Ok(floor) = &floor {
            let _ = Region::from_png(file, "fuzz", floor.picture.size);
        }
        floor.is_ok()
    };
    let as_it_is = read(file);
    read(&with_right_sums(file)) || as_it_is
}

/// The drawing of a marker: in its folder, whatever its encoding.
pub fn svg(file: &[u8]) -> bool {
    let folder = Folder::new();
    fs::write(folder.path().join("fuzz.svg"), file).expect("a file can be written there");
    let Ok(files) = read_folder(folder.path()) else {
        return false;
    };
    read_drawing("fuzz", &files[0].svg).is_ok()
}

/// A calibration file.
pub fn calibration(file: &[u8]) -> bool {
    let Ok(calibration) = Calibration::from_toml(&String::from_utf8_lossy(file)) else {
        return false;
    };
    let _ = (calibration.metres_per_px(), calibration.residual_px());
    for pixel in [[0.0, 0.0], [319.5, 239.5], [16_383.0, 16_383.0]] {
        if let Some(point) = calibration.to_floor(pixel) {
            let _ = (point.metres_per_px(), point.heading(1.0));
            let _ = point.covariance([[1.0, 0.0], [0.0, 1.0]]);
        }
    }
    true
}

/// The settings in a recording.
pub fn settings(file: &[u8]) -> bool {
    let settings = toml::from_str::<Settings>(&String::from_utf8_lossy(file));
    let Some(settings) = settings.ok().filter(|settings| settings.check().is_ok()) else {
        return false;
    };
    // Whatever is in range can be recorded, and is the same when it is replayed.
    let text = toml::to_string(&settings).expect("settings can be written");
    assert_eq!(toml::from_str(&text), Ok(settings));
    true
}

const EMPTY: Size = Size {
    width: 0,
    height: 0,
};

/// The PNG file with the check sum of each chunk set right, as far as its lengths lead.
fn with_right_sums(file: &[u8]) -> Vec<u8> {
    let mut file = file.to_vec();
    let mut at = 8;
    while let Some(length) = file.get(at..at + 4) {
        let length = u32::from_be_bytes(length.try_into().expect("four bytes")) as usize;
        let end = at + 8 + length;
        if file.len() < end + 4 {
            break;
        }
        let sum = crc32(&file[at + 4..end]);
        file[end..end + 4].copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
    file
}

/// The check sum of PNG (W3C, annex D).
fn crc32(bytes: &[u8]) -> u32 {
    let sum = bytes.iter().fold(u32::MAX, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| {
            (sum >> 1) ^ if sum & 1 == 1 { 0xedb8_8320 } else { 0 }
        })
    });
    !sum
}
