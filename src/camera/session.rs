//! An open camera: its negotiated settings, and the conversion of its buffers to frames.

use std::ops::Range;
use std::path::Path;

use imgproc::Size;

use crate::camera::error::{CameraError, call_error};
use crate::camera::negotiation::{Choice, interval, text};
use crate::camera::rows::rows;
use crate::camera::v4l2::{Device, FailedCall, Filled, Fraction, Stream};
use crate::image::frame::PixelFormat;
use crate::image::jpeg;
use crate::image::limits::MAX_SIDE;

/// Number of buffers requested. With four, one can be copied and one filled while two wait for a
/// thread that was not scheduled in time.
const N_BUFFERS: u32 = 4;

/// `V4L2_COLORSPACE_JPEG`, and the `V4L2_QUANTIZATION_` values.
const COLORSPACE_JPEG: u32 = 7;
const QUANTIZATION_DEFAULT: u32 = 0;
const QUANTIZATION_FULL_RANGE: u32 = 1;

/// `V4L2_FIELD_` values for frames whose rows are from two points in time.
const FIELDS: [(u32, &str); 8] = [
    (2, "top fields only"),
    (3, "bottom fields only"),
    (4, "interlaced"),
    (5, "top field before bottom field"),
    (6, "bottom field before top field"),
    (7, "alternating fields"),
    (8, "interlaced, top field first"),
    (9, "interlaced, bottom field first"),
];

/// Settings for a camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Terms {
    pub(super) choice: Choice,
    /// The camera must not use another size.
    pub(super) is_size_fixed: bool,
    /// Frames per second; the camera uses the nearest possible rate.
    pub(super) rate_hz: f64,
}

/// A camera with capture buffers. Dropping it stops the camera.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) stream: Stream,
    pub(super) format: PixelFormat,
    pub(super) size: Size,
    /// As stated by the camera.
    pub(super) rate_hz: Option<f64>,
    pub(super) full_range: bool,
    /// Byte ranges of the pixels within a buffer, row by row; empty for JPEG.
    rows: Vec<Range<usize>>,
}

impl Session {
    /// Sets format, size and rate, and prevents other programs from capturing. `name` is the
    /// camera's name in messages.
    pub(super) fn new(
        device: Device,
        name: &str,
        path: &Path,
        terms: &Terms,
    ) -> Result<Self, CameraError> {
        let choice = terms.choice;
        let call_failed = |failed| call_error(name, path, failed);
        let given = device
            .set_format(choice.fourcc, choice.size)
            .map_err(|source| {
                call_failed(FailedCall {
                    call: "VIDIOC_S_FMT",
                    source,
                })
            })?;
        let size = Size {
            width: given.width as usize,
            height: given.height as usize,
        };
        let owned = || name.to_owned();
        if given.pixel_format != choice.fourcc {
            return Err(CameraError::Format {
                path: owned(),
                requested: text(choice.fourcc),
                offered: format!("{} at this size", text(given.pixel_format)),
            });
        }
        let is_possible =
            (1..=MAX_SIDE).contains(&size.width) && (1..=MAX_SIDE).contains(&size.height);
        if (terms.is_size_fixed && choice.size != size) || !is_possible {
            return Err(CameraError::Size {
                path: owned(),
                size: choice.size,
                offered: format!("{}x{}", size.width, size.height),
            });
        }
        if let Some(field) = fields(given.field) {
            return Err(CameraError::Interlaced {
                path: owned(),
                field,
            });
        }
        let (bytes_per_line, size_image) =
            (given.bytes_per_line as usize, given.size_image as usize);
        let rows = rows(choice.format, size, bytes_per_line)
            .filter(|rows| rows.last().is_none_or(|last| last.end <= size_image))
            .ok_or_else(|| CameraError::Layout {
                path: owned(),
                format: choice.format,
                size,
                bytes_per_line,
                size_image,
            })?;
        let rate_hz = device
            .set_interval(interval(terms.rate_hz))
            .map(Fraction::rate_hz);
        Ok(Self {
            stream: Stream::new(device, N_BUFFERS).map_err(call_failed)?,
            format: choice.format,
            size,
            rate_hz,
            full_range: match given.quantization {
                QUANTIZATION_DEFAULT => given.colorspace == COLORSPACE_JPEG,
                stated => stated == QUANTIZATION_FULL_RANGE,
            },
            rows,
        })
    }

    /// Copies the pixels of a buffer; returns `false` if it is too short.
    pub(super) fn copy(&self, filled: &Filled, bytes: &mut Vec<u8>) -> bool {
        bytes.clear();
        let Some(last) = self.rows.last() else {
            self.stream.append_to(filled, 0..filled.bytes_used, bytes);
            return jpeg::size(bytes) == Ok(self.size);
        };
        if filled.bytes_used < last.end {
            return false;
        }
        for row in &self.rows {
            self.stream.append_to(filled, row.clone(), bytes);
        }
        true
    }
}

/// Name of the field arrangement if the rows of a frame are from two points in time, otherwise
/// `None`. Unknown values count as progressive, which was requested.
fn fields(field: u32) -> Option<&'static str> {
    let found = FIELDS.iter().find(|(number, _)| *number == field);
    found.map(|&(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interlaced_frames_are_distinguished_from_progressive_ones() {
        let is_refused: Vec<bool> = (0..11).map(|field| fields(field).is_some()).collect();
        assert_eq!(is_refused[..2], [false, false]);
        assert!(is_refused[2..10].iter().all(|&refused| refused));
        assert!(!is_refused[10]);
        assert_eq!(fields(4), Some("interlaced"));
    }
}
