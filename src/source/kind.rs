//! Determines the kind of a path, from its file type and its first bytes. Names are not used: a
//! camera's stable name ends in `1.0-video-index0`, a link may have any name, and renaming a file
//! does not convert it.

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Number of bytes examined.
const FIRST_BYTES: u64 = 512;

/// Kinds of sources.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A character device, which may be a camera.
    Device,
    Folder,
    Recording,
    Y4m,
    /// Its content is unknown until it is read.
    Pipe,
    /// Not a source: what it is and what to do with it.
    Other(String),
}

/// Follows links and examines the target. A pipe is not opened.
pub(super) fn of(path: &Path) -> io::Result<Kind> {
    let file_type = path.metadata()?.file_type();
    if file_type.is_char_device() {
        return Ok(Kind::Device);
    }
    if file_type.is_dir() {
        return Ok(Kind::Folder);
    }
    if file_type.is_fifo() {
        return Ok(Kind::Pipe);
    }
    if !file_type.is_file() {
        return Ok(Kind::Other(format!("not a source of frames; {SOURCES}")));
    }
    let mut first = Vec::new();
    File::open(path)?
        .take(FIRST_BYTES)
        .read_to_end(&mut first)?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    Ok(of_file(&first, extension.as_deref(), path))
}

const SOURCES: &str =
    "give a camera, an MCAP or Y4M file, a folder of pictures, or - for Y4M on standard input";

/// A file signature: name of the format, byte offset, and bytes.
type Signature = (&'static str, usize, &'static [u8]);

const VIDEOS: [Signature; 14] = [
    ("an MP4 or QuickTime video", 4, b"ftyp"),
    ("a QuickTime video", 4, b"moov"),
    ("a QuickTime video", 4, b"mdat"),
    ("an AVI video", 8, b"AVI "),
    ("a Matroska or WebM video", 0, b"\x1a\x45\xdf\xa3"),
    ("an MPEG video", 0, b"\0\0\x01\xba"),
    ("an MPEG video", 0, b"\0\0\x01\xb3"),
    ("an H.264 or H.265 stream", 0, b"\0\0\0\x01"),
    ("a Flash video", 0, b"FLV"),
    ("an Ogg video", 0, b"OggS"),
    (
        "a Windows Media video",
        0,
        b"\x30\x26\xb2\x75\x8e\x66\xcf\x11",
    ),
    ("an IVF video", 0, b"DKIF"),
    ("a GIF animation", 0, b"GIF8"),
    ("a WebP animation or picture", 8, b"WEBP"),
];

const PICTURES: [Signature; 5] = [
    ("a PNG picture", 0, b"\x89PNG"),
    ("a JPEG picture", 0, b"\xff\xd8\xff"),
    ("a TIFF picture", 0, b"II*\0"),
    ("a TIFF picture", 0, b"MM\0*"),
    ("a BMP picture", 0, b"BM"),
];

fn of_file(first: &[u8], extension: Option<&str>, path: &Path) -> Kind {
    let name_of = |known: &[Signature]| {
        let found = known.iter().find(|(_, at, bytes)| {
            let there = first.get(*at..);
            there.is_some_and(|there| there.starts_with(bytes))
        });
        found.map(|(name, ..)| *name)
    };
    let magic = &first[..first.len().min(mcap::MAGIC.len())];
    match extension {
        // For these, the reader reports why they cannot be read, even if they are empty.
        Some("mcap") if mcap::MAGIC.starts_with(magic) => return Kind::Recording,
        Some("y4m") if first.is_empty() => return Kind::Y4m,
        _ if first.is_empty() => {
            return Kind::Other("an empty file: nothing was written to it".to_owned());
        }
        _ => {}
    }
    if first.starts_with(mcap::MAGIC) {
        return Kind::Recording;
    }
    if first.starts_with(b"YUV4MPEG2") {
        return Kind::Y4m;
    }
    let path = path.display();
    // Transport streams have only a sync byte, but every 188 bytes.
    let is_transport = first.iter().step_by(188).take(3).all(|&byte| byte == 0x47);
    let video = name_of(&VIDEOS).or((is_transport && first.len() > 376).then_some("an MPEG video"));
    if let Some(name) = video {
        return Kind::Other(format!(
            "{name}, which overcam does not decode: ffmpeg -v error -i {path} -f yuv4mpegpipe - | overcam --device -"
        ));
    }
    if let Some(name) = name_of(&PICTURES) {
        let readable = match name {
            "a PNG picture" | "a JPEG picture" => "",
            _ => ", as PNG or JPEG files,",
        };
        return Kind::Other(format!(
            "{name}, and a single one: put the pictures{readable} into a folder and name that"
        ));
    }
    match extension {
        Some("mcap") => return Kind::Recording,
        Some("y4m") => return Kind::Y4m,
        _ => {}
    }
    if first.starts_with(b"#ROSBAG") || first.starts_with(b"SQLite format 3") {
        return Kind::Other(
            "a ROS bag, or another data base: convert it to MCAP with Foxglove images".to_owned(),
        );
    }
    let is_text = first
        .iter()
        .all(|&byte| byte >= b' ' && byte != 0x7f || b"\t\n\r\x0c".contains(&byte));
    let what = if is_text {
        "a text file"
    } else {
        "a file of a kind that is not known"
    };
    Kind::Other(format!("{what}, not a source of frames; {SOURCES}"))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn names_say_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        fs::write(path("stream.mp4"), "YUV4MPEG2 W2 H2 F1:1\n").expect("written");
        fs::write(path("run.y4m"), mcap::MAGIC).expect("written");
        fs::create_dir(path("pictures.mcap")).expect("made");
        symlink("/dev/null", path("usb-0:1:1.0-video-index0")).expect("linked");
        for (name, kind) in [
            ("stream.mp4", Kind::Y4m),
            ("run.y4m", Kind::Recording),
            ("pictures.mcap", Kind::Folder),
            ("usb-0:1:1.0-video-index0", Kind::Device),
        ] {
            assert_eq!(of(&path(name)).expect("it is there"), kind, "{name}");
        }
        let missing = of(&path("missing.y4m")).expect_err("it is not there");
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn files_that_are_no_source_are_named() {
        let of = |first: &[u8]| match of_file(first, None, Path::new("film.mp4")) {
            Kind::Other(what) => what,
            kind => panic!("{first:?} is {kind:?}"),
        };
        let mut transport = vec![0; 512];
        transport
            .iter_mut()
            .step_by(188)
            .for_each(|byte| *byte = 0x47);
        for first in [
            &b"\0\0\0\x20ftypisom"[..],
            b"RIFF\0\0\0\0AVI LIST",
            b"\x1a\x45\xdf\xa3\x01",
            &transport,
        ] {
            let what = of(first);
            assert!(
                what.contains("ffmpeg -v error -i film.mp4 -f yuv4mpegpipe - | overcam --device -"),
                "{what}"
            );
        }
        for (first, part) in [
            (&b""[..], "empty"),
            (b"once upon a time\n", "a text file"),
            ("Fu\u{df}boden".as_bytes(), "a text file"),
            (b"\0\x01\x02\x03", "not known"),
            (b"\x89PNG\r\n\x1a\n", "into a folder"),
            (b"\xff\xd8\xff\xe0", "into a folder"),
            (b"BM....", "as PNG or JPEG"),
            (b"#ROSBAG V2.0\n", "convert it to MCAP"),
        ] {
            let what = of(first);
            assert!(what.contains(part), "{what}");
        }
    }

    #[test]
    fn a_name_that_promises_something_gets_the_message_of_that() {
        let of = |first: &[u8], extension| of_file(first, Some(extension), Path::new("x"));
        assert_eq!(of(b"", "mcap"), Kind::Recording);
        assert_eq!(of(b"\x89MC", "mcap"), Kind::Recording);
        assert_eq!(of(b"hi\n", "mcap"), Kind::Recording);
        assert_eq!(of(b"", "y4m"), Kind::Y4m);
        assert_eq!(of(b"hi\n", "y4m"), Kind::Y4m);
    }
}
