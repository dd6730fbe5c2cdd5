//! What is known of the empty floor: its picture, and how much each of its pixels changes from frame to frame.
//!
//! A floor is learned from frames ([`learner`]) or read from a file. Which part of the picture is floor at all, a [`region`]
//! says.
//!
//! # A floor as a file
//!
//! PNG with an alpha channel: the colours are the picture, alpha is 255 less the noise. Any program that shows pictures opens it, as good as
//! opaque, the more transparent the noisier. A picture without an alpha channel is anybody's picture of the floor: it is denoised
//! when it is read, and its noise is unknown. So the channel says which of the two a file is; a picture of one's own that has
//! one is better saved without.
//!
//! Deliberately absent: anything that changes a floor after it was learned.

pub mod learner;
pub mod region;

use std::fs;
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageResult};
use imgproc::Size;
use imgproc::median::median_3x3;

use crate::frame::Picture;
use crate::source::pictures::{PNG_SIGNATURE, PictureError, decode_png, read_picture};

/// Steps of [`Floor::noise`] in a grey level.
pub const NOISE_STEPS: f32 = 8.0;

/// The empty floor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Floor {
    /// What frames are compared with, already denoised as they are (3x3 median).
    pub picture: Picture,
    /// Standard deviation of each denoised pixel from frame to frame, root mean square over the colours, in eighths of a grey level.
    /// 255 is that or more, 0 is unknown.
    pub noise: Vec<u8>,
}

impl Floor {
    /// The floor that a picture shows as a camera sees it; its noise is unknown.
    ///
    /// # Panics
    ///
    /// When the planes of the picture do not have its size.
    #[must_use]
    pub fn from_picture(picture: &Picture) -> Self {
        let mut denoised = Picture::new(picture.size);
        denoise(picture, &mut denoised);
        Self {
            noise: vec![0; denoised.size.area()],
            picture: denoised,
        }
    }

    /// Reads a PNG or JPEG file: a floor, or a picture of one.
    ///
    /// # Errors
    ///
    /// [`PictureError`] when the file cannot be read or is damaged.
    pub fn read(path: &Path) -> Result<Self, PictureError> {
        let file = fs::read(path).map_err(|source| PictureError::Read {
            path: path.to_owned(),
            source,
        })?;
        if !file.starts_with(PNG_SIGNATURE) {
            return Ok(Self::from_picture(&read_picture(path)?));
        }
        Self::from_png(&file).map_err(|error| PictureError::Png {
            path: path.to_owned(),
            reason: error.to_string(),
        })
    }

    /// The floor that a PNG file holds, or that a picture in it shows.
    ///
    /// # Errors
    ///
    /// When the bytes are no PNG file, or a damaged one.
    pub fn from_png(png: &[u8]) -> ImageResult<Self> {
        let image = decode_png(png)?;
        let is_floor = image.color().has_alpha();
        let size = Size {
            width: image.width() as usize,
            height: image.height() as usize,
        };
        let pixels = image.into_rgba8().into_raw();
        let plane = |channel| pixels.iter().skip(channel).step_by(4).copied().collect();
        let picture = Picture {
            size,
            red: plane(0),
            green: plane(1),
            blue: plane(2),
        };
        if !is_floor {
            return Ok(Self::from_picture(&picture));
        }
        let alpha: Vec<u8> = plane(3);
        Ok(Self {
            picture,
            noise: alpha.into_iter().map(|alpha| 255 - alpha).collect(),
        })
    }

    /// The floor as a PNG file, from which it is read back as it is.
    ///
    /// # Panics
    ///
    /// When the floor is empty, or its planes or its noise do not have its size.
    #[must_use]
    pub fn to_png(&self) -> Vec<u8> {
        let Picture {
            size,
            red,
            green,
            blue,
        } = &self.picture;
        let colours = red.iter().zip(green).zip(blue);
        let pixels: Vec<u8> = colours
            .zip(&self.noise)
            .flat_map(|(((&red, &green), &blue), noise)| [red, green, blue, 255 - noise])
            .collect();
        let mut png = Vec::new();
        let (width, height) = (size.width as u32, size.height as u32);
        let written =
            PngEncoder::new(&mut png).write_image(&pixels, width, height, ExtendedColorType::Rgba8);
        if let Err(error) = written {
            panic!("a floor of {width}x{height} pixels cannot become a PNG file: {error}");
        }
        png
    }

    /// The noise that half of the pixels do not exceed, in grey levels; `None` where it is unknown.
    #[must_use]
    pub fn median_noise(&self) -> Option<f32> {
        let mut known: Vec<u8> = self.noise.iter().copied().filter(|&n| n > 0).collect();
        if known.is_empty() {
            return None;
        }
        let middle = known.len() / 2;
        let (_, median, _) = known.select_nth_unstable(middle);
        Some(f32::from(*median) / NOISE_STEPS)
    }
}

/// Removes the noise of single pixels, before pictures are compared.
///
/// # Panics
///
/// When the pictures have different sizes, or their planes do not have them.
pub(crate) fn denoise(picture: &Picture, out: &mut Picture) {
    median_3x3(&picture.red, picture.size, &mut out.red);
    median_3x3(&picture.green, picture.size, &mut out.green);
    median_3x3(&picture.blue, picture.size, &mut out.blue);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::pictures::write_png;

    const SIZE: Size = Size {
        width: 7,
        height: 5,
    };

    /// Every value of each plane is another one.
    fn picture() -> Picture {
        let plane = |first: u8| {
            (0..SIZE.area())
                .map(|i| first + (91 * i % 64) as u8)
                .collect()
        };
        Picture {
            size: SIZE,
            red: plane(0),
            green: plane(64),
            blue: plane(128),
        }
    }

    #[test]
    fn a_floor_survives_as_png() {
        let mut floor = Floor {
            picture: picture(),
            noise: (0..SIZE.area()).map(|i| 7 * i as u8).collect(),
        };
        // Neither unknown noise nor the greatest takes the colour away.
        floor.noise[20] = 255;
        let png = floor.to_png();
        assert_eq!(Floor::from_png(&png).expect("own PNG"), floor);
        floor.noise.fill(0);
        assert_eq!(Floor::from_png(&floor.to_png()).expect("own PNG"), floor);
        assert!(Floor::from_png(&png[..png.len() / 2]).is_err());
        assert!(Floor::from_png(b"GIF89a").is_err());
    }

    #[test]
    fn a_picture_without_alpha_is_denoised_and_of_unknown_noise() {
        let mut picture = picture();
        for plane in [&mut picture.red, &mut picture.green, &mut picture.blue] {
            plane.fill(100);
        }
        picture.green[17] = 255;
        let floor = Floor::from_png(&write_png(&picture)).expect("own PNG");
        assert_eq!(floor, Floor::from_picture(&picture));
        assert_eq!(floor.picture.green, [100; SIZE.area()]);
        assert_eq!(floor.noise, [0; SIZE.area()]);
        assert_eq!(floor.median_noise(), None);
    }

    #[test]
    fn the_median_noise_is_that_of_the_pixels_of_known_noise() {
        let mut floor = Floor::from_picture(&picture());
        floor.noise[..5].copy_from_slice(&[8, 200, 4, 12, 250]);
        assert_eq!(floor.median_noise(), Some(1.5));
    }
}
