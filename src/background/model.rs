//! The model of the empty floor: its picture, and the frame-to-frame noise of each pixel.
//!
//! A background is learned from frames ([`learner`](crate::background::learner)) or read from a
//! file. A [`region`](crate::background::region) defines which part of the picture is floor.
//!
//! # File format
//!
//! PNG with an alpha channel: the colours are the picture, alpha is 255 minus the noise. Any image
//! viewer shows it, nearly opaque, more transparent where the noise is higher. A text chunk with
//! the key `overcam` marks such a file. Older versions wrote no mark. A file without one is
//! accepted as a background only if it contains nothing but pixels, none of them opaque and nearly
//! all with low noise, which no paint program writes.
//!
//! Any other file is an ordinary picture of the floor: it is denoised when it is read, and its
//! noise is unknown. Colours of partially transparent pixels are used as they are. Fully
//! transparent pixels have no known colour, so the file is rejected.
//!
//! Deliberately absent: anything that changes a background after it was learned.

use std::path::Path;

use imgproc::median::median_3x3;

use crate::image::frame::Picture;
use crate::image::picture_file::{PictureError, png_picture, read_file, read_png, read_with_alpha};
use crate::image::png::{self, Png, PngError};

/// Key and value of the text chunk that marks a background.
const MARK: (&str, &str) = ("overcam", "floor; alpha is 255 less the noise");

/// In a file without the mark, at most one pixel in this many has an alpha below 128, that is,
/// noise above 16 grey levels.
const NOISY_SHARE: usize = 100;

/// Steps of [`BackgroundModel::noise`] per grey level.
pub const NOISE_STEPS: f32 = 8.0;

/// The model of the empty floor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BackgroundModel {
    /// The picture that frames are compared with, denoised like them (3x3 median).
    pub picture: Picture,
    /// Standard deviation of each denoised pixel from frame to frame, RMS over the colours, in
    /// eighths of a grey level. 255 is that or more, 0 is unknown.
    pub noise: Vec<u8>,
}

impl BackgroundModel {
    /// Makes a background of a picture as a camera sees it; its noise is unknown.
    ///
    /// # Panics
    ///
    /// If the planes of the picture do not match its size.
    #[must_use]
    pub fn from_picture(picture: &Picture) -> Self {
        let mut denoised = Picture::new(picture.size);
        denoise(picture, &mut denoised);
        Self {
            noise: vec![0; denoised.size.area()],
            picture: denoised,
        }
    }

    /// Reads a PNG or JPEG file: a background, or a picture of the floor. In samples of 16 bits,
    /// `n_bits` bits are used; `None` takes the value from the file.
    ///
    /// # Errors
    ///
    /// [`PictureError`] if the file cannot be read, is damaged, or is a picture with fully
    /// transparent parts.
    pub fn read(path: &Path, n_bits: Option<u8>) -> Result<Self, PictureError> {
        let file = read_file(path)?;
        if !file.starts_with(png::SIGNATURE) {
            return Ok(Self::from_picture(&read_with_alpha(path, n_bits)?.0));
        }
        let png = read_png(&file, path)?;
        let Some(alpha) = png.alpha() else {
            return Ok(Self::from_picture(&png_picture(&png, n_bits)));
        };
        let is_marked = png.text(MARK.0).is_some();
        if is_marked || (png::is_bare(&file) && may_be_noise(&alpha)) {
            return Ok(Self::with_noise(&png, &alpha));
        }
        let n_transparent = alpha.iter().filter(|&&alpha| alpha == 0).count();
        if n_transparent > 0 {
            return Err(PictureError::Transparent {
                path: path.to_owned(),
                percent: 100.0 * n_transparent as f64 / alpha.len() as f64,
            });
        }
        Ok(Self::from_picture(&png_picture(&png, n_bits)))
    }

    /// Reads the background of a recording as written by [`BackgroundModel::to_png`], or a picture
    /// of the floor if it has no alpha channel.
    ///
    /// # Errors
    ///
    /// If the bytes are not a PNG file or are damaged.
    pub fn from_png(png: &[u8]) -> Result<Self, PngError> {
        let png = Png::read(png)?;
        Ok(match png.alpha() {
            Some(alpha) => Self::with_noise(&png, &alpha),
            None => Self::from_picture(&png_picture(&png, None)),
        })
    }

    fn with_noise(png: &Png, alpha: &[u8]) -> Self {
        Self {
            picture: png_picture(png, None),
            noise: alpha.iter().map(|alpha| 255 - alpha).collect(),
        }
    }

    /// The background as a PNG file, which is read back without loss.
    ///
    /// # Panics
    ///
    /// If the background is empty, or its planes or its noise do not match its size.
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
        png::write(*size, ::png::ColorType::Rgba, &pixels, Some(MARK))
    }

    /// Median noise in grey levels; `None` if unknown.
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

/// Whether an alpha channel may be that of a background learned by an older version: the noise of
/// every pixel is known, and is rarely high.
fn may_be_noise(alpha: &[u8]) -> bool {
    let n_noisy = alpha.iter().filter(|&&alpha| alpha < 128).count();
    alpha.iter().all(|&alpha| alpha < 255) && n_noisy <= alpha.len() / NOISY_SHARE
}

/// Removes the noise of single pixels before pictures are compared.
///
/// # Panics
///
/// If the sizes of the pictures differ, or their planes do not match them.
pub(crate) fn denoise(picture: &Picture, out: &mut Picture) {
    median_3x3(&picture.red, picture.size, &mut out.red);
    median_3x3(&picture.green, picture.size, &mut out.green);
    median_3x3(&picture.blue, picture.size, &mut out.blue);
}

#[cfg(test)]
mod tests {
    use std::fs;

    use imgproc::Size;

    use super::*;
    use crate::image::picture_file::write_png;

    const SIZE: Size = Size {
        width: 7,
        height: 5,
    };

    /// All values of a plane are different.
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
        let mut floor = BackgroundModel {
            picture: picture(),
            noise: (0..SIZE.area()).map(|i| 7 * i as u8).collect(),
        };
        // Neither unknown nor maximum noise changes the colour.
        floor.noise[20] = 255;
        let png = floor.to_png();
        assert_eq!(BackgroundModel::from_png(&png).expect("own PNG"), floor);
        floor.noise.fill(0);
        assert_eq!(
            BackgroundModel::from_png(&floor.to_png()).expect("own PNG"),
            floor
        );
        assert!(BackgroundModel::from_png(&png[..png.len() / 2]).is_err());
        assert!(BackgroundModel::from_png(b"GIF89a").is_err());
    }

    #[test]
    fn a_picture_without_alpha_is_denoised_and_of_unknown_noise() {
        let mut picture = picture();
        for plane in [&mut picture.red, &mut picture.green, &mut picture.blue] {
            plane.fill(100);
        }
        picture.green[17] = 255;
        let floor = BackgroundModel::from_png(&write_png(&picture)).expect("own PNG");
        assert_eq!(floor, BackgroundModel::from_picture(&picture));
        assert_eq!(floor.picture.green, [100; SIZE.area()]);
        assert_eq!(floor.noise, [0; SIZE.area()]);
        assert_eq!(floor.median_noise(), None);
    }

    fn read(png: &[u8]) -> Result<BackgroundModel, PictureError> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("floor.png");
        fs::write(&path, png).expect("written");
        BackgroundModel::read(&path, None)
    }

    /// A picture with an alpha channel, as other programs write it.
    fn with_alpha(alpha: &[u8], text: Option<(&str, &str)>) -> Vec<u8> {
        let picture = picture();
        let colours = picture.red.iter().zip(&picture.green).zip(&picture.blue);
        let pixels: Vec<u8> = colours
            .zip(alpha)
            .flat_map(|(((&red, &green), &blue), &alpha)| [red, green, blue, alpha])
            .collect();
        png::write(SIZE, ::png::ColorType::Rgba, &pixels, text)
    }

    #[test]
    fn a_file_is_a_floor_by_its_mark() {
        let mut floor = BackgroundModel {
            picture: picture(),
            noise: vec![0; SIZE.area()],
        };
        floor.noise[7] = 255;
        assert_eq!(read(&floor.to_png()).expect("own PNG"), floor);
    }

    #[test]
    fn a_floor_of_an_older_version_is_recognised_by_its_noise() {
        let alpha: Vec<u8> = (0..SIZE.area()).map(|i| 240 + (i % 5) as u8).collect();
        let floor = read(&with_alpha(&alpha, None)).expect("an old floor");
        assert_eq!(floor.picture, picture());
        assert_eq!(floor.noise[4], 255 - 244);
        // Text chunks come from other programs.
        let other = with_alpha(&alpha, Some(("Software", "a paint program")));
        let floor = read(&other).expect("a picture");
        assert_eq!(floor, BackgroundModel::from_picture(&picture()));
    }

    #[test]
    fn transparency_of_others_is_no_noise() {
        for alpha in [[255; SIZE.area()], [100; SIZE.area()]] {
            let floor = read(&with_alpha(&alpha, None)).expect("a picture");
            assert_eq!(floor, BackgroundModel::from_picture(&picture()));
        }
        let mut alpha = [255; SIZE.area()];
        alpha[..7].fill(0);
        let error = read(&with_alpha(&alpha, None)).expect_err("there is no floor");
        let line = error.to_string();
        assert!(
            line.contains("20.0 %") && line.contains("--region"),
            "{line}"
        );
    }

    #[test]
    fn the_median_noise_is_that_of_the_pixels_of_known_noise() {
        let mut floor = BackgroundModel::from_picture(&picture());
        floor.noise[..5].copy_from_slice(&[8, 200, 4, 12, 250]);
        assert_eq!(floor.median_noise(), Some(1.5));
    }
}
