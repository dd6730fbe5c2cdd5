//! From a picture to the mask of everything that stands on the floor (section 2.1.1 of the paper).
//!
//! Median, difference from the empty floor, threshold on the 3x3 sum, opening, closing.

use imgproc::Size;
use imgproc::difference::{
    Colour, DifferenceSettings, HueSaturationLightness, HueSaturationLightnessMut, difference,
    hue_saturation_lightness,
};
use imgproc::morphology::{close_3x3, open_3x3};
use imgproc::threshold::window_threshold;

use crate::floor::{Floor, denoise};
use crate::frame::Picture;

/// Finds objects before one floor. All memory is taken when it is made.
#[derive(Debug)]
pub(crate) struct Segmenter {
    size: Size,
    denoised: Picture,
    towards_red: Vec<i16>,
    towards_green: Vec<i16>,
    lightness: Vec<u8>,
    difference: Vec<u8>,
    mask: Vec<u8>,
    scratch: Vec<u8>,
}

impl Segmenter {
    /// A segmenter for one floor.
    ///
    /// # Panics
    ///
    /// When the planes of the picture do not have its size.
    pub(crate) fn new(floor: &Floor) -> Self {
        let size = floor.picture.size;
        let mut segmenter = Self {
            size,
            denoised: Picture::new(size),
            towards_red: vec![0; size.area()],
            towards_green: vec![0; size.area()],
            lightness: vec![0; size.area()],
            difference: vec![0; size.area()],
            mask: vec![0; size.area()],
            scratch: vec![0; size.area()],
        };
        segmenter.set_floor(floor);
        segmenter
    }

    /// Compares with another floor from now on.
    ///
    /// # Panics
    ///
    /// When it has another size.
    pub(crate) fn set_floor(&mut self, floor: &Floor) {
        let planes = HueSaturationLightnessMut {
            towards_red: &mut self.towards_red,
            towards_green: &mut self.towards_green,
            lightness: &mut self.lightness,
        };
        hue_saturation_lightness(colour(&floor.picture), self.size, planes);
    }

    /// The mask of a picture: 1 where something stands. The caller may use it up.
    ///
    /// # Panics
    ///
    /// When the picture has another size than the floor.
    pub(crate) fn segment(
        &mut self,
        picture: &Picture,
        settings: &DifferenceSettings,
        threshold: u16,
    ) -> &mut [u8] {
        denoise(picture, &mut self.denoised);
        let floor = HueSaturationLightness {
            towards_red: &self.towards_red,
            towards_green: &self.towards_green,
            lightness: &self.lightness,
        };
        difference(
            colour(&self.denoised),
            floor,
            self.size,
            &mut self.difference,
            settings,
        );
        window_threshold(&self.difference, self.size, &mut self.mask, threshold);
        open_3x3(&mut self.mask, self.size, &mut self.scratch);
        close_3x3(&mut self.mask, self.size, &mut self.scratch);
        &mut self.mask
    }
}

fn colour(picture: &Picture) -> Colour<'_> {
    Colour {
        red: &picture.red,
        green: &picture.green,
        blue: &picture.blue,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size {
        width: 16,
        height: 12,
    };
    const SETTINGS: DifferenceSettings = DifferenceSettings {
        shadow: 0.4,
        glare: 0.1,
        noise: 6,
    };

    fn grey(level: u8) -> Picture {
        let plane = vec![level; SIZE.area()];
        Picture {
            size: SIZE,
            red: plane.clone(),
            green: plane.clone(),
            blue: plane,
        }
    }

    #[test]
    fn a_box_is_found_and_a_speck_is_not() {
        let mut picture = grey(120);
        for y in 3..8 {
            picture.red[y * SIZE.width + 4..y * SIZE.width + 10].fill(220);
        }
        picture.blue[10 * SIZE.width + 13] = 255;
        let mut segmenter = Segmenter::new(&Floor::from_picture(&grey(120)));
        let mask = segmenter.segment(&picture, &SETTINGS, 100);
        // A pixel next to strong colour has it in its window: the mask may be one pixel wider on each side.
        assert_eq!(mask[5 * SIZE.width + 6], 1);
        let found: usize = mask.iter().map(|&m| usize::from(m)).sum();
        assert!((30..=56).contains(&found), "{found} pixels");
        assert_eq!(mask[10 * SIZE.width + 13], 0);
    }
}
