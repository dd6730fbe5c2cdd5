//! A frame as delivered by its source, and its decoding into colour planes.
//!
//! Frames stay in the format in which they were captured: a recording stores those bytes, and a
//! skipped frame is never decoded. [`decode`] converts one into a [`Picture`], three planes that
//! the algorithms read.
//!
//! # Colour
//!
//! Luma and chroma are converted to red, green and blue by the matrix of BT.601, which webcams,
//! JPEG and small videos use; the range is the frame's. A chroma sample applies to all pixels that
//! share it. Interpolated chroma would look better, but would make the colour of a pixel depend on
//! its neighbours before the background difference.
//!
//! The arithmetic uses integers, so a recording gives the same planes on every machine. A single
//! loop, `convert`, handles all formats: it reads three plain slices. Each layout is first unpacked
//! into such slices, in short blocks that stay in the L1 cache. Both steps are written so that the
//! compiler vectorises them.
//!
//! # Deliberately absent
//!
//! BT.709, gamma and colour profiles: the background and the frames come from the same camera, and
//! only their difference counts. Raw formats with more than 8 bits per sample: sources reject them.

use imgproc::Size;

use crate::image::jpeg::{self, JpegError};
use crate::image::limits::{AREA_MAX, MAX_SIDE, size_is_possible};

/// Layout of the bytes of a [`Frame`]. Rows and planes are contiguous, without padding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// One byte of luma per pixel.
    Grey,
    /// Red, green, blue, one byte each.
    Rgb,
    /// 4:2:2, two pixels in four bytes: Y U Y V.
    Yuyv,
    /// 4:2:2, two pixels in four bytes: U Y V Y.
    Uyvy,
    /// 4:2:0, a luma plane, then a plane of U V pairs.
    Nv12,
    /// 4:2:0, three planes: Y, U, V; chroma is rounded up to whole samples at odd sizes.
    I420,
    /// 4:2:2, three planes: Y, U, V; chroma is rounded up to whole samples at odd widths.
    I422,
    /// 4:4:4, three planes: Y, U, V.
    I444,
    /// A JPEG image, with or without its Huffman tables (MJPEG cameras omit them).
    Jpeg,
}

/// One frame in the format of its source. The buffer is reused for the next frames.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Index of the frame in its source, from 0.
    pub sequence: u64,
    /// Time of exposure: `CLOCK_MONOTONIC` for a camera, otherwise time since the first frame.
    pub stamp_ns: u64,
    /// Layout of `bytes`.
    pub format: PixelFormat,
    /// Whether luma and chroma use 0 to 255 instead of 16 to 235 and 16 to 240. Ignored for `Grey`,
    /// `Rgb` and `Jpeg`.
    pub full_range: bool,
    /// Size of the picture.
    pub size: Size,
    /// The pixels.
    pub bytes: Vec<u8>,
}

/// A colour image as three planes of equal size, full range.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Size of each plane.
    pub size: Size,
    /// Red, 0 to 255.
    pub red: Vec<u8>,
    /// Green, 0 to 255.
    pub green: Vec<u8>,
    /// Blue, 0 to 255.
    pub blue: Vec<u8>,
}

/// Reasons why a frame cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// A side is 0 or longer than [`MAX_SIDE`], or there are more than [`AREA_MAX`] pixels.
    #[error(
        "a picture of {}x{} pixels cannot be decoded: sides must be 1 to {MAX_SIDE} pixels, and no more than {AREA_MAX} in all",
        size.width,
        size.height
    )]
    Size {
        /// Size given by the frame.
        size: Size,
    },
    /// The number of raw bytes does not match size and format.
    #[error(
        "a {}x{} frame in {format:?} has {expected} bytes, this one has {found}: the source cut it or states a wrong size",
        size.width,
        size.height
    )]
    ByteCount {
        /// Format of the frame.
        format: PixelFormat,
        /// Size given by the frame.
        size: Size,
        /// Number of bytes of a frame of this format and size.
        expected: usize,
        /// Number of bytes of this frame.
        found: usize,
    },
    /// A JPEG image that is damaged or differs in size from its frame.
    #[error(transparent)]
    Jpeg(#[from] JpegError),
}

impl PixelFormat {
    /// Number of bytes of a frame of this format and size. `None` for [`PixelFormat::Jpeg`], whose
    /// length varies, and for a size with a side of 0 or above [`MAX_SIDE`], or an area above
    /// [`AREA_MAX`].
    #[must_use]
    pub const fn frame_bytes(self, size: Size) -> Option<usize> {
        if !size_is_possible(size) {
            return None;
        }
        let chroma_width = size.width.div_ceil(2);
        let chroma_height = size.height.div_ceil(2);
        match self {
            Self::Grey => Some(size.area()),
            Self::Rgb | Self::I444 => Some(3 * size.area()),
            Self::Yuyv | Self::Uyvy => Some(4 * chroma_width * size.height),
            Self::Nv12 | Self::I420 => Some(size.area() + 2 * chroma_width * chroma_height),
            Self::I422 => Some(size.area() + 2 * chroma_width * size.height),
            Self::Jpeg => None,
        }
    }
}

impl Frame {
    /// An empty frame, to be filled by a source.
    #[must_use]
    pub const fn empty() -> Self {
        Self {
            sequence: 0,
            stamp_ns: 0,
            format: PixelFormat::Grey,
            full_range: true,
            size: Size {
                width: 0,
                height: 0,
            },
            bytes: Vec::new(),
        }
    }
}

impl Picture {
    /// A black picture.
    #[must_use]
    pub fn new(size: Size) -> Self {
        let plane = vec![0; size.area()];
        Self {
            size,
            red: plane.clone(),
            green: plane.clone(),
            blue: plane,
        }
    }

    /// Changes the size and reuses the memory of the planes; their content is arbitrary afterwards.
    pub fn resize(&mut self, size: Size) {
        self.size = size;
        for plane in [&mut self.red, &mut self.green, &mut self.blue] {
            plane.resize(size.area(), 0);
        }
    }
}

/// Decodes a frame into three full-range planes. The picture takes the frame's size and reuses its
/// memory; a raw format does not allocate if the size is unchanged.
///
/// # Errors
///
/// [`DecodeError`] if the bytes do not match the frame's size and format. The picture's content is
/// then arbitrary.
pub fn decode(frame: &Frame, picture: &mut Picture) -> Result<(), DecodeError> {
    let size = frame.size;
    if !size_is_possible(size) {
        return Err(DecodeError::Size { size });
    }
    picture.resize(size);
    let Some(expected) = frame.format.frame_bytes(size) else {
        let interleaved = jpeg::decode_rgb(&frame.bytes, size)?;
        split_rgb(&interleaved, picture);
        return Ok(());
    };
    if frame.bytes.len() != expected {
        return Err(DecodeError::ByteCount {
            format: frame.format,
            size,
            expected,
            found: frame.bytes.len(),
        });
    }
    match frame.format {
        PixelFormat::Grey => {
            for plane in [&mut picture.red, &mut picture.green, &mut picture.blue] {
                plane.copy_from_slice(&frame.bytes);
            }
        }
        PixelFormat::Rgb => split_rgb(&frame.bytes, picture),
        _ if frame.full_range => decode_yuv::<true>(frame, picture),
        _ => decode_yuv::<false>(frame, picture),
    }
    Ok(())
}

/// Splits interleaved red, green, blue samples into planes.
fn split_rgb(interleaved: &[u8], picture: &mut Picture) {
    let planes = picture
        .red
        .iter_mut()
        .zip(&mut picture.green)
        .zip(&mut picture.blue);
    for (rgb, ((red, green), blue)) in interleaved.as_chunks::<3>().0.iter().zip(planes) {
        [*red, *green, *blue] = *rgb;
    }
}

/// Number of pixels unpacked at a time. Even, so that a block never starts inside a pair of pixels
/// that share chroma.
const BLOCK: usize = 128;

/// One block of pixels with one luma and two chroma samples each.
struct Block {
    y: [u8; BLOCK],
    u: [u8; BLOCK],
    v: [u8; BLOCK],
}

/// Decodes any format with luma and chroma. The length of the frame has been checked.
fn decode_yuv<const FULL_RANGE: bool>(frame: &Frame, picture: &mut Picture) {
    let width = frame.size.width;
    let bytes = frame.bytes.as_slice();
    let (luma, chroma) = bytes.split_at(frame.size.area().min(bytes.len()));
    let chroma_width = width.div_ceil(2);
    let mut block = Block {
        y: [0; BLOCK],
        u: [0; BLOCK],
        v: [0; BLOCK],
    };
    let rows = picture
        .red
        .chunks_exact_mut(width)
        .zip(picture.green.chunks_exact_mut(width))
        .zip(picture.blue.chunks_exact_mut(width));
    for (row, ((red, green), blue)) in rows.enumerate() {
        let luma_row = || &luma[row * width..][..width];
        match frame.format {
            PixelFormat::I444 => {
                let (u, v) = chroma.split_at(frame.size.area());
                let (u, v) = (&u[row * width..][..width], &v[row * width..][..width]);
                convert::<FULL_RANGE>(luma_row(), u, v, red, green, blue);
                continue;
            }
            PixelFormat::Yuyv | PixelFormat::Uyvy => {
                let pairs = &bytes[row * 4 * chroma_width..][..4 * chroma_width];
                let pairs = pairs.as_chunks::<4>().0;
                let luma_first = frame.format == PixelFormat::Yuyv;
                in_blocks::<FULL_RANGE>([red, green, blue], &mut block, |block, at| {
                    unpack_packed(&pairs[at / 2..], luma_first, block);
                });
            }
            PixelFormat::Nv12 => {
                let pairs = &chroma[row / 2 * 2 * chroma_width..][..2 * chroma_width];
                let pairs = pairs.as_chunks::<2>().0;
                in_blocks::<FULL_RANGE>([red, green, blue], &mut block, |block, at| {
                    copy_start(&luma_row()[at..], &mut block.y);
                    double(pairs[at / 2..].iter().map(|pair| pair[0]), &mut block.u);
                    double(pairs[at / 2..].iter().map(|pair| pair[1]), &mut block.v);
                });
            }
            _ => {
                let (u, v) = chroma.split_at(chroma.len() / 2);
                let chroma_row = match frame.format {
                    PixelFormat::I420 => row / 2,
                    _ => row,
                };
                let u = &u[chroma_row * chroma_width..][..chroma_width];
                let v = &v[chroma_row * chroma_width..][..chroma_width];
                in_blocks::<FULL_RANGE>([red, green, blue], &mut block, |block, at| {
                    copy_start(&luma_row()[at..], &mut block.y);
                    double(u[at / 2..].iter().copied(), &mut block.u);
                    double(v[at / 2..].iter().copied(), &mut block.v);
                });
            }
        }
    }
}

/// Converts one row block by block; `unpack` fills the block that starts at the given pixel.
fn in_blocks<const FULL_RANGE: bool>(
    [red, green, blue]: [&mut [u8]; 3],
    block: &mut Block,
    unpack: impl Fn(&mut Block, usize),
) {
    let blocks = red
        .chunks_mut(BLOCK)
        .zip(green.chunks_mut(BLOCK))
        .zip(blue.chunks_mut(BLOCK));
    for (i, ((red, green), blue)) in blocks.enumerate() {
        unpack(block, i * BLOCK);
        convert::<FULL_RANGE>(&block.y, &block.u, &block.v, red, green, blue);
    }
}

/// Copies as many samples as fit.
fn copy_start(samples: &[u8], block: &mut [u8; BLOCK]) {
    let n = samples.len().min(BLOCK);
    block[..n].copy_from_slice(&samples[..n]);
}

/// Uses each chroma sample for two pixels.
fn double(samples: impl Iterator<Item = u8>, block: &mut [u8; BLOCK]) {
    for (pair, sample) in block.as_chunks_mut::<2>().0.iter_mut().zip(samples) {
        *pair = [sample; 2];
    }
}

/// Two pixels in four bytes: Y U Y V or U Y V Y.
fn unpack_packed(pairs: &[[u8; 4]], luma_first: bool, block: &mut Block) {
    let y = block.y.as_chunks_mut::<2>().0.iter_mut();
    let u = block.u.as_chunks_mut::<2>().0.iter_mut();
    let v = block.v.as_chunks_mut::<2>().0.iter_mut();
    let out = y.zip(u).zip(v).zip(pairs);
    if luma_first {
        for (((y, u), v), &[y0, u0, y1, v0]) in out {
            (*y, *u, *v) = ([y0, y1], [u0; 2], [v0; 2]);
        }
    } else {
        for (((y, u), v), &[u0, y0, v0, y1]) in out {
            (*y, *u, *v) = ([y0, y1], [u0; 2], [v0; 2]);
        }
    }
}

/// Fraction bits of the sums from which the colours are rounded.
///
/// All arithmetic fits 16 bits, for the largest number of pixels per vector register. A product
/// keeps its upper 16 bits, which is one instruction, while a 32-bit product takes several. So
/// samples are shifted up and factors have [`FACTOR_BITS`] fraction bits, such that both just fit
/// and the upper half has `SUM_BITS` fraction bits. The largest sum, white with the largest blue
/// difference, is 32 * (278 + 258).
const SUM_BITS: u32 = 5;
/// Fraction bits of the factors; the largest is 2.017.
const FACTOR_BITS: u32 = 13;
/// Left shift of a sample before it is multiplied by a factor: a colour difference then fills 16
/// bits.
const CHROMA_SHIFT: u32 = SUM_BITS + 16 - FACTOR_BITS;
/// The factor of luma is at most 1.164 and has one bit more, because luma is shifted by one bit
/// less.
const LUMA_SHIFT: u32 = CHROMA_SHIFT - 1;

/// Weights of red and blue in luma (BT.601, 2.5.1).
const KR: f64 = 0.299;
const KB: f64 = 0.114;

/// Contributions of luma and colour differences to each colour, in fixed point.
struct Factors {
    /// Luma of black.
    black: i16,
    luma: i16,
    red_v: i16,
    green_u: i16,
    green_v: i16,
    blue_u: i16,
}

/// Solves BT.601's definitions of luma and of the colour differences for the colours:
///
/// ```text
/// R = y + 2 (1 - Kr) v
/// G = y - (2 Kb (1 - Kb) u + 2 Kr (1 - Kr) v) / Kg
/// B = y + 2 (1 - Kb) u
/// ```
///
/// with Kg = 1 - Kr - Kb, y from 0 to 1 and u, v from -1/2 to 1/2. Limited range stretches y from
/// 219 steps above 16 to 255 steps, and u, v from 224 steps.
const fn factors(full_range: bool) -> Factors {
    const fn fixed_point(factor: f64, bits: u32) -> i16 {
        (factor * (1 << bits) as f64 + 0.5) as i16
    }
    const KG: f64 = 1.0 - KR - KB;
    let (black, luma, chroma) = match full_range {
        true => (0, 1.0, 1.0),
        false => (16, 255.0 / 219.0, 255.0 / 224.0),
    };
    Factors {
        black,
        luma: fixed_point(luma, FACTOR_BITS + 1),
        red_v: fixed_point(chroma * 2.0 * (1.0 - KR), FACTOR_BITS),
        green_u: fixed_point(chroma * 2.0 * KB * (1.0 - KB) / KG, FACTOR_BITS),
        green_v: fixed_point(chroma * 2.0 * KR * (1.0 - KR) / KG, FACTOR_BITS),
        blue_u: fixed_point(chroma * 2.0 * (1.0 - KB), FACTOR_BITS),
    }
}

/// Computes red, green and blue for the length of `red`; `y`, `u` and `v` have one sample per pixel
/// and may be longer.
///
/// Out of line with one parameter per slice, so that the compiler knows that the planes do not
/// overlap (640x480 pixels in 4:2:0 take 0.28 ms instead of 0.41).
#[inline(never)]
fn convert<const FULL_RANGE: bool>(
    y: &[u8],
    u: &[u8],
    v: &[u8],
    red: &mut [u8],
    green: &mut [u8],
    blue: &mut [u8],
) {
    let factors = const { factors(FULL_RANGE) };
    let upper_half = |a: i16, b: i16| ((i32::from(a) * i32::from(b)) >> 16) as i16;
    let to_byte = |sum: i16| (sum >> SUM_BITS).clamp(0, 255) as u8;
    let planes = red.iter_mut().zip(green).zip(blue);
    for (((&y, &u), &v), ((red, green), blue)) in y.iter().zip(u).zip(v).zip(planes) {
        let y = (i16::from(y) - factors.black) << LUMA_SHIFT;
        let u = (i16::from(u) - 128) << CHROMA_SHIFT;
        let v = (i16::from(v) - 128) << CHROMA_SHIFT;
        let half_a_level = 1 << (SUM_BITS - 1);
        let y = upper_half(y, factors.luma) + half_a_level;
        *red = to_byte(y + upper_half(v, factors.red_v));
        *green = to_byte(y - upper_half(u, factors.green_u) - upper_half(v, factors.green_v));
        *blue = to_byte(y + upper_half(u, factors.blue_u));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RAW_FORMATS: [PixelFormat; 8] = [
        PixelFormat::Grey,
        PixelFormat::Rgb,
        PixelFormat::Yuyv,
        PixelFormat::Uyvy,
        PixelFormat::Nv12,
        PixelFormat::I420,
        PixelFormat::I422,
        PixelFormat::I444,
    ];

    fn frame(format: PixelFormat, full_range: bool, size: (usize, usize), bytes: &[u8]) -> Frame {
        Frame {
            format,
            full_range,
            size: Size {
                width: size.0,
                height: size.1,
            },
            bytes: bytes.to_vec(),
            ..Frame::empty()
        }
    }

    fn decoded(frame: &Frame) -> Result<Picture, DecodeError> {
        let mut picture = Picture::new(Size {
            width: 1,
            height: 1,
        });
        decode(frame, &mut picture)?;
        Ok(picture)
    }

    /// One pixel, computed from the definitions of the layouts and of BT.601, without rounding.
    fn naive_pixel(frame: &Frame, x: usize, y: usize) -> [f64; 3] {
        let Size { width, height } = frame.size;
        let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
        let area = width * height;
        let byte = |i: usize| f64::from(frame.bytes[i]);
        let pixel = y * width + x;
        let (luma, u, v) = match frame.format {
            PixelFormat::Grey => return [byte(pixel); 3],
            PixelFormat::Rgb => return [0, 1, 2].map(|i| byte(3 * pixel + i)),
            PixelFormat::Yuyv => {
                let pair = 4 * (y * half_width + x / 2);
                (pair + 2 * (x % 2), pair + 1, pair + 3)
            }
            PixelFormat::Uyvy => {
                let pair = 4 * (y * half_width + x / 2);
                (pair + 1 + 2 * (x % 2), pair, pair + 2)
            }
            PixelFormat::Nv12 => {
                let pair = area + 2 * (y / 2 * half_width + x / 2);
                (pixel, pair, pair + 1)
            }
            PixelFormat::I420 => {
                let u = area + y / 2 * half_width + x / 2;
                (pixel, u, u + half_width * half_height)
            }
            PixelFormat::I422 => {
                let u = area + y * half_width + x / 2;
                (pixel, u, u + half_width * height)
            }
            PixelFormat::I444 => (pixel, pixel + area, pixel + 2 * area),
            PixelFormat::Jpeg => unreachable!("not a raw format"),
        };
        let (luma, u, v) = match frame.full_range {
            true => (byte(luma), byte(u) - 128.0, byte(v) - 128.0),
            false => (
                (byte(luma) - 16.0) * 255.0 / 219.0,
                (byte(u) - 128.0) * 255.0 / 224.0,
                (byte(v) - 128.0) * 255.0 / 224.0,
            ),
        };
        let red = luma + 1.402 * v;
        let blue = luma + 1.772 * u;
        // Green from the definition of luma, Y = 0.299 R + 0.587 G + 0.114 B, independent of the
        // factors in the code.
        let green = (luma - 0.299 * red - 0.114 * blue) / 0.587;
        [red, green, blue].map(|colour| colour.clamp(0.0, 255.0))
    }

    proptest! {
        /// Tolerance: rounding of the result (half a level); at most two products rounded down in
        /// the same direction (one step of the sum each); and at most three factors off by half a
        /// step of their fraction, times a sample of at most 255.
        #[test]
        fn raw_formats_match_the_definition(
            format in prop::sample::select(&RAW_FORMATS[..]),
            full_range: bool,
            size in (1_usize..300, 1_usize..6),
            seed in prop::collection::vec(any::<u8>(), 97),
        ) {
            let mut frame = frame(format, full_range, size, &[]);
            let n = format.frame_bytes(frame.size).expect("a raw format");
            // A short random sequence of prime length, so that no row or plane starts with the same
            // sample as its neighbour.
            frame.bytes = seed.iter().copied().cycle().take(n).collect();
            let picture = decoded(&frame).expect("a correct frame");
            let step = |bits: u32| 0.5_f64.powi(bits as i32);
            let tolerance = 0.5 + 2.0 * step(SUM_BITS) + 3.0 * 0.5 * step(FACTOR_BITS) * 255.0;
            for y in 0..size.1 {
                for x in 0..size.0 {
                    let i = y * size.0 + x;
                    let found = [picture.red[i], picture.green[i], picture.blue[i]];
                    for (found, exact) in found.into_iter().zip(naive_pixel(&frame, x, y)) {
                        prop_assert!((f64::from(found) - exact).abs() <= tolerance, "{found} {exact} at {x},{y}");
                    }
                }
            }
        }

        #[test]
        fn any_bytes_and_sizes_are_an_answer(
            format in prop::sample::select(&RAW_FORMATS[..]),
            size in (0_usize..20, 0_usize..20),
            bytes in prop::collection::vec(any::<u8>(), 0..600),
        ) {
            let frame = frame(format, true, size, &bytes);
            let fits = format.frame_bytes(frame.size) == Some(bytes.len());
            prop_assert_eq!(decoded(&frame).is_ok(), fits);
        }
    }

    #[test]
    fn a_jpeg_keeps_colours_that_change_from_column_to_column() {
        const SIDE: usize = 16;
        let column = |x: usize| [[230, 40, 30], [30, 50, 220]][x % 2];
        let pixels: Vec<u8> = (0..SIDE * SIDE).flat_map(|i| column(i % SIDE)).collect();
        let mut bytes = Vec::new();
        let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 100);
        encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::R_4_4_4);
        encoder
            .encode(
                &pixels,
                SIDE as u16,
                SIDE as u16,
                jpeg_encoder::ColorType::Rgb,
            )
            .expect("encodes");
        let jpeg = frame(PixelFormat::Jpeg, true, (SIDE, SIDE), &bytes);
        let picture = decoded(&jpeg).expect("a picture");
        for i in 0..SIDE * SIDE {
            let found = [picture.red[i], picture.green[i], picture.blue[i]];
            for (found, drawn) in found.into_iter().zip(column(i % SIDE)) {
                assert!(
                    found.abs_diff(drawn) < 6,
                    "{found}, not {drawn}, in pixel {i}"
                );
            }
        }
    }

    #[test]
    fn limited_range_reaches_black_white_and_the_primaries() {
        // Y, U, V of black, white and saturated red in limited range; 81, 90, 240 is the textbook
        // value for red.
        let bytes = [16, 235, 81, 128, 128, 90, 128, 128, 240];
        let picture = decoded(&frame(PixelFormat::I444, false, (3, 1), &bytes)).expect("a frame");
        assert_eq!(picture.red, [0, 255, 254]);
        assert_eq!(picture.green, [0, 255, 0]);
        assert_eq!(picture.blue, [0, 255, 0]);
    }

    #[test]
    fn odd_sizes_round_chroma_up() {
        let size = Size {
            width: 5,
            height: 3,
        };
        let bytes = |format: PixelFormat| format.frame_bytes(size);
        assert_eq!(bytes(PixelFormat::I420), Some(15 + 2 * 3 * 2));
        assert_eq!(bytes(PixelFormat::Nv12), Some(15 + 2 * 3 * 2));
        assert_eq!(bytes(PixelFormat::I422), Some(15 + 2 * 3 * 3));
        assert_eq!(bytes(PixelFormat::Yuyv), Some(3 * 3 * 4));
        assert_eq!(bytes(PixelFormat::Jpeg), None);
    }

    #[test]
    fn a_short_frame_names_both_counts() {
        let error = decoded(&frame(PixelFormat::Yuyv, false, (4, 2), &[0; 15])).expect_err("short");
        assert!(matches!(
            error,
            DecodeError::ByteCount {
                expected: 16,
                found: 15,
                ..
            }
        ));
        assert!(error.to_string().contains("4x2"));
    }

    #[test]
    fn sizes_that_could_overflow_are_refused() {
        for size in [(0, 4), (4, 0), (MAX_SIDE + 1, 1), (usize::MAX, usize::MAX)] {
            for format in [PixelFormat::Grey, PixelFormat::I444, PixelFormat::Jpeg] {
                let error = decoded(&frame(format, true, size, &[])).expect_err("impossible");
                assert!(matches!(error, DecodeError::Size { .. }));
            }
        }
    }

    #[test]
    fn planes_keep_their_memory() {
        let big = frame(PixelFormat::Yuyv, false, (64, 64), &[90; 64 * 64 * 2]);
        let small = frame(PixelFormat::Nv12, false, (10, 10), &[90; 150]);
        let mut picture = Picture::new(big.size);
        let memory = picture.green.as_ptr();
        for frame in [&small, &big, &small, &big] {
            decode(frame, &mut picture).expect("a correct frame");
            assert_eq!(picture.size, frame.size);
            assert_eq!(picture.green.len(), frame.size.area());
            assert_eq!(picture.green.as_ptr(), memory);
        }
    }
}
