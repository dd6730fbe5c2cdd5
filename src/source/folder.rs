//! A folder of PNG and JPEG files as a source.
//!
//! The files of a folder are taken in natural order of their names (`img2` before `img10`). What a file is, its first bytes
//! say, not its name. JPEG files travel on as they are; of PNG files, grey ones become [`PixelFormat::Grey`](crate::image::frame::PixelFormat::Grey) frames and all
//! others [`PixelFormat::Rgb`](crate::image::frame::PixelFormat::Rgb); 16 bits a sample are reduced to 8 and an alpha channel is dropped. Files of a folder may differ in
//! format but not in size.
//!
//! How many of 16 bits are in use, a few pictures of the folder tell, from its first to its last: all are reduced alike.
//!
//! A file that cannot be read is passed over, told and counted. It has its number and its moment all the same, as a frame that a
//! camera lost.
//!
//! Deliberately absent: the orientation in a JPEG file's Exif data. A ceiling camera's pictures are wanted as the sensor saw
//! them, and a folder in which it differs from file to file would be no fixed camera.

use std::cmp::Ordering;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::{fs, io};

use imgproc::Size;

use crate::image::frame::Frame;
use crate::image::picture_file::{PictureError, read_frame};
use crate::image::png::{self, Png};
use crate::run::slot::{Next, SourceInfo};
use crate::run::status::log;
use crate::source::damaged::Damaged;

/// Frames per second of a folder when the user states none. Pictures carry no clock, and stamps need one.
pub const DEFAULT_RATE_HZ: f64 = 30.0;

/// Most pictures of a folder that are looked into to tell how many bits of 16 are in use.
const DEPTH_SAMPLES: usize = 16;

/// Why a folder of picture files cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder cannot be listed.
    #[error("{}: the folder cannot be listed: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The folder has no picture files.
    #[error("{}: no pictures in this folder: it needs files ending in .png, .jpg or .jpeg", path.display())]
    NoPictures {
        /// The folder.
        path: PathBuf,
    },
    /// A frame rate that gives no stamps.
    #[error("a rate of {rate_hz} frames/s is not possible: it must be above 0")]
    Rate {
        /// What was asked for.
        rate_hz: f64,
    },
    /// Several files, and not one of them can be read.
    #[error("{}: none of the {count} pictures in this folder can be read; the first: {first}", path.display())]
    NoneReadable {
        /// The folder.
        path: PathBuf,
        /// Files in it.
        count: usize,
        /// What is wrong with the first.
        first: Box<PictureError>,
    },
    /// A picture of another size than the folder's first.
    #[error(
        "{}: {}x{} pixels, but the folder's first picture has {}x{}: all must have one size",
        path.display(), found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Size of the first picture.
        expected: Size,
        /// Size of this one.
        found: Size,
    },
    /// The only file cannot be read.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// A folder of picture files.
#[derive(Debug)]
pub struct Pictures {
    info: SourceInfo,
    rate_hz: f64,
    /// In the order in which they are read.
    files: Vec<PathBuf>,
    /// Number of the next file.
    next: usize,
    /// Bits in use of samples that have 16.
    n_bits: Option<u8>,
    /// It was told that a picture has samples of more bits.
    told_excess: bool,
    damaged: Damaged,
}

impl Pictures {
    /// Lists a folder and reads its first picture that can be read, which sets the size of all. Stamps are counted from 0 at `rate_hz`
    /// frames a second.
    ///
    /// # Errors
    ///
    /// [`FolderError`] when there is no picture, none can be read, or the rate is not above 0.
    pub fn open(folder: &Path, rate_hz: f64) -> Result<Self, FolderError> {
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return Err(FolderError::Rate { rate_hz });
        }
        let files = list(folder)?;
        if files.is_empty() {
            return Err(FolderError::NoPictures {
                path: folder.to_owned(),
            });
        }
        let mut frame = Frame::empty();
        let mut first_error = None;
        let is_readable = |path: &PathBuf| match read_frame(path, None, &mut frame) {
            Ok(_) => true,
            Err(error) => {
                first_error.get_or_insert(error);
                false
            }
        };
        if !files.iter().any(is_readable) {
            return Err(match (files.len(), first_error) {
                (count @ 2.., Some(first)) => FolderError::NoneReadable {
                    path: folder.to_owned(),
                    count,
                    first: Box::new(first),
                },
                (_, Some(only)) => only.into(),
                (_, None) => unreachable!("a folder with files has one that can or cannot be read"),
            });
        }
        let n_bits = common_depth(&files);
        if let Some(bits @ ..16) = n_bits {
            log(format_args!(
                "overcam: {}: the pictures have 16 bits a sample, of which {bits} are in use: they are read as {bits} bits",
                folder.display()
            ));
        }
        Ok(Self {
            info: SourceInfo {
                name: folder.display().to_string(),
                size: frame.size,
                format: frame.format,
                rate_hz: Some(rate_hz),
                live: false,
                controls: None,
            },
            rate_hz,
            files,
            next: 0,
            n_bits,
            told_excess: false,
            damaged: Damaged::default(),
        })
    }

    /// What is known of the pictures; the format is the first one's.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        self.info.clone()
    }

    /// Bits in use where samples have 16, by the folder's pictures; `None` where they have 8.
    pub(crate) fn n_bits(&self) -> Option<u8> {
        self.n_bits
    }

    /// Files that could not be read so far.
    #[must_use]
    pub fn n_damaged(&self) -> u64 {
        self.damaged.count
    }

    /// Reads the next picture that can be read.
    ///
    /// # Errors
    ///
    /// [`FolderError::Size`] when the picture has another size than the first.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Next, FolderError> {
        while let Some(path) = self.files.get(self.next) {
            let number = self.next;
            self.next += 1;
            let exceeds = match read_frame(path, self.n_bits, frame) {
                Ok(exceeds) => exceeds,
                Err(error) => {
                    self.damaged.skip(error);
                    continue;
                }
            };
            if frame.size != self.info.size {
                return Err(FolderError::Size {
                    path: path.clone(),
                    expected: self.info.size,
                    found: frame.size,
                });
            }
            if exceeds && !self.told_excess {
                self.told_excess = true;
                log(format_args!(
                    "overcam: {}: it has more bits a sample than the pictures by which their number was told; what is brighter \
                     than they can be is taken as white",
                    path.display()
                ));
            }
            frame.sequence = number as u64;
            frame.stamp_ns = (number as f64 * 1e9 / self.rate_hz).round() as u64;
            return Ok(Next::Frame);
        }
        Ok(Next::End)
    }
}

/// Bits in use of the samples of a folder's pictures that have 16, by some of them from the first to the last.
fn common_depth(files: &[PathBuf]) -> Option<u8> {
    let n_samples = files.len().min(DEPTH_SAMPLES);
    let chosen = (0..n_samples).map(|i| &files[i * (files.len() - 1) / (n_samples - 1).max(1)]);
    let depth = |path: &PathBuf| {
        let file = fs::read(path).ok()?;
        // The header says it without decoding.
        let is_deep = file.starts_with(png::SIGNATURE) && file.get(24) == Some(&16);
        is_deep.then(|| Png::read(&file).ok()?.n_bits())?
    };
    chosen.filter_map(depth).max()
}

/// The folder's picture files in natural order of their names. Hidden files are left out: some systems put a `._img1.png` that is
/// no picture beside each `img1.png`.
fn list(folder: &Path) -> Result<Vec<PathBuf>, FolderError> {
    let failed = |source| FolderError::Folder {
        path: folder.to_owned(),
        source,
    };
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        let is_picture = ["png", "jpg", "jpeg"]
            .iter()
            .any(|&known| extension == known);
        if is_picture && !file_name(&path).as_encoded_bytes().starts_with(b".") {
            files.push(path);
        }
    }
    files.sort_by(|a, b| {
        let (a, b) = (file_name(a), file_name(b));
        natural_order(a.as_encoded_bytes(), b.as_encoded_bytes()).then_with(|| a.cmp(b))
    });
    Ok(files)
}

fn file_name(path: &Path) -> &OsStr {
    path.file_name().unwrap_or_default()
}

/// Compares names as people count: runs of digits by their value, everything else byte by byte.
fn natural_order(mut a: &[u8], mut b: &[u8]) -> Ordering {
    fn split_digits(name: &[u8]) -> (&[u8], &[u8]) {
        let n = name.iter().take_while(|byte| byte.is_ascii_digit()).count();
        name.split_at(n)
    }
    fn without_zeros(number: &[u8]) -> &[u8] {
        let zeros = number.iter().take_while(|&&digit| digit == b'0').count();
        &number[zeros..]
    }
    while let (Some(&first_a), Some(&first_b)) = (a.first(), b.first()) {
        if first_a.is_ascii_digit() && first_b.is_ascii_digit() {
            let (number_a, rest_a) = split_digits(a);
            let (number_b, rest_b) = split_digits(b);
            let (value_a, value_b) = (without_zeros(number_a), without_zeros(number_b));
            // Without leading zeros, the longer number is the larger.
            let order = value_a.len().cmp(&value_b.len()).then(value_a.cmp(value_b));
            if order.is_ne() {
                return order;
            }
            (a, b) = (rest_a, rest_b);
        } else if first_a != first_b {
            return first_a.cmp(&first_b);
        } else {
            (a, b) = (&a[1..], &b[1..]);
        }
    }
    a.len().cmp(&b.len())
}

#[cfg(test)]
mod tests;
