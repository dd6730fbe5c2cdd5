//! JPEG images from cameras and files (ITU-T T.81): check for completeness, missing Huffman tables,
//! decoding.
//!
//! [`zune_jpeg`] decodes. This module first does what the decoder does not, in one pass over the
//! image:
//!
//! * an image whose data end early is rejected, with or without an end marker: the decoder would
//!   fill the rest with grey, which the background difference would take for an object. `scan`
//!   reads every code to detect this;
//! * the size is checked before anything is allocated;
//! * Motion-JPEG cameras omit the Huffman tables, because they always use those of the standard;
//!   they are inserted for the decoder;
//! * harmless defects of camera images are repaired: a missing end marker, fill bytes before
//!   restart markers, stray bytes after the data.

mod huffman;
mod scan;

use std::borrow::Cow;
use std::ops::Range;

use imgproc::Size;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::image::jpeg::huffman::{Tables, define, standard_tables};
use crate::image::jpeg::scan::{Coding, FrameHeader, ScanError, next_marker};
use crate::image::limits::{AREA_MAX, MAX_SIDE, size_is_possible};

/// Second byte of the relevant markers (T.81, table B.1).
const HUFFMAN_TABLES: u8 = 0xc4;
const START_OF_IMAGE: u8 = 0xd8;
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_SCAN: u8 = 0xda;
const RESTART_INTERVAL: u8 = 0xdd;

/// Maximum number of scans. Encoders write up to about ten, and each costs time even without data.
const SCANS_MAX: usize = 100;

/// Reasons to reject a JPEG image.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum JpegError {
    /// The bytes do not start like a JPEG image, or have no segment structure.
    #[error("not a JPEG picture: no segment begins at byte {at} of {length}")]
    NotJpeg {
        /// Position where a segment was expected.
        at: usize,
        /// Number of bytes.
        length: usize,
    },
    /// The data end before the last pixel.
    #[error("JPEG picture cut off: its {length} bytes do not hold all of its pixels")]
    Truncated {
        /// Number of bytes.
        length: usize,
    },
    /// The image has no frame header or no scan.
    #[error("JPEG picture without pixels: it has no frame header or no scan")]
    Empty,
    /// The size in the header is above the limit.
    #[error(
        "JPEG picture that claims {}x{} pixels: sides must be 1 to {MAX_SIDE} pixels, and no more than {AREA_MAX} in all",
        claimed.width, claimed.height
    )]
    TooLarge {
        /// Size in the image header.
        claimed: Size,
    },
    /// The size of the image differs from that of its frame.
    #[error(
        "JPEG picture of {}x{} pixels where {}x{} were expected: all frames of a source must have one size",
        found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// Size of the frame.
        expected: Size,
        /// Size in the image header.
        found: Size,
    },
    /// The coded data are invalid, or the decoder failed.
    #[error("damaged JPEG picture: {reason}")]
    Damaged {
        /// What is wrong.
        reason: String,
    },
}

/// Result of one pass over an image.
struct Layout {
    size: Size,
    /// Whether any Huffman tables are defined.
    has_tables: bool,
    /// Position of the header of the first scan.
    first_scan: usize,
    /// Position after the last scan, or after the end marker if there is one. Cameras append
    /// padding.
    end: usize,
    has_end_marker: bool,
    /// Stray bytes in scans.
    junk: Vec<Range<usize>>,
}

/// Size of a complete JPEG image.
///
/// # Errors
///
/// [`JpegError`] if the bytes are not one complete JPEG image.
pub fn size(jpeg: &[u8]) -> Result<Size, JpegError> {
    walk(jpeg).map(|layout| layout.size)
}

/// The image in a form that every decoder reads: with the standard Huffman tables (T.81, K.3)
/// before its first scan if it has none, with an end-of-image marker and nothing after it, and
/// without stray bytes. Borrowed if no repair was needed.
fn mended<'a>(jpeg: &'a [u8], layout: &Layout) -> Cow<'a, [u8]> {
    let picture = &jpeg[..layout.end];
    if layout.has_tables && layout.has_end_marker && layout.junk.is_empty() {
        return Cow::Borrowed(picture);
    }
    let (head, _) = picture.split_at(layout.first_scan);
    let mut mended = head.to_vec();
    if !layout.has_tables {
        mended.extend(standard_tables());
    }
    let mut at = layout.first_scan;
    for junk in &layout.junk {
        mended.extend(&picture[at..junk.start]);
        at = junk.end;
    }
    mended.extend(&picture[at..]);
    if !layout.has_end_marker {
        mended.extend([0xff, END_OF_IMAGE]);
    }
    Cow::Owned(mended)
}

/// Decodes a colour or grey image to red, green, blue triples, `3 * expected.area()` bytes.
///
/// # Errors
///
/// [`JpegError`] if the image is incomplete, its size differs, or its coded data are damaged.
pub fn decode_rgb(jpeg: &[u8], expected: Size) -> Result<Vec<u8>, JpegError> {
    let layout = walk(jpeg)?;
    if layout.size != expected {
        return Err(JpegError::Size {
            expected,
            found: layout.size,
        });
    }
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let complete = mended(jpeg, &layout);
    let rgb = JpegDecoder::new_with_options(ZCursor::new(&complete), options)
        .decode()
        .map_err(|error| damaged(error.to_string()))?;
    if rgb.len() != 3 * expected.area() {
        return Err(damaged(format!("{} bytes of pixels", rgb.len())));
    }
    Ok(rgb)
}

/// Walks from segment to segment, so that markers inside a thumbnail or a comment are skipped, and
/// through the data of each scan.
fn walk(jpeg: &[u8]) -> Result<Layout, JpegError> {
    let length = jpeg.len();
    if !jpeg.starts_with(&[0xff, 0xd8]) {
        return Err(JpegError::NotJpeg { at: 0, length });
    }
    let jpeg = without_padding(jpeg);
    let cut_off = JpegError::Truncated { length };
    let mut seen = Seen::default();
    define_standard(&mut seen.tables);
    let mut at = 2;
    let has_end_marker = loop {
        let rest = &jpeg[at.min(jpeg.len())..];
        match rest {
            // Either less than a marker is left of the padding, or another image starts.
            [] | [_] | [0xff, START_OF_IMAGE, ..] if seen.is_whole() => break false,
            // Any number of fill bytes may precede a marker.
            [0xff, 0xff, ..] => at += 1,
            [0xff, END_OF_IMAGE, ..] => break true,
            // TEM and RSTn have no length.
            [0xff, 0x01 | 0xd0..=0xd7, ..] => at += 2,
            [0xff, marker, high, low, ..] => {
                let n_bytes = usize::from(u16::from_be_bytes([*high, *low]));
                let Some(content) = rest.get(4..2 + n_bytes) else {
                    return Err(cut_off);
                };
                seen.segment(*marker, content)?;
                if *marker == START_OF_SCAN {
                    seen.first_scan.get_or_insert(at);
                }
                at += 2 + n_bytes;
                if *marker == START_OF_SCAN {
                    at = seen.scan(jpeg, at, content, &cut_off)?;
                }
            }
            [] | [0xff] | [0xff, _] | [0xff, _, _] => return Err(cut_off),
            _ => return Err(JpegError::NotJpeg { at, length }),
        }
    };
    let (Some(frame), Some(first_scan)) = (seen.frame, seen.first_scan) else {
        return Err(JpegError::Empty);
    };
    if !frame.is_complete() {
        return Err(cut_off);
    }
    Ok(Layout {
        size: frame.size,
        has_tables: seen.has_tables,
        first_scan,
        end: (at + if has_end_marker { 2 } else { 0 }).min(jpeg.len()),
        has_end_marker,
        junk: seen.junk,
    })
}

fn damaged(reason: impl Into<String>) -> JpegError {
    let reason = reason.into();
    JpegError::Damaged { reason }
}

/// What a walk has come across.
#[derive(Default)]
struct Seen {
    frame: Option<FrameHeader>,
    tables: Tables,
    has_tables: bool,
    restart_interval: usize,
    first_scan: Option<usize>,
    n_scans: usize,
    junk: Vec<Range<usize>>,
}

impl Seen {
    /// Whether all data of the image have been read.
    fn is_whole(&self) -> bool {
        self.first_scan.is_some() && self.frame.as_ref().is_some_and(FrameHeader::is_complete)
    }

    /// Keeps what a segment says about the scans after it.
    fn segment(&mut self, marker: u8, content: &[u8]) -> Result<(), JpegError> {
        match marker {
            HUFFMAN_TABLES => {
                self.has_tables = true;
                define(&mut self.tables, content).ok_or_else(|| damaged("bad Huffman tables"))?;
            }
            RESTART_INTERVAL => {
                let interval = content
                    .first_chunk()
                    .ok_or_else(|| damaged("bad restart interval"))?;
                self.restart_interval = usize::from(u16::from_be_bytes(*interval));
            }
            0xc0..=0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => {
                self.frame = Some(frame_header(marker, content)?);
            }
            _ => {}
        }
        Ok(())
    }

    /// Reads the data of a scan, which start at `at`. Returns where they end.
    fn scan(
        &mut self,
        jpeg: &[u8],
        at: usize,
        header: &[u8],
        cut_off: &JpegError,
    ) -> Result<usize, JpegError> {
        self.n_scans += 1;
        if self.n_scans > SCANS_MAX {
            return Err(damaged("too many scans"));
        }
        let frame = self.frame.as_mut().ok_or(JpegError::Empty)?;
        if frame.coding == Coding::Other {
            return Ok(end_of_other_coding(jpeg, at));
        }
        let Self {
            tables,
            restart_interval,
            junk,
            ..
        } = self;
        scan::read(jpeg, at, header, frame, tables, *restart_interval, junk).map_err(|error| {
            match error {
                ScanError::Short => cut_off.clone(),
                ScanError::Damaged(reason) => damaged(reason),
            }
        })
    }
}

/// The image without the zeros with which a camera pads its buffer: without an end marker they
/// would be read as pixels. A single zero may belong to the data, for example after a 255.
fn without_padding(jpeg: &[u8]) -> &[u8] {
    let end = jpeg
        .iter()
        .rposition(|&byte| byte != 0)
        .map_or(0, |at| at + 1);
    let n_zeros = jpeg.len() - end;
    let is_pair = n_zeros > 0 && jpeg[..end].ends_with(&[0xff]);
    &jpeg[..end + usize::from(is_pair || n_zeros == 1)]
}

fn define_standard(tables: &mut Tables) {
    let segment = standard_tables();
    // Marker and length precede the tables.
    let defined = define(tables, &segment[4..]);
    debug_assert!(defined.is_some());
}

fn frame_header(marker: u8, content: &[u8]) -> Result<FrameHeader, JpegError> {
    // Precision, height, width.
    if let Some(&[_, high_rows, low_rows, high_columns, low_columns]) = content.first_chunk() {
        let claimed = Size {
            width: usize::from(u16::from_be_bytes([high_columns, low_columns])),
            height: usize::from(u16::from_be_bytes([high_rows, low_rows])),
        };
        if !size_is_possible(claimed) {
            return Err(JpegError::TooLarge { claimed });
        }
    }
    FrameHeader::parse(marker, content).ok_or_else(|| JpegError::Damaged {
        reason: "bad frame header".to_owned(),
    })
}

/// Position of the first marker that does not belong to the coded data.
fn end_of_other_coding(jpeg: &[u8], mut at: usize) -> usize {
    loop {
        at = next_marker(jpeg, at);
        match jpeg.get(at + 1) {
            Some(0xd0..=0xd7) => at += 2,
            _ => return at,
        }
    }
}

#[cfg(test)]
mod tests;
