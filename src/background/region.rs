//! The part of the picture that is floor. Everything else in view (walls, tables, a door) is
//! ignored.
//!
//! A region is a mask image, drawn over a picture of the floor in any paint program: light pixels
//! are floor; dark or transparent pixels are ignored. The mask is cleared outside the region before
//! shapes are searched, so an object across the border is clipped.
//!
//! Deliberately absent: several regions, names and polygons. A planner that needs them has the
//! positions.

use std::path::Path;

use imgproc::Size;

use crate::image::frame::Picture;
use crate::image::picture_file::{PictureError, png_picture, read_with_alpha};
use crate::image::png::{self, Png, PngError};

/// Minimum brightness of a floor pixel in the drawing.
const LIGHT: u16 = 128;

/// Minimum alpha of a floor pixel in the drawing; pixels that are more transparent were not drawn.
const DRAWN: u8 = 128;

/// Which pixels are floor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Region {
    size: Size,
    /// 1 for floor pixels, otherwise 0.
    floor: Vec<u8>,
}

/// Why a region cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RegionError {
    /// The file cannot be read as a picture.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// The region in a recording cannot be decoded.
    #[error("{name}: the region in it cannot be read ({source}); name another one with --region")]
    Png {
        /// The recording.
        name: String,
        /// Error of the decoder.
        source: PngError,
    },
    /// It was drawn for frames of another size.
    #[error(
        "region {name}: it is {} x {}, but the frames are {} x {}; draw it over one of these frames",
        found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// The file.
        name: String,
        /// Size of the region.
        found: Size,
        /// Size of the frames.
        expected: Size,
    },
    /// The region is empty.
    #[error(
        "region {name}: nothing in it is light and opaque, so nothing would be looked at; draw the floor white and the rest black"
    )]
    Empty {
        /// The file.
        name: String,
    },
}

impl Region {
    /// Reads a PNG or JPEG file that was drawn for frames of the given size.
    ///
    /// # Errors
    ///
    /// [`RegionError`] if the file cannot be read, its size differs, or no pixel in it is light.
    pub fn read(path: &Path, frames: Size) -> Result<Self, RegionError> {
        let name = path.display().to_string();
        let (picture, alpha) = read_with_alpha(path, None)?;
        Self::from_picture(&picture, alpha.as_deref(), &name, frames)
    }

    /// Reads the region of the recording `name`, as written by [`Region::to_png`].
    ///
    /// # Errors
    ///
    /// [`RegionError`] if it cannot be decoded, its size differs, or no pixel in it is light.
    pub fn from_png(png: &[u8], name: &str, frames: Size) -> Result<Self, RegionError> {
        let png = Png::read(png).map_err(|source| RegionError::Png {
            name: name.to_owned(),
            source,
        })?;
        let alpha = png.alpha();
        Self::from_picture(&png_picture(&png, None), alpha.as_deref(), name, frames)
    }

    fn from_picture(
        picture: &Picture,
        alpha: Option<&[u8]>,
        name: &str,
        frames: Size,
    ) -> Result<Self, RegionError> {
        let name = name.to_owned();
        if picture.size != frames {
            return Err(RegionError::Size {
                name,
                found: picture.size,
                expected: frames,
            });
        }
        let colours = picture.red.iter().zip(&picture.green).zip(&picture.blue);
        let mut floor: Vec<u8> = colours
            .map(|((&red, &green), &blue)| {
                let brightness = (u16::from(red) + 2 * u16::from(green) + u16::from(blue)) / 4;
                u8::from(brightness >= LIGHT)
            })
            .collect();
        for (floor, &alpha) in floor.iter_mut().zip(alpha.unwrap_or_default()) {
            *floor &= u8::from(alpha >= DRAWN);
        }
        if floor.iter().all(|&floor| floor == 0) {
            return Err(RegionError::Empty { name });
        }
        Ok(Self {
            size: frames,
            floor,
        })
    }

    /// The region as a black and white PNG file.
    ///
    /// # Panics
    ///
    /// If the PNG encoder rejects it, which cannot happen for a picture that was read.
    #[must_use]
    pub fn to_png(&self) -> Vec<u8> {
        let pixels: Vec<u8> = self.floor.iter().map(|&floor| 255 * floor).collect();
        png::write(self.size, ::png::ColorType::Grayscale, &pixels, None)
    }

    /// Size of the frames that it applies to.
    #[must_use]
    pub fn size(&self) -> Size {
        self.size
    }

    /// Share of the picture that is floor, above 0 and up to 1.
    #[must_use]
    pub fn share(&self) -> f64 {
        let floor: usize = self.floor.iter().map(|&floor| usize::from(floor)).sum();
        floor as f64 / self.floor.len() as f64
    }

    /// Clears a mask outside of the floor.
    ///
    /// # Panics
    ///
    /// If the size of the mask differs.
    pub(crate) fn clear_outside(&self, mask: &mut [u8]) {
        assert_eq!(mask.len(), self.floor.len(), "a mask has another size");
        for (mask, floor) in mask.iter_mut().zip(&self.floor) {
            *mask &= floor;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::picture_file::write_png;

    const SIZE: Size = Size {
        width: 6,
        height: 2,
    };

    fn drawing(greys: [u8; 12]) -> Picture {
        Picture {
            size: SIZE,
            red: greys.to_vec(),
            green: greys.to_vec(),
            blue: greys.to_vec(),
        }
    }

    #[test]
    fn light_is_floor_and_the_rest_is_taken_out() {
        let mut picture = drawing([0, 127, 128, 255, 0, 0, 255, 255, 255, 255, 0, 0]);
        // Yellow is light, blue is dark.
        (picture.red[4], picture.green[4]) = (255, 255);
        picture.blue[5] = 255;
        let png = write_png(&picture);
        let region = Region::from_png(&png, "run.mcap", SIZE).expect("it can be read");
        let mut mask = [1; 12];
        region.clear_outside(&mut mask);
        assert_eq!(mask, [0, 0, 1, 1, 1, 0, 1, 1, 1, 1, 0, 0]);
        mask = [0; 12];
        region.clear_outside(&mut mask);
        assert_eq!(mask, [0; 12]);
        assert!((region.share() - 7.0 / 12.0).abs() < 1e-12);
        let again = Region::from_png(&region.to_png(), "run.mcap", SIZE).expect("own PNG");
        assert_eq!(again, region);
    }

    #[test]
    fn what_is_transparent_is_not_looked_at() {
        let alpha = [255, 255, 128, 127, 0, 0, 255, 255, 255, 0, 0, 0];
        let pixels: Vec<u8> = alpha.iter().flat_map(|&alpha| [255, alpha]).collect();
        let png = png::write(SIZE, ::png::ColorType::GrayscaleAlpha, &pixels, None);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("region.png");
        std::fs::write(&path, &png).expect("written");
        let read = Region::read(&path, SIZE).expect("it can be read");
        assert_eq!(read.floor, [1, 1, 1, 0, 0, 0, 1, 1, 1, 0, 0, 0]);
        assert_eq!(
            Region::from_png(&png, "run.mcap", SIZE).expect("it can be read"),
            read
        );
    }

    #[test]
    fn what_cannot_be_a_region_is_refused() {
        let refused = |png: &[u8], frames| {
            let error = Region::from_png(png, "run.mcap", frames).expect_err("it is none");
            let line = error.to_string();
            assert!(line.contains("run.mcap") && !line.contains('\n'), "{line}");
            error
        };
        let light = write_png(&drawing([255; 12]));
        let dark = write_png(&drawing([127; 12]));
        let turned = Size {
            width: 2,
            height: 6,
        };
        assert!(matches!(refused(&light, turned), RegionError::Size { .. }));
        assert!(matches!(refused(&dark, SIZE), RegionError::Empty { .. }));
        assert!(matches!(refused(b"GIF89a", SIZE), RegionError::Png { .. }));
    }
}
