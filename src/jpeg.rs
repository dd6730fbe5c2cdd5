//! JPEG pictures as cameras and files deliver them (ITU-T T.81): completeness, missing Huffman tables, decoding.
//!
//! [`zune_jpeg`] decodes. What it does not do, this module does first, on one walk over the picture:
//!
//! * a picture whose data end before its pixels do is refused, with or without an end marker behind them: the decoder would fill
//!   the rest with grey, which the background difference would take for an object. `scan` reads every code to know;
//! * the size is compared before anything is allocated;
//! * Motion-JPEG cameras omit the Huffman tables, because they are always the standard's; [`insert_huffman_tables`] puts them
//!   back, for the decoder and for other readers of a recording;
//! * what cameras do to pictures that are whole all the same is mended: a missing end marker, fill bytes before restart markers,
//!   stray bytes behind the data.

mod huffman;
mod scan;

use std::borrow::Cow;
use std::ops::Range;

use imgproc::Size;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::frame::{AREA_MAX, MAX_SIDE, size_is_possible};
use crate::jpeg::huffman::{Tables, define, standard_tables};
use crate::jpeg::scan::{Coding, FrameHeader, ScanError, next_marker};

/// Second byte of the markers that matter here (T.81, table B.1).
const HUFFMAN_TABLES: u8 = 0xc4;
const START_OF_IMAGE: u8 = 0xd8;
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_SCAN: u8 = 0xda;
const RESTART_INTERVAL: u8 = 0xdd;

/// Most scans of a picture. Programs write up to about ten, and each costs time even where it has no data.
const SCANS_MAX: usize = 100;

/// Why a JPEG picture cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum JpegError {
    /// The bytes do not begin like a JPEG picture, or what follows has no structure.
    #[error("not a JPEG picture: no segment begins at byte {at} of {length}")]
    NotJpeg {
        /// Where a segment should begin.
        at: usize,
        /// Bytes given.
        length: usize,
    },
    /// The picture ends before its pixels do.
    #[error("JPEG picture cut off: its {length} bytes do not hold all of its pixels")]
    Truncated {
        /// Bytes given.
        length: usize,
    },
    /// The picture ends without having had a frame header or a scan.
    #[error("JPEG picture without pixels: it has no frame header or no scan")]
    Empty,
    /// The header claims more pixels than a picture may have.
    #[error(
        "JPEG picture that claims {}x{} pixels: sides must be 1 to {MAX_SIDE} pixels, and no more than {AREA_MAX} in all",
        claimed.width, claimed.height
    )]
    TooLarge {
        /// Size in the picture's header.
        claimed: Size,
    },
    /// The picture has another size than its frame.
    #[error(
        "JPEG picture of {}x{} pixels where {}x{} were expected: all frames of a source must have one size",
        found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// Size of the frame.
        expected: Size,
        /// Size in the picture's header.
        found: Size,
    },
    /// The coded data have no meaning, or the decoder gave up.
    #[error("damaged JPEG picture: {reason}")]
    Damaged {
        /// What is wrong.
        reason: String,
    },
}

/// What one walk over a picture finds.
struct Layout {
    size: Size,
    /// Whether any Huffman tables are defined.
    has_tables: bool,
    /// Where the first scan's header begins.
    first_scan: usize,
    /// Behind the last scan, or behind the end marker if there is one. Cameras pad their buffers behind it.
    end: usize,
    has_end_marker: bool,
    /// Stretches in scans that belong to nothing.
    junk: Vec<Range<usize>>,
}

/// Size of a JPEG picture that is whole: its data hold all of its pixels.
///
/// # Errors
///
/// [`JpegError`] when the bytes are not one whole JPEG picture.
pub fn size(jpeg: &[u8]) -> Result<Size, JpegError> {
    walk(jpeg).map(|layout| layout.size)
}

/// The picture as every decoder reads it: with the standard's Huffman tables (T.81, K.3) before its first scan, if it has none of
/// its own, with an end-of-image marker, without what follows that, and without stray bytes. Borrowed when nothing had to be
/// mended.
///
/// # Errors
///
/// [`JpegError`] when the bytes are not one whole JPEG picture.
pub fn insert_huffman_tables(jpeg: &[u8]) -> Result<Cow<'_, [u8]>, JpegError> {
    walk(jpeg).map(|layout| mended(jpeg, &layout))
}

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

/// Decodes a colour or grey picture to red, green, blue triples, `3 * expected.area()` bytes.
///
/// # Errors
///
/// [`JpegError`] when the picture is not whole or not of the expected size, or its coded data are damaged.
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
    let damaged = |reason: String| JpegError::Damaged { reason };
    let rgb = JpegDecoder::new_with_options(ZCursor::new(&complete), options)
        .decode()
        .map_err(|error| damaged(error.to_string()))?;
    if rgb.len() != 3 * expected.area() {
        return Err(damaged(format!("{} bytes of pixels", rgb.len())));
    }
    Ok(rgb)
}

/// Walks from segment to segment, so that a marker inside a thumbnail or a comment is not taken for one of the picture's, and
/// through the data of each scan.
fn walk(jpeg: &[u8]) -> Result<Layout, JpegError> {
    let length = jpeg.len();
    if !jpeg.starts_with(&[0xff, 0xd8]) {
        return Err(JpegError::NotJpeg { at: 0, length });
    }
    let jpeg = without_padding(jpeg);
    let cut_off = JpegError::Truncated { length };
    let damaged = |reason: &str| JpegError::Damaged {
        reason: reason.to_owned(),
    };
    let mut frame: Option<FrameHeader> = None;
    let mut tables = Tables::default();
    define_standard(&mut tables);
    let (mut has_tables, mut first_scan, mut n_scans) = (false, None, 0);
    let (mut restart_interval, mut junk) = (0, Vec::new());
    let mut at = 2;
    let has_end_marker = loop {
        let rest = &jpeg[at.min(jpeg.len())..];
        let is_whole = first_scan.is_some() && frame.as_ref().is_some_and(FrameHeader::is_complete);
        match rest {
            // Fewer bytes than a marker has are left of a padding; a start of image begins another picture.
            [] | [_] | [0xff, START_OF_IMAGE, ..] if is_whole => break false,
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
                match *marker {
                    HUFFMAN_TABLES => {
                        has_tables = true;
                        define(&mut tables, content)
                            .ok_or_else(|| damaged("bad Huffman tables"))?;
                    }
                    RESTART_INTERVAL => {
                        let interval = content
                            .first_chunk()
                            .ok_or_else(|| damaged("bad restart interval"))?;
                        restart_interval = usize::from(u16::from_be_bytes(*interval));
                    }
                    0xc0..=0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => {
                        frame = Some(frame_header(*marker, content)?);
                    }
                    _ => {}
                }
                at += 2 + n_bytes;
                if *marker == START_OF_SCAN {
                    first_scan = first_scan.or(Some(at - 2 - n_bytes));
                    n_scans += 1;
                    let Some(frame) = frame.as_mut().filter(|_| n_scans <= SCANS_MAX) else {
                        return Err(if n_scans > SCANS_MAX {
                            damaged("too many scans")
                        } else {
                            JpegError::Empty
                        });
                    };
                    at = if frame.coding == Coding::Other {
                        end_of_other_coding(jpeg, at)
                    } else {
                        scan::read(
                            jpeg,
                            at,
                            content,
                            frame,
                            &tables,
                            restart_interval,
                            &mut junk,
                        )
                        .map_err(|error| match error {
                            ScanError::Short => cut_off.clone(),
                            ScanError::Damaged(reason) => damaged(reason),
                        })?
                    };
                }
            }
            [] | [0xff] | [0xff, _] | [0xff, _, _] => return Err(cut_off),
            _ => return Err(JpegError::NotJpeg { at, length }),
        }
    };
    let (Some(frame), Some(first_scan)) = (frame, first_scan) else {
        return Err(JpegError::Empty);
    };
    if !frame.is_complete() {
        return Err(cut_off);
    }
    Ok(Layout {
        size: frame.size,
        has_tables,
        first_scan,
        end: (at + if has_end_marker { 2 } else { 0 }).min(jpeg.len()),
        has_end_marker,
        junk,
    })
}

/// The picture without the zeros with which a camera pads its buffer: where there is no end marker, they would be read as pixels. A
/// single one may belong to the data, as one behind a 255 does.
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
    // Marker and length come before the tables.
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

/// The first marker that does not belong to the coded data.
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
mod tests {
    use super::*;
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
    use proptest::prelude::*;

    const SIZE: Size = Size {
        width: 37,
        height: 21,
    };

    /// A picture with the standard's tables, as this encoder writes them unless asked to optimise.
    fn encode(color: ColorType, sampling: SamplingFactor) -> Vec<u8> {
        encode_with(color, sampling, |_| {})
    }

    fn encode_with(
        color: ColorType,
        sampling: SamplingFactor,
        set: impl FnOnce(&mut Encoder<&mut Vec<u8>>),
    ) -> Vec<u8> {
        let channels = if color == ColorType::Luma { 1 } else { 3 };
        let pixels: Vec<u8> = (0..SIZE.area())
            .flat_map(|i| {
                let (x, y) = (i % SIZE.width, i / SIZE.width);
                let checks = if (x / 5 + y / 3) % 2 == 0 { 200 } else { 30 };
                [checks, (6 * x) as u8, (10 * y) as u8]
                    .into_iter()
                    .take(channels)
            })
            .collect();
        let mut jpeg = Vec::new();
        let mut encoder = Encoder::new(&mut jpeg, 90);
        encoder.set_sampling_factor(sampling);
        set(&mut encoder);
        encoder
            .encode(&pixels, SIZE.width as u16, SIZE.height as u16, color)
            .expect("encodes");
        jpeg
    }

    /// What a Motion-JPEG camera sends: no Huffman tables.
    fn without_tables(jpeg: &[u8]) -> Vec<u8> {
        let mut stripped = jpeg[..2].to_vec();
        let mut at = 2;
        while jpeg[at + 1] != START_OF_SCAN {
            let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
            if jpeg[at + 1] != HUFFMAN_TABLES {
                stripped.extend(&jpeg[at..end]);
            }
            at = end;
        }
        stripped.extend(&jpeg[at..]);
        stripped
    }

    #[test]
    fn missing_tables_change_nothing() {
        for sampling in [
            SamplingFactor::R_4_4_4,
            SamplingFactor::R_4_2_2,
            SamplingFactor::R_4_2_0,
        ] {
            let jpeg = encode(ColorType::Rgb, sampling);
            let stripped = without_tables(&jpeg);
            assert!(stripped.len() + 400 < jpeg.len());
            let expected = decode_rgb(&jpeg, SIZE).expect("whole");
            assert_eq!(decode_rgb(&stripped, SIZE).expect("mended"), expected);
            let mended = insert_huffman_tables(&stripped).expect("whole");
            assert_eq!(decode_rgb(&mended, SIZE).expect("whole"), expected);
            assert!(matches!(
                insert_huffman_tables(&mended),
                Ok(Cow::Borrowed(_))
            ));
        }
    }

    #[test]
    fn colours_survive() {
        let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_4_4);
        let rgb = decode_rgb(&jpeg, SIZE).expect("whole");
        // Centre of a check, far from its edges.
        let pixel = &rgb[3 * (10 * SIZE.width + 17)..][..3];
        for (found, drawn) in pixel.iter().zip([200, 6 * 17, 10 * 10]) {
            assert!((i32::from(*found) - drawn).abs() < 25, "{pixel:?}");
        }
    }

    #[test]
    fn grey_pictures_have_three_equal_channels() {
        let jpeg = without_tables(&encode(ColorType::Luma, SamplingFactor::R_4_4_4));
        let rgb = decode_rgb(&jpeg, SIZE).expect("whole");
        assert!(
            rgb.as_chunks::<3>()
                .0
                .iter()
                .all(|p| p[0] == p[1] && p[1] == p[2])
        );
        assert!(rgb.iter().max() > Some(&150) && rgb.iter().min() < Some(&80));
    }

    #[test]
    fn another_size_is_refused_with_both() {
        let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
        let expected = Size {
            width: 21,
            height: 37,
        };
        assert_eq!(
            decode_rgb(&jpeg, expected),
            Err(JpegError::Size {
                expected,
                found: SIZE
            })
        );
    }

    /// Pictures in every way in which they can be coded here: sampling, restart markers, several scans.
    fn codings() -> Vec<Vec<u8>> {
        let mut pictures = Vec::new();
        for sampling in [
            SamplingFactor::R_4_4_4,
            SamplingFactor::R_4_2_2,
            SamplingFactor::R_4_2_0,
        ] {
            for (restart, progressive) in [
                (None, None),
                (Some(2), None),
                (None, Some(4)),
                (None, Some(9)),
            ] {
                pictures.push(encode_with(ColorType::Rgb, sampling, |encoder| {
                    if let Some(interval) = restart {
                        encoder.set_restart_interval(interval);
                    }
                    if let Some(scans) = progressive {
                        encoder.set_progressive_scans(scans);
                    }
                }));
            }
        }
        pictures.push(encode(ColorType::Luma, SamplingFactor::R_4_4_4));
        pictures
    }

    #[test]
    fn every_cut_is_refused_with_and_without_end_marker() {
        for jpeg in codings() {
            let whole = decode_rgb(&jpeg, SIZE).expect("whole");
            let end = jpeg.len() - 2;
            for length in 0..end {
                let cut = &jpeg[..length];
                assert!(decode_rgb(cut, SIZE).is_err(), "{length} of {end} bytes");
                let marked = [cut, &[0xff, END_OF_IMAGE]].concat();
                assert!(
                    decode_rgb(&marked, SIZE).is_err(),
                    "{length} of {end} bytes, marked"
                );
                let padded = [cut, &[0; 400]].concat();
                assert!(
                    decode_rgb(&padded, SIZE).is_err(),
                    "{length} of {end} bytes, padded"
                );
            }
            for length in [end, end + 1] {
                assert_eq!(decode_rgb(&jpeg[..length], SIZE), Ok(whole.clone()));
                let padded = [&jpeg[..length], &[0; 400]].concat();
                assert_eq!(decode_rgb(&padded, SIZE), Ok(whole.clone()));
            }
            let two = [&jpeg[..end], &jpeg].concat();
            assert_eq!(decode_rgb(&two, SIZE), Ok(whole));
        }
    }

    #[test]
    fn a_missing_end_marker_is_put_back_for_others() {
        let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
        let open = without_tables(&jpeg[..jpeg.len() - 2]);
        let mended = insert_huffman_tables(&open).expect("whole");
        assert!(mended.ends_with(&[0xff, END_OF_IMAGE]));
        assert_eq!(decode_rgb(&mended, SIZE), decode_rgb(&jpeg, SIZE));
    }

    /// The places of the restart markers.
    fn restart_markers(jpeg: &[u8]) -> Vec<usize> {
        let is_one = |&at: &usize| jpeg[at] == 0xff && (0xd0..=0xd7).contains(&jpeg[at + 1]);
        (600..jpeg.len() - 1).filter(is_one).collect()
    }

    #[test]
    fn fill_and_stray_bytes_before_restart_markers_change_nothing() {
        for jpeg in codings() {
            let whole = decode_rgb(&jpeg, SIZE).expect("whole");
            for junk in [
                &[0xff][..],
                &[0xff; 5],
                &[0x07, 0x5a, 0x13],
                &[0x07, 0xff, 0x00, 0xff],
            ] {
                let mut changed = Vec::new();
                let mut from = 0;
                for at in restart_markers(&jpeg) {
                    changed.extend(&jpeg[from..at]);
                    changed.extend(junk);
                    from = at;
                }
                changed.extend(&jpeg[from..jpeg.len() - 2]);
                changed.extend(junk);
                changed.extend([0xff, END_OF_IMAGE]);
                assert_eq!(decode_rgb(&changed, SIZE), Ok(whole.clone()), "{junk:?}");
                let mended = insert_huffman_tables(&changed).expect("whole");
                assert_eq!(decode_rgb(&mended, SIZE), Ok(whole.clone()), "{junk:?}");
            }
        }
    }

    #[test]
    fn a_picture_that_lost_its_middle_is_refused() {
        let jpeg = encode_with(ColorType::Rgb, SamplingFactor::R_4_2_0, |encoder| {
            encoder.set_restart_interval(1);
        });
        let markers = restart_markers(&jpeg);
        assert!(markers.len() > 3);
        let lost = [&jpeg[..markers[1]], &jpeg[markers[2]..]].concat();
        let error = decode_rgb(&lost, SIZE).expect_err("an interval lacks");
        assert!(error.to_string().contains("restart marker"), "{error}");
    }

    #[test]
    fn a_header_may_not_claim_everything() {
        let mut jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
        let header = (0..)
            .find(|&at| jpeg[at..at + 2] == [0xff, 0xc0])
            .expect("a frame header");
        for (height, width) in [(65_535, 65_535), (1, 65_535), (16_384, 16_384), (0, 16)] {
            jpeg[header + 5..header + 7].copy_from_slice(&u16::to_be_bytes(height));
            jpeg[header + 7..header + 9].copy_from_slice(&u16::to_be_bytes(width));
            let claimed = Size {
                width: width.into(),
                height: height.into(),
            };
            assert_eq!(size(&jpeg), Err(JpegError::TooLarge { claimed }));
        }
        // A size that is possible is not believed either, without the data of so many pixels.
        jpeg[header + 5..header + 9].copy_from_slice(&[0x1f, 0xf0, 0x1f, 0xf0]);
        assert!(matches!(size(&jpeg), Err(JpegError::Truncated { .. })));
    }

    #[test]
    fn padding_behind_the_picture_is_ignored() {
        let jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_2);
        let padded = [&jpeg[..], &[0; 1000]].concat();
        assert_eq!(decode_rgb(&padded, SIZE), decode_rgb(&jpeg, SIZE));
        assert_eq!(
            insert_huffman_tables(&padded).expect("whole").as_ref(),
            jpeg
        );
    }

    #[test]
    fn other_files_are_named_as_such() {
        assert!(matches!(
            decode_rgb(b"\x89PNG", SIZE),
            Err(JpegError::NotJpeg { at: 0, length: 4 })
        ));
        assert_eq!(size(&[0xff, 0xd8, 0xff, 0xd9]), Err(JpegError::Empty));
    }

    proptest! {
        #[test]
        fn damage_is_an_error_or_a_picture(
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
            strip: bool,
        ) {
            let mut jpeg = encode(ColorType::Rgb, SamplingFactor::R_4_2_0);
            if strip {
                jpeg = without_tables(&jpeg);
            }
            for (at, byte) in damage {
                let at = at.index(jpeg.len());
                jpeg[at] = byte;
            }
            if let Ok(rgb) = decode_rgb(&jpeg, SIZE) {
                prop_assert_eq!(rgb.len(), 3 * SIZE.area());
            }
        }
    }
}
