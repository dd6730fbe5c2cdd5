//! YUV4MPEG2 (Y4M), the plain format for passing raw frames between video programs: files and
//! standard input.
//!
//! A stream is one header line, then for each frame a line that starts with `FRAME` and the planes.
//! Supported: 8 bits per sample, progressive, 4:2:0, 4:2:2, 4:4:4 and mono. Anything else is
//! rejected with the ffmpeg option that converts it. Nearly all such streams are written by ffmpeg,
//! so its private tag for the range (`XCOLORRANGE`) is supported as well.
//!
//! Mono is always treated as full range. That is what ffmpeg writes, whichever range its tag
//! states.
//!
//! Pixels must be square (tag `A1:1`, or `A0:0`: unknown): in a stretched image, no marker has its
//! shape. Interlaced frames are rejected by their tag. A program that weaves both fields of an
//! interlaced source into one frame writes no tag; `combing` detects the combs at moving edges,
//! which are only reported, because an image alone is no proof.
//!
//! A stream must state its frame rate. It is the only source of time stamps, and velocities and
//! forecasts from a guessed rate would be wrong without any sign of it.
//!
//! Chroma siting (`C420jpeg`, `C420mpeg2`, `C420paldv`) is ignored: it moves colours by half a
//! pixel.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Stdin};
use std::path::Path;

use imgproc::Size;

use crate::image::frame::{Frame, PixelFormat};
use crate::image::limits::{AREA_MAX, MAX_SIDE};
use crate::run::slot::{Next, SourceInfo};
use crate::run::status::log;
use crate::source::combing::Combing;

/// Maximum length of a header line, in bytes. ffmpeg's are about 80.
const MAX_LINE_BYTES: u64 = 1024;

/// Pixels are square if their sides differ by at most one part in this many.
const ASPECT_STEPS: u64 = 200;

/// Reasons to reject a Y4M stream.
#[derive(Debug, thiserror::Error)]
pub enum Y4mError {
    /// The file cannot be opened.
    #[error("{name}: cannot be opened: {source}")]
    Open {
        /// Path of the file.
        name: String,
        /// Error of the system.
        source: io::Error,
    },
    /// Reading failed.
    #[error("{name}: reading failed at frame {frame}: {source}")]
    Read {
        /// The stream.
        name: String,
        /// Index of the frame that was being read, from 0.
        frame: u64,
        /// Error of the system.
        source: io::Error,
    },
    /// The stream does not start with a header line.
    #[error("{name}: not a Y4M stream: convert it with ffmpeg -i INPUT -f yuv4mpegpipe -")]
    NotY4m {
        /// The stream.
        name: String,
    },
    /// The stream ends before its header.
    #[error("{name}: empty: the program that should write the frames wrote none")]
    Empty {
        /// The stream.
        name: String,
    },
    /// A tag of the header is invalid.
    #[error("{name}: the Y4M header's tag '{tag}' is not valid")]
    Tag {
        /// The stream.
        name: String,
        /// The tag with its letter.
        tag: String,
    },
    /// Width or height is missing in the header or out of range.
    #[error(
        "{name}: the Y4M header states {width}x{height} pixels; sides must be 1 to {MAX_SIDE}, and no more than {AREA_MAX} in all"
    )]
    Size {
        /// The stream.
        name: String,
        /// Stated width, 0 if missing.
        width: usize,
        /// Stated height, 0 if missing.
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
    /// An unsupported sample format.
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
    /// A frame header is missing.
    #[error("{name}: frame {frame} does not begin with 'FRAME': the stream is damaged")]
    NotAFrame {
        /// The stream.
        name: String,
        /// Index of the frame, from 0.
        frame: u64,
    },
    /// The stream ends inside a frame.
    #[error("{name}: cut off: frame {frame} has {found} of {expected} bytes")]
    Truncated {
        /// The stream.
        name: String,
        /// Index of the frame, from 0.
        frame: u64,
        /// Number of bytes of a frame.
        expected: usize,
        /// Number of bytes of this one.
        found: usize,
    },
}

/// A Y4M stream whose header has been read.
#[derive(Debug)]
pub struct Y4m<R> {
    input: R,
    /// Until combing is proven or ruled out.
    combing: Option<Combing>,
    name: String,
    header: Header,
    /// Number of bytes of a frame's planes.
    frame_bytes: usize,
    /// Index of the next frame.
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
    /// [`Y4mError`] if the file cannot be read or is not a supported Y4M stream.
    pub fn open(path: &Path) -> Result<Self, Y4mError> {
        let name = path.display().to_string();
        match File::open(path) {
            Ok(file) => Self::new(name, BufReader::new(file)),
            Err(source) => Err(Y4mError::Open { name, source }),
        }
    }
}

impl Y4m<BufReader<Stdin>> {
    /// Reads a header from standard input. Blocks until one arrives, as [`Y4m::next`] does for a
    /// frame.
    ///
    /// # Errors
    ///
    /// [`Y4mError`] if standard input is not a supported Y4M stream.
    pub fn stdin() -> Result<Self, Y4mError> {
        Self::new("standard input".to_owned(), BufReader::new(io::stdin()))
    }
}

impl<R: BufRead> Y4m<R> {
    /// Reads a header from `input`; `name` is its name in errors.
    ///
    /// # Errors
    ///
    /// [`Y4mError`] if `input` is not a supported Y4M stream.
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

    /// Information from the header.
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

    /// Reads the next frame; its stamp is its index divided by the frame rate, rounded down to
    /// nanoseconds. Blocks while a pipe is empty.
    ///
    /// # Errors
    ///
    /// [`Y4mError`] if reading fails or the stream is damaged or ends inside a frame.
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
        // Luma comes first in all supported formats.
        let is_found = combing.add(&frame.bytes[..frame.size.area()]);
        if is_found {
            log(format_args!(
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

/// One line with its line end; empty at the end of the stream, without a line end if the stream
/// ends or the line is too long.
fn read_line(input: &mut impl BufRead) -> io::Result<Vec<u8>> {
    let mut line = Vec::new();
    input.take(MAX_LINE_BYTES).read_until(b'\n', &mut line)?;
    Ok(line)
}

/// The exact time of frame `number`: a rate of 30000/1001 must not drift, even in a long recording.
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
    // Defaults of the format's specification for missing tags.
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
            // Comments, and tags of later versions.
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

/// Whether pixels of this aspect are square, as far as markers are concerned: some programs scale
/// to a round size in whole pixels and state the resulting aspect. A ratio with a 0 is unknown.
fn is_square(horizontal: u32, vertical: u32) -> bool {
    let apart = u64::from(horizontal.abs_diff(vertical));
    horizontal == 0 || vertical == 0 || apart * ASPECT_STEPS <= u64::from(vertical)
}

#[cfg(test)]
mod tests;
