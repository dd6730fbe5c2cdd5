//! A folder of PNG and JPEG files as a source.
//!
//! The files are read in natural order of their names (`img2` before `img10`). The format is
//! detected from the first bytes, not the name. JPEG files are passed on unchanged. Grey PNG files
//! become [`PixelFormat::Grey`](crate::image::frame::PixelFormat::Grey) frames and all others
//! [`PixelFormat::Rgb`](crate::image::frame::PixelFormat::Rgb); samples of 16 bits are reduced to 8
//! and an alpha channel is dropped. Files may differ in format but not in size.
//!
//! The number of bits in use, of 16, is estimated from a sample of the images; all are reduced by
//! the same amount.
//!
//! A file that cannot be decoded is skipped, reported and counted. It keeps its sequence number and
//! time stamp, like a frame lost by a camera.
//!
//! Deliberately absent: the orientation in a JPEG file's Exif data. Images of a ceiling camera are
//! used as the sensor recorded them, and a folder with varying orientation is not from a fixed
//! camera.

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

/// Default frame rate of a folder. Images have no clock, but stamps need one.
pub const DEFAULT_RATE_HZ: f64 = 30.0;

/// Maximum number of images examined for the number of bits in use.
const DEPTH_SAMPLES: usize = 16;

/// Reasons to reject a folder of image files.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder cannot be listed.
    #[error("{}: the folder cannot be listed: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The folder has no image files.
    #[error("{}: no pictures in this folder: it needs files ending in .png, .jpg or .jpeg", path.display())]
    NoPictures {
        /// The folder.
        path: PathBuf,
    },
    /// A frame rate for which no stamps can be computed.
    #[error("a rate of {rate_hz} frames/s is not possible: it must be above 0")]
    Rate {
        /// The requested rate.
        rate_hz: f64,
    },
    /// Several files, none of which can be decoded.
    #[error("{}: none of the {count} pictures in this folder can be read; the first: {first}", path.display())]
    NoneReadable {
        /// The folder.
        path: PathBuf,
        /// Number of files.
        count: usize,
        /// Error of the first.
        first: Box<PictureError>,
    },
    /// The size of an image differs from that of the first.
    #[error(
        "{}: {}x{} pixels, but the folder's first picture has {}x{}: all must have one size",
        path.display(), found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Size of the first image.
        expected: Size,
        /// Size of this one.
        found: Size,
    },
    /// The only file cannot be decoded.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// A folder of image files.
#[derive(Debug)]
pub struct Pictures {
    info: SourceInfo,
    rate_hz: f64,
    /// In reading order.
    files: Vec<PathBuf>,
    /// Index of the next file.
    next: usize,
    /// Bits in use of samples that have 16.
    n_bits: Option<u8>,
    /// An image with more bits in use has been reported.
    reported_excess: bool,
    damaged: Damaged,
}

impl Pictures {
    /// Lists a folder and reads its first valid image, which determines the size of all. Stamps
    /// start at 0, at `rate_hz` frames per second.
    ///
    /// # Errors
    ///
    /// [`FolderError`] if there is no image, none can be decoded, or the rate is not above 0.
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
            reported_excess: false,
            damaged: Damaged::default(),
        })
    }

    /// Information about the images; the format is that of the first one.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        self.info.clone()
    }

    /// Number of bits in use in samples of 16 bits, according to the folder's images; `None` for 8
    /// bits.
    pub(crate) fn n_bits(&self) -> Option<u8> {
        self.n_bits
    }

    /// Number of damaged files so far.
    #[must_use]
    pub fn n_damaged(&self) -> u64 {
        self.damaged.count
    }

    /// Reads the next valid image.
    ///
    /// # Errors
    ///
    /// [`FolderError::Size`] if the size of the image differs from that of the first.
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
            if exceeds && !self.reported_excess {
                self.reported_excess = true;
                log(format_args!(
                    "overcam: {}: it uses more bits per sample than the pictures from which their number was determined; brighter \
                     values become white",
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

/// Number of bits in use in the 16-bit samples of a folder's images, from a sample of them.
fn common_depth(files: &[PathBuf]) -> Option<u8> {
    let n_samples = files.len().min(DEPTH_SAMPLES);
    let chosen = (0..n_samples).map(|i| &files[i * (files.len() - 1) / (n_samples - 1).max(1)]);
    let depth = |path: &PathBuf| {
        let file = fs::read(path).ok()?;
        // The header contains the depth, so decoding is not needed.
        let is_deep = file.starts_with(png::SIGNATURE) && file.get(24) == Some(&16);
        is_deep.then(|| Png::read(&file).ok()?.n_bits())?
    };
    chosen.filter_map(depth).max()
}

/// The folder's image files in natural order of their names. Hidden files are skipped: some systems
/// create a `._img1.png` that is not an image for each `img1.png`.
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

/// Compares names in natural order: digit runs by value, everything else byte by byte.
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
