//! PNG files: reading and writing.
//!
//! The format stores samples of 16 bits, scaled to the full range. Industrial cameras have 10, 12
//! or 14 bits, and their software often stores the values unscaled; interpreted according to the
//! standard, such a picture is almost black. [`Png::n_bits`] detects how many bits are in use.

use std::io::Cursor;

use ::png::{BitDepth, ColorType, Decoder, DecodingError, Encoder, Limits, Transformations};
use imgproc::Size;

use crate::image::limits::{AREA_MAX, MAX_SIDE, size_is_possible};

/// First bytes of every PNG file.
pub(crate) const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Maximum compression ratio.
const COMPRESSION_MAX: usize = 1_040;

/// If all samples of 16 bits are below this value, fewer bits are in use, unless they are scaled
/// from 8 bits: a sixteenth of the range is almost black.
const BLACK: u16 = 1 << 12;
/// The same for pictures that may also just be dark, which only their lowest bits can show.
const DARK: u16 = 1 << 14;

/// Reasons to reject a PNG file.
#[derive(Debug, thiserror::Error)]
pub enum PngError {
    /// The file is damaged.
    #[error("damaged PNG file: {0}")]
    Damaged(#[from] DecodingError),
    /// Its palette ends within a colour.
    #[error("damaged PNG file: its palette has {0} bytes, which is no multiple of three")]
    Palette(usize),
    /// The size in the header is above the limit, or impossible for the length of the file.
    #[error(
        "PNG file of {n_bytes} bytes that claims {}x{} pixels: sides must be 1 to {MAX_SIDE} pixels, no more than {AREA_MAX} in \
         all, and all in the file", claimed.width, claimed.height
    )]
    TooLarge {
        /// Size in the header.
        claimed: Size,
        /// Length of the file.
        n_bytes: usize,
    },
}

/// The content of a PNG file.
pub(crate) struct Png {
    pub(crate) size: Size,
    pub(crate) has_colour: bool,
    pub(crate) has_alpha: bool,
    is_deep: bool,
    /// Bits per sample before scaling to 16, as stated in the file.
    stated_bits: Option<u8>,
    /// Text chunks: keys and values.
    texts: Vec<(String, String)>,
    /// One or two bytes each, high byte first.
    samples: Vec<u8>,
}

impl Png {
    pub(crate) fn read(file: &[u8]) -> Result<Self, PngError> {
        let bytes = 8 * AREA_MAX;
        let mut decoder = Decoder::new_with_limits(Cursor::new(file), Limits { bytes });
        // Palettes become colours, and samples of fewer than 8 bits become 8 bits.
        decoder.set_transformations(Transformations::EXPAND);
        let header = decoder.read_header_info()?;
        let claimed = Size {
            width: header.width as usize,
            height: header.height as usize,
        };
        let too_large = PngError::TooLarge {
            claimed,
            n_bytes: file.len(),
        };
        if !size_is_possible(claimed) {
            return Err(too_large);
        }
        let packed = header.raw_row_length().saturating_mul(claimed.height);
        if packed / COMPRESSION_MAX > file.len() {
            return Err(too_large);
        }
        let mut reader = decoder.read_info()?;
        // The decoder takes three bytes for each colour without looking whether they are there.
        let n_palette = reader.info().palette.as_ref().map_or(0, |p| p.len());
        if n_palette % 3 != 0 {
            return Err(PngError::Palette(n_palette));
        }
        let mut samples = vec![0; reader.output_buffer_size().ok_or(too_large)?];
        let output = reader.next_frame(&mut samples)?;
        samples.truncate(output.buffer_size());
        let info = reader.info();
        let (colour, alpha) = match output.color_type {
            ColorType::Grayscale => (false, false),
            ColorType::GrayscaleAlpha => (false, true),
            ColorType::Rgb | ColorType::Indexed => (true, false),
            ColorType::Rgba => (true, true),
        };
        let n_colours = if colour { 3 } else { 1 };
        let stated = info.sbit.as_deref().and_then(|bits| bits.get(..n_colours));
        let text =
            |chunk: &::png::text_metadata::TEXtChunk| (chunk.keyword.clone(), chunk.text.clone());
        Ok(Self {
            size: claimed,
            has_colour: colour,
            has_alpha: alpha,
            is_deep: output.bit_depth == BitDepth::Sixteen,
            stated_bits: stated.and_then(|bits| bits.iter().copied().max()),
            texts: info.uncompressed_latin1_text.iter().map(text).collect(),
            samples,
        })
    }

    /// The value of a text chunk.
    pub(crate) fn text(&self, key: &str) -> Option<&str> {
        let text = self.texts.iter().find(|(found, _)| found == key)?;
        Some(&text.1)
    }

    fn n_channels(&self) -> usize {
        let n_colours = if self.has_colour { 3 } else { 1 };
        n_colours + usize::from(self.has_alpha)
    }

    /// Samples of 16 bits, without alpha.
    fn deep_colours(&self) -> impl Iterator<Item = u16> {
        let (n, has_alpha) = (self.n_channels(), self.has_alpha);
        let samples = self.samples.as_chunks::<2>().0.iter().enumerate();
        let colours = samples.filter(move |(i, _)| !has_alpha || i % n != n - 1);
        colours.map(|(_, sample)| u16::from_be_bytes(*sample))
    }

    /// Number of low bits of a sample that are in use, according to the file's metadata and its
    /// values; `None` if it has no samples of 16 bits, or only black ones.
    pub(crate) fn n_bits(&self) -> Option<u8> {
        if !self.is_deep {
            return None;
        }
        let largest = self.deep_colours().max().filter(|&largest| largest > 0)?;
        if let Some(stated @ 1..16) = self.stated_bits {
            let is_scaled = u32::from(largest) >> stated > 0;
            return Some(if is_scaled { 16 } else { stated });
        }
        // Scaled from 8 bits: both bytes equal, or the low byte zero. Such large steps, and values
        // of up to 12 bits shifted up, leave the lowest bits of all samples zero.
        let is_scaled = self.deep_colours().all(|sample| sample % 257 == 0)
            || self.deep_colours().all(|sample| sample % 256 == 0)
            || (largest >= BLACK && self.deep_colours().all(|sample| sample % 4 == 0));
        if largest >= DARK || is_scaled {
            return Some(16);
        }
        [8, 10, 12, 14]
            .into_iter()
            .find(|&bits| largest >> bits == 0)
    }

    /// Whether a sample exceeds this many bits.
    pub(crate) fn exceeds(&self, n_bits: u8) -> bool {
        n_bits < 16 && self.is_deep && self.deep_colours().any(|sample| sample >> n_bits > 0)
    }

    /// Grey samples, or red, green and blue triples. Of samples with 16 bits, `n_bits` are used.
    pub(crate) fn colours(&self, n_bits: Option<u8>) -> Vec<u8> {
        if self.is_deep {
            let white = u32::from(u16::MAX) >> (16 - n_bits.unwrap_or(16).clamp(1, 16));
            let reduce =
                |sample: u16| ((u32::from(sample).min(white) * 255 + white / 2) / white) as u8;
            return self.deep_colours().map(reduce).collect();
        }
        if !self.has_alpha {
            return self.samples.clone();
        }
        let pixels = self.samples.chunks_exact(self.n_channels());
        pixels
            .flat_map(|pixel| pixel[..pixel.len() - 1].iter().copied())
            .collect()
    }

    /// The alpha of each pixel, if there is an alpha channel.
    pub(crate) fn alpha(&self) -> Option<Vec<u8>> {
        let n_bytes = if self.is_deep { 2 } else { 1 };
        let pixels = self.samples.chunks_exact(n_bytes * self.n_channels());
        let alpha = pixels.map(|pixel| pixel[pixel.len() - n_bytes]);
        self.has_alpha.then(|| alpha.collect())
    }
}

/// Whether a file contains only its header, its pixels and its end.
pub(crate) fn is_bare(file: &[u8]) -> bool {
    let mut rest = file.get(SIGNATURE.len()..).unwrap_or_default();
    while let Some((&[a, b, c, d, kind @ ..], _)) = rest.split_first_chunk::<8>() {
        if ![*b"IHDR", *b"IDAT", *b"IEND"].contains(&kind) {
            return false;
        }
        // Length, type and checksum take 12 bytes.
        let length = u32::from_be_bytes([a, b, c, d]) as usize;
        rest = rest.get(12 + length..).unwrap_or_default();
    }
    true
}

/// Encodes pixels of 8 bits per sample as a PNG file, with an optional text chunk.
///
/// # Panics
///
/// If the size is zero or does not match the number of samples.
pub(crate) fn write(
    size: Size,
    colour: ColorType,
    samples: &[u8],
    text: Option<(&str, &str)>,
) -> Vec<u8> {
    let Size { width, height } = size;
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(BitDepth::Eight);
    let written = text
        .map_or(Ok(()), |(key, value)| {
            encoder.add_text_chunk(key.to_owned(), value.to_owned())
        })
        .and_then(|()| encoder.write_header())
        .and_then(|mut writer| {
            writer.write_image_data(samples)?;
            writer.finish()
        });
    if let Err(error) = written {
        panic!("{width}x{height} pixels cannot become a PNG file: {error}");
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by fuzzing: the decoder panicked.
    #[test]
    fn a_palette_that_ends_within_a_colour_is_refused() {
        let mut file = Vec::new();
        let mut encoder = Encoder::new(&mut file, 2, 2);
        encoder.set_color(ColorType::Indexed);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_palette(vec![1, 2, 3, 4]);
        encoder.set_trns(vec![1, 2]);
        let mut writer = encoder.write_header().expect("the header can be written");
        writer
            .write_image_data(&[0, 1, 0, 1])
            .expect("the pixels can be written");
        writer.finish().expect("the end can be written");
        assert!(matches!(Png::read(&file), Err(PngError::Palette(4))));
    }
}
