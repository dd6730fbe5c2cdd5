//! YUV4MPEG2 (Y4M), the plain format in which video programs hand each other raw frames: files and standard input.
//!
//! A stream is one header line, then for each frame a line that begins with `FRAME` and the planes. Read here: 8 bits a sample,
//! progressive, 4:2:0, 4:2:2, 4:4:4 and mono. Everything else is refused with the ffmpeg option that converts it; ffmpeg is what
//! writes nearly all such streams, so its private tag for the range (`XCOLORRANGE`) is understood as well.
//!
//! Mono is always taken as full range. That is what ffmpeg writes, whichever range its tag states.
//!
//! Pixels must be square (tag `A1:1`, or `A0:0`: unknown): in pictures that are wider than what they show, no marker has its shape.
//! Interlaced frames are refused by their tag. A program that takes both fields of an interlaced source for one frame states no tag;
//! [`Combing`] finds it by the combs at the edges of what moves, which is told, because a picture alone is no proof.
//!
//! A stream must state its frame rate. Time stamps come from nowhere else, and velocities and forecasts made with a guessed
//! one would be wrong without looking wrong.
//!
//! Chroma siting (`C420jpeg`, `C420mpeg2`, `C420paldv`) is ignored: it moves colours by half a pixel.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Stdin};
use std::path::Path;

use imgproc::Size;

use crate::frame::{AREA_MAX, Frame, MAX_SIDE, PixelFormat};
use crate::slot::{Next, SourceInfo};
use crate::source::combing::Combing;
use crate::status::tell;

/// Longest header line that is read, in bytes. ffmpeg's are about 80.
const MAX_LINE_BYTES: u64 = 1024;

/// Sides of a pixel that differ by no more than one part in so many are equal.
const ASPECT_STEPS: u64 = 200;

/// Why a Y4M stream cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum Y4mError {
    /// The file cannot be opened.
    #[error("{name}: cannot be opened: {source}")]
    Open {
        /// Path of the file.
        name: String,
        /// What the system says.
        source: io::Error,
    },
    /// Reading failed.
    #[error("{name}: reading failed at frame {frame}: {source}")]
    Read {
        /// The stream.
        name: String,
        /// Number of the frame that was being read, from 0.
        frame: u64,
        /// What the system says.
        source: io::Error,
    },
    /// The stream does not begin with a header line.
    #[error("{name}: not a Y4M stream: convert it with ffmpeg -i INPUT -f yuv4mpegpipe -")]
    NotY4m {
        /// The stream.
        name: String,
    },
    /// The stream ends before its header does.
    #[error("{name}: empty: the program that should write the frames wrote none")]
    Empty {
        /// The stream.
        name: String,
    },
    /// A tag of the header has no meaning.
    #[error("{name}: the Y4M header's tag '{tag}' is not valid")]
    Tag {
        /// The stream.
        name: String,
        /// The tag with its letter.
        tag: String,
    },
    /// The header lacks the width or the height, or they are out of range.
    #[error(
        "{name}: the Y4M header states {width}x{height} pixels; sides must be 1 to {MAX_SIDE}, and no more than {AREA_MAX} in all"
    )]
    Size {
        /// The stream.
        name: String,
        /// Stated width, 0 if none is.
        width: usize,
        /// Stated height, 0 if none is.
        height: usize,
    },
    /// The header states no frame rate.
    #[error(
        "{name}: the Y4M header states no frame rate, without which nothing has a velocity: \
         give one with ffmpeg -r 30 before -i"
    )]
    NoRate {
        /// The stream.
        name: String,
    },
    /// Samples that are not read here.
    #[error("{name}: Y4M format 'C{chroma}' is not read: convert it with ffmpeg -pix_fmt yuv420p")]
    Chroma {
        /// The stream.
        name: String,
        /// Value of the C tag.
        chroma: String,
    },
    /// Interlaced frames.
    #[error(
        "{name}: the frames are interlaced (tag 'I{interlacing}'): convert them with ffmpeg -vf yadif"
    )]
    Interlaced {
        /// The stream.
        name: String,
        /// Value of the I tag.
        interlacing: String,
    },
    /// Pixels that are not square.
    #[error(
        "{name}: its pixels are {horizontal}:{vertical} and not square (tag 'A{horizontal}:{vertical}'), so that no marker has \
         its shape: convert it with ffmpeg -vf scale=iw*sar:ih,setsar=1"
    )]
    Aspect {
        /// The stream.
        name: String,
        /// Width of a pixel.
        horizontal: u32,
        /// Its height.
        vertical: u32,
    },
    /// An MCAP file on a pipe.
    #[error(
        "{name}: an MCAP recording, which cannot be read from a pipe: write it to a file and name that with --device"
    )]
    PipedRecording {
        /// The stream.
        name: String,
    },
    /// No frame begins where one should.
    #[error("{name}: frame {frame} does not begin with 'FRAME': the stream is damaged")]
    NotAFrame {
        /// The stream.
        name: String,
        /// Number of the frame, from 0.
        frame: u64,
    },
    /// The stream ends inside a frame.
    #[error("{name}: cut off: frame {frame} has {found} of {expected} bytes")]
    Truncated {
        /// The stream.
        name: String,
        /// Number of the frame, from 0.
        frame: u64,
        /// Bytes of a frame.
        expected: usize,
        /// Bytes of this one.
        found: usize,
    },
}

/// A Y4M stream whose header has been read.
#[derive(Debug)]
pub struct Y4m<R> {
    input: R,
    /// Until it is found or ruled out.
    combing: Option<Combing>,
    name: String,
    header: Header,
    /// Bytes of a frame's planes.
    frame_bytes: usize,
    /// Number of the next frame.
    sequence: u64,
}

#[derive(Debug, PartialEq, Eq)]
struct Header {
    size: Size,
    format: PixelFormat,
    full_range: bool,
    /// Frames per second as numerator and denominator, both above 0.
    rate: (u32, u32),
}

impl Y4m<BufReader<File>> {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    ///
    /// [`Y4mError`] when the file cannot be read or is not a Y4M stream of a supported kind.
    pub fn open(path: &Path) -> Result<Self, Y4mError> {
        let name = path.display().to_string();
        match File::open(path) {
            Ok(file) => Self::new(name, BufReader::new(file)),
            Err(source) => Err(Y4mError::Open { name, source }),
        }
    }
}

impl Y4m<BufReader<Stdin>> {
    /// Reads a header from standard input. Blocks until one is there, as [`Y4m::next`] does for a frame.
    ///
    /// # Errors
    ///
    /// [`Y4mError`] when standard input is not a Y4M stream of a supported kind.
    pub fn stdin() -> Result<Self, Y4mError> {
        Self::new("standard input".to_owned(), BufReader::new(io::stdin()))
    }
}

impl<R: BufRead> Y4m<R> {
    /// Reads a header from `input`; `name` is what errors call it.
    ///
    /// # Errors
    ///
    /// [`Y4mError`] when `input` is not a Y4M stream of a supported kind.
    pub fn new(name: String, mut input: R) -> Result<Self, Y4mError> {
        let line = read_line(&mut input).map_err(|source| Y4mError::Read {
            name: name.clone(),
            frame: 0,
            source,
        })?;
        if line.is_empty() {
            return Err(Y4mError::Empty { name });
        }
        if line.starts_with(mcap::MAGIC) {
            return Err(Y4mError::PipedRecording { name });
        }
        let header = parse_header(&line, &name)?;
        let Size { width, height } = header.size;
        let frame_bytes = header.format.frame_bytes(header.size);
        let Some(frame_bytes) = frame_bytes else {
            return Err(Y4mError::Size {
                name,
                width,
                height,
            });
        };
        Ok(Self {
            input,
            combing: Some(Combing::new(header.size)),
            name,
            header,
            frame_bytes,
            sequence: 0,
        })
    }

    /// What the header says.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        let (numerator, denominator) = self.header.rate;
        SourceInfo {
            name: self.name.clone(),
            size: self.header.size,
            format: self.header.format,
            rate_hz: Some(f64::from(numerator) / f64::from(denominator)),
            live: false,
            controls: None,
        }
    }

    /// Reads the next frame; its stamp is its number divided by the frame rate, rounded down to nanoseconds. Blocks while a
    /// pipe is empty.
    ///
    /// # Errors
    ///
    /// [`Y4mError`] when reading fails or the stream is damaged or ends inside a frame.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Next, Y4mError> {
        let number = self.sequence;
        let read_error = |name: &str, source| Y4mError::Read {
            name: name.to_owned(),
            frame: number,
            source,
        };
        let line = read_line(&mut self.input).map_err(|source| read_error(&self.name, source))?;
        if line.is_empty() {
            return Ok(Next::End);
        }
        let truncated = |found| Y4mError::Truncated {
            name: self.name.clone(),
            frame: number,
            expected: self.frame_bytes,
            found,
        };
        match line.strip_prefix(b"FRAME") {
            Some([b'\n', ..] | [b' ', .., b'\n']) => {}
            _ if b"FRAME".starts_with(&line) || line.starts_with(b"FRAME ") => {
                return Err(truncated(0));
            }
            _ => {
                return Err(Y4mError::NotAFrame {
                    name: self.name.clone(),
                    frame: number,
                });
            }
        }
        frame.bytes.clear();
        let found = (&mut self.input)
            .take(self.frame_bytes as u64)
            .read_to_end(&mut frame.bytes)
            .map_err(|source| read_error(&self.name, source))?;
        if found < self.frame_bytes {
            return Err(truncated(found));
        }
        frame.sequence = number;
        frame.stamp_ns = stamp_ns(number, self.header.rate);
        frame.format = self.header.format;
        frame.full_range = self.header.full_range;
        frame.size = self.header.size;
        self.sequence += 1;
        self.look_for_combing(frame);
        Ok(Next::Frame)
    }

    fn look_for_combing(&mut self, frame: &Frame) {
        let Some(combing) = &mut self.combing else {
            return;
        };
        // Luma comes first in all formats that are read.
        let is_found = combing.add(&frame.bytes[..frame.size.area()]);
        if is_found {
            tell(format_args!(
                "overcam: {}: frame {}: what moves is combed, every other row shows it elsewhere: the frames are interlaced, \
                 whatever the stream says, and robots that move may not be read: convert it with ffmpeg -vf yadif",
                self.name, frame.sequence
            ));
        }
        if is_found || combing.is_done() {
            self.combing = None;
        }
    }
}

/// One line with its end, empty at the end of the stream, without an end if the stream or the patience ends first.
fn read_line(input: &mut impl BufRead) -> io::Result<Vec<u8>> {
    let mut line = Vec::new();
    input.take(MAX_LINE_BYTES).read_until(b'\n', &mut line)?;
    Ok(line)
}

/// The exact moment of frame `number`: a rate of 30000/1001 must not drift, however long the recording.
fn stamp_ns(number: u64, (numerator, denominator): (u32, u32)) -> u64 {
    let ns = u128::from(number) * u128::from(denominator) * 1_000_000_000 / u128::from(numerator);
    u64::try_from(ns).unwrap_or(u64::MAX)
}

fn parse_header(line: &[u8], name: &str) -> Result<Header, Y4mError> {
    let not_y4m = || Y4mError::NotY4m {
        name: name.to_owned(),
    };
    let line = std::str::from_utf8(line).map_err(|_| not_y4m())?;
    let tags = line
        .strip_suffix('\n')
        .and_then(|line| line.strip_prefix("YUV4MPEG2"))
        .filter(|tags| tags.is_empty() || tags.starts_with(' '))
        .ok_or_else(not_y4m)?;
    let mut size = Size {
        width: 0,
        height: 0,
    };
    // What the format's description says of a header without these tags.
    let (mut format, mut full_range, mut rate) = (PixelFormat::I420, false, None);
    for tag in tags.split_ascii_whitespace() {
        let invalid = || Y4mError::Tag {
            name: name.to_owned(),
            tag: tag.to_owned(),
        };
        let Some((letter, value)) = tag.split_at_checked(1) else {
            return Err(invalid());
        };
        match letter {
            "W" => size.width = value.parse().map_err(|_| invalid())?,
            "H" => size.height = value.parse().map_err(|_| invalid())?,
            "F" => rate = Some(ratio(value).ok_or_else(invalid)?),
            // p: progressive, ?: unknown.
            "I" if value != "p" && value != "?" => {
                return Err(Y4mError::Interlaced {
                    name: name.to_owned(),
                    interlacing: value.to_owned(),
                });
            }
            "C" => {
                format = match value {
                    "420" | "420jpeg" | "420mpeg2" | "420paldv" => PixelFormat::I420,
                    "422" => PixelFormat::I422,
                    "444" => PixelFormat::I444,
                    "mono" => PixelFormat::Grey,
                    _ => {
                        return Err(Y4mError::Chroma {
                            name: name.to_owned(),
                            chroma: value.to_owned(),
                        });
                    }
                };
            }
            "A" => {
                let (horizontal, vertical) = ratio(value).ok_or_else(invalid)?;
                if !is_square(horizontal, vertical) {
                    return Err(Y4mError::Aspect {
                        name: name.to_owned(),
                        horizontal,
                        vertical,
                    });
                }
            }
            "X" if value == "COLORRANGE=FULL" => full_range = true,
            // Comments, and whatever a later version adds.
            _ => {}
        }
    }
    match rate {
        Some(rate @ (1.., 1..)) => Ok(Header {
            size,
            format,
            full_range,
            rate,
        }),
        _ => Err(Y4mError::NoRate {
            name: name.to_owned(),
        }),
    }
}

fn ratio(value: &str) -> Option<(u32, u32)> {
    let (numerator, denominator) = value.split_once(':')?;
    Some((numerator.parse().ok()?, denominator.parse().ok()?))
}

/// Whether pixels of this shape are square, as far as a marker can tell: programs that scale round sizes to whole pixels and then
/// state what that did. A ratio with a 0 is unknown.
fn is_square(horizontal: u32, vertical: u32) -> bool {
    let apart = u64::from(horizontal.abs_diff(vertical));
    horizontal == 0 || vertical == 0 || apart * ASPECT_STEPS <= u64::from(vertical)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stream(bytes: &[u8]) -> Result<Y4m<&[u8]>, Y4mError> {
        Y4m::new("test".to_owned(), bytes)
    }

    fn header(line: &str) -> Result<Header, Y4mError> {
        parse_header(format!("YUV4MPEG2 {line}\n").as_bytes(), "test")
    }

    /// All frames, and the error that ended the stream.
    fn frames(bytes: &[u8]) -> (Vec<Frame>, Option<Y4mError>) {
        let mut stream = stream(bytes).expect("a header");
        let (mut frames, mut frame) = (Vec::new(), Frame::empty());
        loop {
            match stream.next(&mut frame) {
                Ok(Next::Frame) => frames.push(frame.clone()),
                Ok(_) => return (frames, None),
                Err(error) => return (frames, Some(error)),
            }
        }
    }

    const TWO_FRAMES: &[u8] = b"YUV4MPEG2 W2 H1 F30000:1001 C444\nFRAME\nabcdefFRAME Ixyz\nghijkl";

    #[test]
    fn frames_have_numbers_exact_stamps_and_their_bytes() {
        let (frames, error) = frames(TWO_FRAMES);
        assert!(error.is_none());
        assert_eq!(frames.len(), 2);
        assert_eq!((frames[0].sequence, frames[0].stamp_ns), (0, 0));
        assert_eq!(frames[0].bytes, b"abcdef");
        // 1001 / 30000 s
        assert_eq!((frames[1].sequence, frames[1].stamp_ns), (1, 33_366_666));
        assert_eq!(frames[1].bytes, b"ghijkl");
    }

    #[test]
    fn stamps_do_not_drift() {
        assert_eq!(stamp_ns(30_000, (30_000, 1001)), 1_001_000_000_000);
        assert_eq!(stamp_ns(u64::MAX, (1, u32::MAX)), u64::MAX);
    }

    #[test]
    fn the_header_of_ffmpeg() {
        assert_eq!(
            header("W640 H480 F25:1 Ip A1:1 C420jpeg XYSCSS=420JPEG XCOLORRANGE=LIMITED")
                .expect("valid"),
            Header {
                size: Size {
                    width: 640,
                    height: 480
                },
                format: PixelFormat::I420,
                full_range: false,
                rate: (25, 1),
            }
        );
        assert!(
            header("W2 H2 F1:1 C444 XCOLORRANGE=FULL")
                .expect("valid")
                .full_range
        );
    }

    #[test]
    fn chroma_tags() {
        for (tag, format) in [
            ("", PixelFormat::I420),
            ("C420", PixelFormat::I420),
            ("C420mpeg2", PixelFormat::I420),
            ("C420paldv", PixelFormat::I420),
            ("C422", PixelFormat::I422),
            ("C444", PixelFormat::I444),
            ("Cmono", PixelFormat::Grey),
        ] {
            let found = header(&format!("W4 H4 F1:1 {tag}")).expect("supported");
            assert_eq!(found.format, format, "{tag}");
        }
        for tag in ["C420p10", "C444alpha", "Cmono16", "C411", "C"] {
            let error = header(&format!("W4 H4 F1:1 {tag}")).expect_err("not supported");
            assert!(
                error.to_string().contains("-pix_fmt yuv420p"),
                "{tag}: {error}"
            );
        }
    }

    #[test]
    fn square_pixels_and_unknown_ones_are_read() {
        for tag in ["A1:1", "A0:0", "A128:128", "A0:1", "A1215:1216", "A400:401"] {
            header(&format!("W4 H4 F1:1 {tag}")).expect(tag);
        }
    }

    #[test]
    fn streams_that_cannot_be_used_say_why() {
        for (bytes, part) in [
            (&b""[..], "empty"),
            (b"\x89PNG\r\n", "not a Y4M stream"),
            (b"YUV4MPEG2X W2 H2 F1:1\n", "not a Y4M stream"),
            (b"YUV4MPEG2 W2 H2 F1:1", "not a Y4M stream"),
            (b"YUV4MPEG2 W2 H2 F1:1 It\n", "yadif"),
            (b"YUV4MPEG2 W2 H2 F1:1 Ib\n", "yadif"),
            (b"YUV4MPEG2 W2 H2 F1:1 Im\n", "yadif"),
            (b"YUV4MPEG2 W2 H2 F1:1 A12:11\n", "setsar=1"),
            (b"YUV4MPEG2 W2 H2 F1:1 A59:54\n", "setsar=1"),
            (b"YUV4MPEG2 W2 H2 F1:1 A10:11\n", "setsar=1"),
            (b"YUV4MPEG2 W2 H2 F1:1 A1\n", "'A1'"),
            (b"\x89MCAP0\r\n\x01", "from a pipe"),
            (b"YUV4MPEG2 W100000 H100000 F1:1\n", "100000x100000"),
            (b"YUV4MPEG2 W16384 H16384 F1:1\n", "16384x16384"),
            (b"YUV4MPEG2 W2 H2 F0:0\n", "no frame rate"),
            (b"YUV4MPEG2 W2 H2\n", "no frame rate"),
            (b"YUV4MPEG2 W2 H2 F25\n", "'F25'"),
            (b"YUV4MPEG2 W-2 H2 F1:1\n", "'W-2'"),
            (b"YUV4MPEG2 H2 F1:1\n", "0x2 pixels"),
            (b"YUV4MPEG2 W99999 H99999 F1:1\n", "99999x99999"),
            (b"YUV4MPEG2 W99999999999999999999999 H2 F1:1\n", "W999"),
        ] {
            let error = stream(bytes).expect_err(part).to_string();
            assert!(error.starts_with("test: "), "{error}");
            assert!(error.contains(part), "{error}");
            assert!(!error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn an_endless_first_line_is_not_read_to_its_end() {
        let line = io::BufReader::new(io::repeat(b'Y'));
        let error = Y4m::new("test".to_owned(), line).expect_err("no header");
        assert!(matches!(error, Y4mError::NotY4m { .. }));
    }

    #[test]
    fn a_cut_stream_gives_its_whole_frames_first() {
        let header = b"YUV4MPEG2 W2 H1 F30000:1001 C444\n".len();
        let first_end = header + b"FRAME\nabcdef".len();
        for end in header..TWO_FRAMES.len() {
            let (frames, error) = frames(&TWO_FRAMES[..end]);
            assert_eq!(frames.len(), usize::from(end >= first_end), "{end}");
            if end == header || end == first_end {
                assert!(error.is_none(), "{end}: {error:?}");
            } else {
                let number = u64::from(end > first_end);
                assert!(
                    matches!(error, Some(Y4mError::Truncated { frame, expected: 6, .. }) if frame == number),
                    "{end}: {error:?}"
                );
            }
        }
        let (_, error) = frames(&TWO_FRAMES[..TWO_FRAMES.len() - 2]);
        assert_eq!(
            error.expect("cut").to_string(),
            "test: cut off: frame 1 has 4 of 6 bytes"
        );
    }

    #[test]
    fn garbage_between_frames_is_an_error() {
        let (frames, error) = frames(b"YUV4MPEG2 W1 H1 F1:1 Cmono\nFRAME\nx?FRAME\ny");
        assert_eq!(frames.len(), 1);
        assert!(matches!(error, Some(Y4mError::NotAFrame { frame: 1, .. })));
    }

    proptest! {
        #[test]
        fn any_bytes_are_an_answer(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let header = &b"YUV4MPEG2 W2 H1 F3:1\n"[..];
            _ = stream(&bytes);
            _ = frames(&[header, &bytes].concat());
        }
    }
}
