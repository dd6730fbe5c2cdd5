//! Single image files: PNG and JPEG are read, PNG is written. The format is detected from the first
//! bytes, not the name.

use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::image::frame::{DecodeError, Frame, Picture, PixelFormat, decode};
use crate::image::jpeg::{self, JpegError};
use crate::image::png::{self, Png, PngError};

/// Reasons to reject an image file.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The file is neither PNG nor JPEG.
    #[error("{}: neither a PNG nor a JPEG file", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// A PNG file that cannot be decoded.
    #[error("{}: {source}", path.display())]
    Png {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: PngError,
    },
    /// A picture of the floor with fully transparent parts.
    #[error(
        "{}: {percent:.1} % of it is fully transparent, so that there is no floor to compare with: save it without transparency; \
         which part of the picture is looked at, --region says", path.display()
    )]
    Transparent {
        /// The file.
        path: PathBuf,
        /// Percentage of transparent pixels.
        percent: f64,
    },
    /// A damaged JPEG file.
    #[error("{}: {source}", path.display())]
    Jpeg {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: JpegError,
    },
    /// A file whose pixels cannot be decoded.
    #[error("{}: {source}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: DecodeError,
    },
}

/// Reads and decodes a PNG or JPEG file.
///
/// # Errors
///
/// [`PictureError`] if the file cannot be read or is damaged.
pub fn read_picture(path: &Path) -> Result<Picture, PictureError> {
    read_with_alpha(path, None).map(|(picture, _)| picture)
}

/// Reads and decodes a PNG or JPEG file, with the alpha of each pixel if there is an alpha channel.
/// In samples of 16 bits, `n_bits` bits are used; `None` takes the value from the file.
pub(crate) fn read_with_alpha(
    path: &Path,
    n_bits: Option<u8>,
) -> Result<(Picture, Option<Vec<u8>>), PictureError> {
    let file = read_file(path)?;
    if file.starts_with(png::SIGNATURE) {
        let png = read_png(&file, path)?;
        return Ok((png_picture(&png, n_bits), png.alpha()));
    }
    let mut frame = Frame::empty();
    read_frame(path, n_bits, &mut frame)?;
    let mut picture = Picture::new(frame.size);
    decode(&frame, &mut picture).map_err(|source| PictureError::Decode {
        path: path.to_owned(),
        source,
    })?;
    Ok((picture, None))
}

pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, PictureError> {
    fs::read(path).map_err(|source| PictureError::Read {
        path: path.to_owned(),
        source,
    })
}

pub(crate) fn read_png(file: &[u8], path: &Path) -> Result<Png, PictureError> {
    Png::read(file).map_err(|source| PictureError::Png {
        path: path.to_owned(),
        source,
    })
}

/// The colours of a PNG file. In samples of 16 bits, `n_bits` bits are used; `None` takes the value
/// from the file.
pub(crate) fn png_picture(png: &Png, n_bits: Option<u8>) -> Picture {
    let colours = png.colours(n_bits.or_else(|| png.n_bits()));
    let n = if png.has_colour { 3 } else { 1 };
    let plane = |channel| colours.iter().skip(channel).step_by(n).copied().collect();
    Picture {
        size: png.size,
        red: plane(0),
        green: plane(n / 2),
        blue: plane(n - 1),
    }
}

/// Encodes the picture as a PNG file.
///
/// # Panics
///
/// If the picture is empty or its planes do not match its size.
#[must_use]
pub fn write_png(picture: &Picture) -> Vec<u8> {
    let channels = picture.red.iter().zip(&picture.green).zip(&picture.blue);
    let interleaved: Vec<u8> = channels
        .flat_map(|((&red, &green), &blue)| [red, green, blue])
        .collect();
    png::write(picture.size, ::png::ColorType::Rgb, &interleaved, None)
}

/// Fills format, size and bytes of a frame from a file. Returns true if samples exceed the given
/// number of bits.
pub(crate) fn read_frame(
    path: &Path,
    n_bits: Option<u8>,
    frame: &mut Frame,
) -> Result<bool, PictureError> {
    let file = read_file(path)?;
    frame.full_range = true;
    frame.bytes.clear();
    if file.starts_with(&[0xff, 0xd8]) {
        frame.size = jpeg::size(&file).map_err(|source| PictureError::Jpeg {
            path: path.to_owned(),
            source,
        })?;
        frame.format = PixelFormat::Jpeg;
        frame.bytes.extend_from_slice(&file);
        return Ok(false);
    }
    if !file.starts_with(png::SIGNATURE) {
        return Err(PictureError::Format {
            path: path.to_owned(),
        });
    }
    let png = read_png(&file, path)?;
    let n_bits = n_bits.or_else(|| png.n_bits());
    frame.size = png.size;
    frame.format = if png.has_colour {
        PixelFormat::Rgb
    } else {
        PixelFormat::Grey
    };
    frame.bytes.extend_from_slice(&png.colours(n_bits));
    Ok(n_bits.is_some_and(|n_bits| png.exceeds(n_bits)))
}
