//! Difference between a frame and the picture of the empty floor (section 2.1.1 of the paper).
//!
//! The paper compares hue and saturation and discards lightness, so that shadows and changing light do not count. Both
//! are taken together here, as a vector that points in the direction of the hue and is as long as the saturation. With
//! `max` and `min` of red, green and blue, HSL saturation is `(max - min) / min(max + min, 510 - max - min)`; the hue's
//! direction is that of `(2R - G - B, √3 (G - B))`, whose length is `max - min` within 15 %. So the vector is
//!
//! ```text
//! (2R - G - B, √3 (G - B)) * 127 / (min(max + min, 510 - max - min) + REGULARISATION)
//! ```
//!
//! and needs neither an angle nor a branch.
//!
//! # Differences from the paper
//!
//! * Hue is undefined where saturation is small, and a plain difference of two hues is then noise. In the vector, hue counts
//!   as much as there is saturation.
//! * HSL saturation itself is undefined in black and white: there one step of noise in one channel is full saturation. The
//!   regularisation keeps it small.
//! * Grey objects on a grey floor have neither hue nor saturation. Lightness is therefore not discarded: it counts
//!   outside a band around the floor's. The band is wide towards dark, where shadows are, and narrow towards bright.
//!
//! # Cost
//!
//! One pass; a table of reciprocals replaces the division, all else is 16-bit integer arithmetic in blocks.

use crate::{Size, assert_len};

/// Pixels of one block.
const BLOCK: usize = 128;

/// Added to the denominator of the saturation, in steps of 8-bit channels.
const REGULARISATION: u32 = 64;

/// Fixed point of the products with a reciprocal: `(value * 32) * reciprocal / 65536`.
const SCALE: i16 = 32;

/// √3 in the same fixed point.
const SQRT_3: i16 = 55;

/// For each `max + min`: the reciprocal of the denominator, in the unit of [`SCALE`].
const RECIPROCALS: [i16; 511] = {
    let mut table = [0; 511];
    let mut sum = 0;
    while sum <= 510 {
        let distance = if sum < 510 - sum { sum } else { 510 - sum };
        table[sum as usize] = (65536 / SCALE as u32 * 127 / (distance + REGULARISATION)) as i16;
        sum += 1;
    }
    table
};

/// A colour picture as three planes.
#[derive(Debug, Clone, Copy)]
pub struct Colour<'a> {
    /// Red, 0 to 255.
    pub red: &'a [u8],
    /// Green, 0 to 255.
    pub green: &'a [u8],
    /// Blue, 0 to 255.
    pub blue: &'a [u8],
}

/// Hue and saturation as a vector, and lightness, of a picture: three planes to be written.
#[derive(Debug)]
pub struct HueSaturationLightnessMut<'a> {
    /// Component of the vector towards red.
    pub towards_red: &'a mut [i16],
    /// Component of the vector towards green and away from blue.
    pub towards_green: &'a mut [i16],
    /// Lightness, `(max + min) / 2`.
    pub lightness: &'a mut [u8],
}

/// Hue and saturation as a vector, and lightness, of a picture: three planes to be read.
#[derive(Debug, Clone, Copy)]
pub struct HueSaturationLightness<'a> {
    /// Component of the vector towards red.
    pub towards_red: &'a [i16],
    /// Component of the vector towards green and away from blue.
    pub towards_green: &'a [i16],
    /// Lightness, `(max + min) / 2`.
    pub lightness: &'a [u8],
}

/// How much of each kind of difference counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DifferenceSettings {
    /// A pixel this much darker than the floor, as a share of the floor's lightness, may still be a shadow: 0 to 1.
    pub shadow: f32,
    /// A pixel this much brighter than the floor, as a share of the floor's lightness, may still be floor: 0 to 1.
    pub glare: f32,
    /// Added to the band on both sides, in steps of lightness: what noise does.
    pub noise: u8,
}

/// Writes hue, saturation and lightness of a picture.
///
/// # Panics
///
/// When a slice has not `size.area()` values.
pub fn hue_saturation_lightness(
    picture: Colour<'_>,
    size: Size,
    out: HueSaturationLightnessMut<'_>,
) {
    picture.assert_size(size);
    assert_len("towards_red", out.towards_red.len(), size);
    assert_len("towards_green", out.towards_green.len(), size);
    assert_len("lightness", out.lightness.len(), size);
    for start in (0..size.area()).step_by(BLOCK) {
        let range = start..(start + BLOCK).min(size.area());
        hsl_block(
            picture.block(range.clone()),
            &mut out.towards_red[range.clone()],
            &mut out.towards_green[range.clone()],
            &mut out.lightness[range],
        );
    }
}

/// Writes to `out` how much each pixel of `picture` differs from `floor`: the sum of both components' differences and of the
/// lightness outside its band, at most 255.
///
/// # Panics
///
/// When a slice has not `size.area()` values.
pub fn difference(
    picture: Colour<'_>,
    floor: HueSaturationLightness<'_>,
    size: Size,
    out: &mut [u8],
    settings: &DifferenceSettings,
) {
    picture.assert_size(size);
    assert_len("floor", floor.towards_red.len(), size);
    assert_len("floor", floor.towards_green.len(), size);
    assert_len("floor", floor.lightness.len(), size);
    assert_len("out", out.len(), size);
    // Shares as multiples of 1/256, so that the band is 16-bit arithmetic too.
    let darkest = ((1.0 - settings.shadow).clamp(0.0, 1.0) * 256.0) as u16;
    let brightest = (settings.glare.clamp(0.0, 1.0) * 256.0) as u16;
    let noise = u16::from(settings.noise);
    let (mut red, mut green, mut light) = ([0i16; BLOCK], [0i16; BLOCK], [0u8; BLOCK]);
    for (block, out) in out.chunks_mut(BLOCK).enumerate() {
        let n = out.len();
        let range = block * BLOCK..block * BLOCK + n;
        let (red, green, light) = (&mut red[..n], &mut green[..n], &mut light[..n]);
        hsl_block(picture.block(range.clone()), red, green, light);
        let floor_red = &floor.towards_red[range.clone()];
        let floor_green = &floor.towards_green[range.clone()];
        let floor_light = &floor.lightness[range];
        for i in 0..n {
            let chroma = red[i].abs_diff(floor_red[i]) + green[i].abs_diff(floor_green[i]);
            let (light, floor) = (u16::from(light[i]), u16::from(floor_light[i]));
            let low = ((floor * darkest) >> 8).saturating_sub(noise);
            let high = floor + ((floor * brightest) >> 8) + noise;
            let outside = low.saturating_sub(light) + light.saturating_sub(high);
            out[i] = (chroma + outside).min(255) as u8;
        }
    }
}

impl<'a> Colour<'a> {
    fn assert_size(&self, size: Size) {
        assert_len("red", self.red.len(), size);
        assert_len("green", self.green.len(), size);
        assert_len("blue", self.blue.len(), size);
    }

    fn block(&self, range: core::ops::Range<usize>) -> Colour<'a> {
        Colour {
            red: &self.red[range.clone()],
            green: &self.green[range.clone()],
            blue: &self.blue[range],
        }
    }
}

/// Hue, saturation and lightness of at most [`BLOCK`] pixels.
fn hsl_block(
    picture: Colour<'_>,
    towards_red: &mut [i16],
    towards_green: &mut [i16],
    lightness: &mut [u8],
) {
    let n = lightness.len();
    let (red, green, blue) = (&picture.red[..n], &picture.green[..n], &picture.blue[..n]);
    let (towards_red, towards_green) = (&mut towards_red[..n], &mut towards_green[..n]);
    let mut sums = [0u16; BLOCK];
    for i in 0..n {
        let (r, g, b) = (i16::from(red[i]), i16::from(green[i]), i16::from(blue[i]));
        let sum = u16::from(red[i].max(green[i]).max(blue[i]))
            + u16::from(red[i].min(green[i]).min(blue[i]));
        sums[i] = sum;
        lightness[i] = (sum >> 1) as u8;
        towards_red[i] = (2 * r - g - b) * SCALE;
        towards_green[i] = (g - b) * SQRT_3;
    }
    // The look-up is the one step that no vector instruction does; alone in its loop it holds up nothing else.
    let mut reciprocals = [0i16; BLOCK];
    for i in 0..n {
        reciprocals[i] = RECIPROCALS[usize::from(sums[i].min(510))];
    }
    for i in 0..n {
        towards_red[i] = high_half(towards_red[i], reciprocals[i]);
        towards_green[i] = high_half(towards_green[i], reciprocals[i]);
    }
}

/// Upper half of a product of two 16-bit numbers: one instruction for eight pixels.
fn high_half(a: i16, b: i16) -> i16 {
    ((i32::from(a) * i32::from(b)) >> 16) as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    const SETTINGS: DifferenceSettings = DifferenceSettings {
        shadow: 0.5,
        glare: 0.1,
        noise: 6,
    };

    /// Difference between two pictures of one colour each.
    fn between(picture: [u8; 3], floor: [u8; 3]) -> u8 {
        let size = Size {
            width: 1,
            height: 1,
        };
        let (mut red, mut green, mut light) = ([0], [0], [0]);
        let planes = HueSaturationLightnessMut {
            towards_red: &mut red,
            towards_green: &mut green,
            lightness: &mut light,
        };
        let colour = |c: &'static [u8; 3]| Colour {
            red: &c[..1],
            green: &c[1..2],
            blue: &c[2..],
        };
        let floor = std::boxed::Box::leak(std::boxed::Box::new(floor));
        let picture = std::boxed::Box::leak(std::boxed::Box::new(picture));
        hue_saturation_lightness(colour(floor), size, planes);
        let floor = HueSaturationLightness {
            towards_red: &red,
            towards_green: &green,
            lightness: &light,
        };
        let mut out = [0];
        difference(colour(picture), floor, size, &mut out, &SETTINGS);
        out[0]
    }

    #[test]
    fn a_soft_shadow_is_floor() {
        assert!(between([84, 72, 60], [140, 120, 100]) <= 12);
    }

    #[test]
    fn other_hues_and_saturations_are_objects() {
        assert!(between([140, 90, 90], [120, 120, 120]) > 40, "red on grey");
        assert!(between([90, 90, 140], [140, 90, 90]) > 80, "blue on red");
        assert!(
            between([120, 120, 120], [150, 110, 70]) > 40,
            "grey on brown"
        );
    }

    #[test]
    fn grey_objects_are_seen_by_lightness() {
        assert!(
            between([210, 210, 210], [120, 120, 120]) > 60,
            "white on grey"
        );
        assert!(between([15, 15, 15], [120, 120, 120]) > 30, "black on grey");
        assert_eq!(between([120, 120, 120], [120, 120, 120]), 0);
    }

    #[test]
    fn noise_in_black_and_white_has_no_colour() {
        assert!(between([3, 0, 0], [0, 0, 0]) <= 14);
        assert!(between([255, 253, 252], [255, 255, 255]) <= 14);
    }

    proptest! {
        #[test]
        fn the_vector_is_the_formula(red: u8, green: u8, blue: u8) {
            let size = Size { width: 1, height: 1 };
            let (mut a, mut b, mut l) = (vec![0], vec![0], vec![0]);
            hue_saturation_lightness(
                Colour { red: &[red], green: &[green], blue: &[blue] },
                size,
                HueSaturationLightnessMut { towards_red: &mut a, towards_green: &mut b, lightness: &mut l },
            );
            let (r, g, bl) = (f64::from(red), f64::from(green), f64::from(blue));
            let (max, min) = (r.max(g).max(bl), r.min(g).min(bl));
            let scale = 127.0 / ((max + min).min(510.0 - max - min) + f64::from(REGULARISATION));
            // One step for rounding down, and √3 in fixed point is 0.8 % short.
            prop_assert!((f64::from(a[0]) - (2.0 * r - g - bl) * scale).abs() < 1.6);
            prop_assert!((f64::from(b[0]) - 3f64.sqrt() * (g - bl) * scale).abs() < 1.6 + 0.009 * 221.0 * scale.min(1.0));
            prop_assert_eq!(f64::from(l[0]), ((max + min) / 2.0).floor());
        }
    }
}
