//! JPEG pictures as cameras and files deliver them (ITU-T T.81): completeness, missing Huffman tables, decoding.
//!
//! [`zune_jpeg`] decodes. What it does not do, this module does first, on one walk over the picture's segments:
//!
//! * a picture that ends early is refused: the decoder notices it only when whole rows of blocks are missing, and would fill
//!   the rest of the last row with grey, which the background difference would take for an object;
//! * the size is compared before anything is allocated;
//! * Motion-JPEG cameras omit the Huffman tables, because they are always the standard's; [`insert_huffman_tables`] puts them
//!   back, for the decoder and for other readers of a recording.

use std::borrow::Cow;

use imgproc::Size;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Second byte of the markers that matter here (T.81, table B.1).
const HUFFMAN_TABLES: u8 = 0xc4;
const END_OF_IMAGE: u8 = 0xd9;
const START_OF_SCAN: u8 = 0xda;

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
    /// The end-of-image marker is missing.
    #[error("JPEG picture cut off: {length} bytes without an end-of-image marker")]
    Truncated {
        /// Bytes given.
        length: usize,
    },
    /// The picture ends without having had a frame header or a scan.
    #[error("JPEG picture without pixels: it has no frame header or no scan")]
    Empty,
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
    /// The decoder gave up.
    #[error("damaged JPEG picture: {reason}")]
    Damaged {
        /// What the decoder says.
        reason: String,
    },
}

/// What one walk over a picture's segments finds.
struct Layout {
    size: Size,
    /// Whether any Huffman tables are defined.
    has_tables: bool,
    /// Where the first scan's header begins.
    first_scan: usize,
    /// First byte after the end-of-image marker. Cameras pad their buffers behind it.
    end: usize,
}

/// Size of a JPEG picture, from its header.
///
/// # Errors
///
/// [`JpegError`] when the bytes are not one whole JPEG picture.
pub fn size(jpeg: &[u8]) -> Result<Size, JpegError> {
    walk(jpeg).map(|layout| layout.size)
}

/// The picture with the standard's Huffman tables (T.81, K.3) before its first scan, if it has none of its own, and without
/// what follows the end-of-image marker. Borrowed when nothing had to be inserted.
///
/// # Errors
///
/// [`JpegError`] when the bytes are not one whole JPEG picture.
pub fn insert_huffman_tables(jpeg: &[u8]) -> Result<Cow<'_, [u8]>, JpegError> {
    walk(jpeg).map(|layout| with_tables(jpeg, &layout))
}

fn with_tables<'a>(jpeg: &'a [u8], layout: &Layout) -> Cow<'a, [u8]> {
    let picture = &jpeg[..layout.end];
    if layout.has_tables {
        return Cow::Borrowed(picture);
    }
    let (head, scans) = picture.split_at(layout.first_scan);
    Cow::Owned([head, &standard_huffman_tables(), scans].concat())
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
    let complete = with_tables(jpeg, &layout);
    let damaged = |reason: String| JpegError::Damaged { reason };
    let rgb = JpegDecoder::new_with_options(ZCursor::new(&complete), options)
        .decode()
        .map_err(|error| damaged(error.to_string()))?;
    if rgb.len() != 3 * expected.area() {
        return Err(damaged(format!("{} bytes of pixels", rgb.len())));
    }
    Ok(rgb)
}

/// Walks from segment to segment, so that a marker inside a thumbnail or a comment is not taken for one of the picture's.
fn walk(jpeg: &[u8]) -> Result<Layout, JpegError> {
    let length = jpeg.len();
    let byte = |at: usize| jpeg.get(at).copied().ok_or(JpegError::Truncated { length });
    let number = |at: usize| Ok(usize::from(u16::from_be_bytes([byte(at)?, byte(at + 1)?])));
    if !jpeg.starts_with(&[0xff, 0xd8]) {
        return Err(JpegError::NotJpeg { at: 0, length });
    }
    let (mut size, mut has_tables, mut first_scan) = (None, false, None);
    let mut at = 2;
    loop {
        if byte(at)? != 0xff {
            return Err(JpegError::NotJpeg { at, length });
        }
        let marker = byte(at + 1)?;
        match marker {
            // Any number of fill bytes may precede a marker.
            0xff => at += 1,
            END_OF_IMAGE => break,
            // TEM and RSTn have no length.
            0x01 | 0xd0..=0xd7 => at += 2,
            _ => {
                match marker {
                    // Start of frame: precision, height, width.
                    0xc0..=0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => {
                        let (height, width) = (number(at + 5)?, number(at + 7)?);
                        size = Some(Size { width, height });
                    }
                    HUFFMAN_TABLES => has_tables = true,
                    START_OF_SCAN => first_scan = first_scan.or(Some(at)),
                    _ => {}
                }
                at += 2 + number(at + 2)?;
                if marker == START_OF_SCAN {
                    at = skip_coded_data(jpeg, at).ok_or(JpegError::Truncated { length })?;
                }
            }
        }
    }
    match (size, first_scan) {
        (Some(size), Some(first_scan)) => Ok(Layout {
            size,
            has_tables,
            first_scan,
            end: at + 2,
        }),
        _ => Err(JpegError::Empty),
    }
}

/// Where the first marker after entropy-coded data begins. In such data a byte of 255 is followed by 0, or by a restart
/// marker, which belongs to the data.
fn skip_coded_data(jpeg: &[u8], mut at: usize) -> Option<usize> {
    loop {
        at += jpeg.get(at..)?.iter().position(|&byte| byte == 0xff)?;
        match jpeg.get(at + 1)? {
            0x00 | 0xd0..=0xd7 => at += 2,
            _ => return Some(at),
        }
    }
}

/// Symbols of the standard's Huffman tables by length of their codes, from 1 bit (T.81, tables K.3 to K.6).
///
/// For the AC tables, 16-bit codes are not listed: they stand for all other symbols, in ascending order. The symbols are those
/// of baseline coding: end of block (00), sixteen zeros (f0), and run of zeros 0 to 15 times magnitude category 1 to 10.
const DC_LUMA: [&[u8]; 9] = [
    &[],
    &[0],
    &[1, 2, 3, 4, 5],
    &[6],
    &[7],
    &[8],
    &[9],
    &[10],
    &[11],
];
const DC_CHROMA: [&[u8]; 11] = [
    &[],
    &[0, 1, 2],
    &[3],
    &[4],
    &[5],
    &[6],
    &[7],
    &[8],
    &[9],
    &[10],
    &[11],
];
const AC_LUMA: [&[u8]; 15] = [
    &[],
    &[0x01, 0x02],
    &[0x03],
    &[0x00, 0x04, 0x11],
    &[0x05, 0x12, 0x21],
    &[0x31, 0x41],
    &[0x06, 0x13, 0x51, 0x61],
    &[0x07, 0x22, 0x71],
    &[0x14, 0x32, 0x81, 0x91, 0xa1],
    &[0x08, 0x23, 0x42, 0xb1, 0xc1],
    &[0x15, 0x52, 0xd1, 0xf0],
    &[0x24, 0x33, 0x62, 0x72],
    &[],
    &[],
    &[0x82],
];
const AC_CHROMA: [&[u8]; 15] = [
    &[],
    &[0x00, 0x01],
    &[0x02],
    &[0x03, 0x11],
    &[0x04, 0x05, 0x21, 0x31],
    &[0x06, 0x12, 0x41, 0x51],
    &[0x07, 0x61, 0x71],
    &[0x13, 0x22, 0x32, 0x81],
    &[0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1],
    &[0x09, 0x23, 0x33, 0x52, 0xf0],
    &[0x15, 0x62, 0x72, 0xd1],
    &[0x0a, 0x16, 0x24, 0x34],
    &[],
    &[0xe1],
    &[0x25, 0xf1],
];

/// One segment that defines all four standard tables.
fn standard_huffman_tables() -> Vec<u8> {
    let mut tables = Vec::with_capacity(418);
    // Class (0 DC, 1 AC) and number of each table.
    for (id, by_length) in [
        (0x00, &DC_LUMA[..]),
        (0x10, &AC_LUMA),
        (0x01, &DC_CHROMA),
        (0x11, &AC_CHROMA),
    ] {
        let listed = by_length.concat();
        let is_ac = id & 0x10 != 0;
        let others: Vec<u8> = (0..=u8::MAX)
            .filter(|symbol| is_ac && (1..=10).contains(&(symbol & 0x0f)))
            .filter(|symbol| !listed.contains(symbol))
            .collect();
        let n_others = others.len() as u8;
        let n_of_length = |i: usize| by_length.get(i).map_or(0, |symbols| symbols.len() as u8);
        tables.push(id);
        tables.extend((0..15).map(n_of_length));
        tables.push(n_others);
        tables.extend(listed);
        tables.extend(others);
    }
    let segment_bytes = (2 + tables.len()) as u16;
    [
        &[0xff, HUFFMAN_TABLES],
        &segment_bytes.to_be_bytes()[..],
        &tables,
    ]
    .concat()
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

    #[test]
    fn every_truncation_is_refused() {
        for sampling in [SamplingFactor::R_4_4_4, SamplingFactor::R_4_2_0] {
            let jpeg = without_tables(&encode(ColorType::Rgb, sampling));
            for end in 0..jpeg.len() {
                assert!(decode_rgb(&jpeg[..end], SIZE).is_err(), "{end} bytes");
            }
        }
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
