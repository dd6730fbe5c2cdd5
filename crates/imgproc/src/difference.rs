//! Difference between a frame and the empty floor, in units of noise (section 2.1.1 of the paper).
//!
//! A pixel of the floor in another light keeps its chromaticity: all its channels change by the same factor. So the three
//! channels are split into what light can do and what it cannot:
//!
//! ```text
//! lightness   L = (S - S₀) / 3                     S = R + G + B, S₀ the floor's
//! red         r = R - S R₀/S₀                      what is left when the floor's colour is taken in the light of the frame
//! blue        b = B - S B₀/S₀                      (green is minus the sum of both)
//! ```
//!
//! Red and blue are a vector of chromaticity, measured in grey levels of the frame. It needs no angle and no division, has no
//! singularity in grey, black or white, and a grey camera gives zeros.
//!
//! Each difference is divided by the noise that it has where nothing stands (a [`Reference`] is prepared with it):
//!
//! * what a pixel varies from frame to frame, learned with the floor;
//! * what the light varies, a share of the floor's brightness;
//! * what a displacement by a part of a pixel does at the floor's own edges: cameras shake, and things are nudged;
//! * what compression and rounding do.
//!
//! # Differences from the paper
//!
//! * Hue counts by the saturation there is: in the vector, the hue of a grey floor weighs nothing. The paper's plain
//!   difference of hues is noise there.
//! * Lightness is not discarded but kept apart, since it is all that tells grey from grey; [`labels`](crate::labels)
//!   decides what of it is shadow.
//! * One unit for all floors and cameras replaces a threshold in steps of hue.
//!
//! # Cost
//!
//! One pass of 16-bit integer arithmetic in blocks, about forty operations a pixel.

use crate::{Size, assert_len};

/// Pixels of one block.
const BLOCK: usize = 128;

/// Differences are in this many parts of the noise.
pub const PARTS: i16 = 8;

/// Greatest difference that is told apart: nine of them fit into 16 bits.
const DIFFERENCE_MAX: i16 = 400 * PARTS;

/// Brightness is counted in sixteenths of a level, so that 16 bits hold the sum of three channels.
const FINE: u32 = 16;

/// The brightest channel that is told apart: twice white, for frames that are darker than the floor's picture.
const CHANNEL_MAX: u16 = 2 * 255 * FINE as u16;

/// A channel from here on may be any brighter: it is cut off by the camera.
const SATURATED: u8 = 250;

/// Most noise, in levels, that may be a sensor's; what varies more varies with what is around it.
const SENSOR_MAX: f32 = 3.0;

/// A colour picture as three planes.
#[derive(Debug, Clone, Copy)]
pub struct Colour<'a, T = u8> {
    /// Red, 0 to 255.
    pub red: &'a [T],
    /// Green, 0 to 255.
    pub green: &'a [T],
    /// Blue, 0 to 255.
    pub blue: &'a [T],
}

/// What a pixel of the floor varies without anything standing on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseSettings {
    /// Of any pixel, in levels: rounding and compression.
    pub min: f32,
    /// Of the light, as a share of the floor's brightness.
    pub light: f32,
    /// Of the light's colour, as a share of the floor's brightness.
    pub colour: f32,
    /// Of the camera's place, in pixels.
    pub displacement_px: f32,
}

/// The floor as frames are compared with it: planes to be written.
#[derive(Debug)]
pub struct ReferenceMut<'a> {
    /// Sum of the channels, in sixteenths of a level.
    pub level: &'a mut [u16],
    /// Red's share of the sum, in 65536ths.
    pub red_share: &'a mut [u16],
    /// Blue's share of the sum, in 65536ths.
    pub blue_share: &'a mut [u16],
    /// Factor from lightness to its noise.
    pub light_scale: &'a mut [i16],
    /// Factor from chromaticity to its noise.
    pub colour_scale: &'a mut [i16],
}

/// The floor as frames are compared with it.
#[derive(Debug, Clone, Copy)]
pub struct Reference<'a> {
    /// See [`ReferenceMut`].
    pub level: &'a [u16],
    /// See [`ReferenceMut`].
    pub red_share: &'a [u16],
    /// See [`ReferenceMut`].
    pub blue_share: &'a [u16],
    /// See [`ReferenceMut`].
    pub light_scale: &'a [i16],
    /// See [`ReferenceMut`].
    pub colour_scale: &'a [i16],
}

/// What a frame differs by: planes to be written.
#[derive(Debug)]
pub struct DifferenceMut<'a> {
    /// Brighter (positive) or darker than the floor, in [`PARTS`] of the noise.
    pub light: &'a mut [i16],
    /// Redder than the floor in the same light, in [`PARTS`] of the noise.
    pub red: &'a mut [i16],
    /// Bluer than the floor in the same light, in [`PARTS`] of the noise.
    pub blue: &'a mut [i16],
    /// Sum of the frame's channels in the floor's light, in sixteenths of a level.
    pub level: &'a mut [u16],
}

/// How many times as bright as in the floor's picture the light is now, in each channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    /// Of red.
    pub red: f32,
    /// Of green.
    pub green: f32,
    /// Of blue.
    pub blue: f32,
}

impl Gains {
    /// The light of the floor's picture.
    pub const NONE: Self = Self {
        red: 1.0,
        green: 1.0,
        blue: 1.0,
    };
}

/// Prepares rows of the floor for comparison. `floor` is in 256ths of a level, `noise` the standard deviation of each pixel in
/// eighths of a level.
///
/// # Panics
///
/// When a slice has not `size.area()` values, or the rows are not all in the picture.
pub fn prepare(
    floor: Colour<'_, u16>,
    noise: &[u8],
    size: Size,
    rows: core::ops::Range<usize>,
    out: &mut ReferenceMut<'_>,
    settings: &NoiseSettings,
) {
    floor.assert_size(size);
    assert_len("noise", noise.len(), size);
    assert_len("level", out.level.len(), size);
    assert_len("red_share", out.red_share.len(), size);
    assert_len("blue_share", out.blue_share.len(), size);
    assert_len("light_scale", out.light_scale.len(), size);
    assert_len("colour_scale", out.colour_scale.len(), size);
    let Size { width, height } = size;
    let sum = |x: usize, y: usize| {
        let i = y * width + x;
        u32::from(floor.red[i]) + u32::from(floor.green[i]) + u32::from(floor.blue[i])
    };
    for y in rows {
        for x in 0..width {
            let i = y * width + x;
            let here = sum(x, y);
            let around = [
                sum(x.saturating_sub(1), y),
                sum((x + 1).min(width - 1), y),
                sum(x, y.saturating_sub(1)),
                sum(x, (y + 1).min(height - 1)),
            ];
            let (low, high) = around
                .iter()
                .fold((here, here), |(low, high), &s| (low.min(s), high.max(s)));
            // Levels of the mean channel; 768 = 3 channels in 256ths.
            let mean = here as f32 / 768.0;
            let slope = (high - low) as f32 / (2.0 * 768.0) * settings.displacement_px;
            let varies = f32::from(noise[i]) / 8.0;
            let square = |x: f32| x * x;
            // A sensor's noise is that of a pixel and a channel alone, and halves in the mean of a window and three channels;
            // that of colour, the difference of two channels, becomes less by a quarter at least.
            let light = square(varies - varies.min(SENSOR_MAX) / 2.0)
                + square(settings.min)
                + square(settings.light * mean)
                + square(slope);
            let colour = square(varies - varies.min(SENSOR_MAX) / 4.0)
                + square(settings.min)
                + square(settings.colour * mean)
                + square(slope / 2.0);
            // At most as much as white can hold, rounded down: shares of the sum stay below 1.
            let share = |channel: u16| (u64::from(channel) * 65535 / u64::from(here.max(1))) as u16;
            out.level[i] = (here * FINE / 256) as u16;
            out.red_share[i] = share(floor.red[i]);
            out.blue_share[i] = share(floor.blue[i]);
            // From sixteenths of a sum of three channels, and of one channel, to PARTS of the noise, in 65536ths.
            let per = f32::from(PARTS) * 65536.0 / FINE as f32;
            out.light_scale[i] = (per / 3.0 / root(light)).min(32767.0) as i16;
            out.colour_scale[i] = (per / root(colour)).min(32767.0) as i16;
        }
    }
}

/// Square root to three digits, which is all that a scale needs; `core` has none.
fn root(square: f32) -> f32 {
    (((square * 65536.0) as u64).isqrt() as f32 / 256.0).max(1.0 / 256.0)
}

/// Writes by how much each pixel differs from the floor.
///
/// A channel that the camera cut off at white counts as bright as the floor, if that is brighter.
///
/// # Panics
///
/// When a slice has not `size.area()` values.
pub fn difference(
    picture: Colour<'_>,
    gains: Gains,
    reference: Reference<'_>,
    size: Size,
    out: DifferenceMut<'_>,
) {
    picture.assert_size(size);
    assert_len("level", reference.level.len(), size);
    assert_len("red_share", reference.red_share.len(), size);
    assert_len("blue_share", reference.blue_share.len(), size);
    assert_len("light_scale", reference.light_scale.len(), size);
    assert_len("colour_scale", reference.colour_scale.len(), size);
    assert_len("light", out.light.len(), size);
    assert_len("red", out.red.len(), size);
    assert_len("blue", out.blue.len(), size);
    assert_len("level", out.level.len(), size);
    // Times 256 and 16 (sixteenths), divided by 65536 again after the product: a factor of 1 is 4096.
    let inverse = |gain: f32| (4096.0 / gain.max(1.0 / 15.0)) as u16;
    let (to_red, to_green, to_blue) = (
        inverse(gains.red),
        inverse(gains.green),
        inverse(gains.blue),
    );
    for start in (0..size.area()).step_by(BLOCK) {
        let range = start..(start + BLOCK).min(size.area());
        let n = range.len();
        let (red, green, blue) = (
            &picture.red[range.clone()],
            &picture.green[range.clone()],
            &picture.blue[range.clone()],
        );
        let level = &reference.level[range.clone()];
        let red_share = &reference.red_share[range.clone()];
        let blue_share = &reference.blue_share[range.clone()];
        let light_scale = &reference.light_scale[range.clone()];
        let colour_scale = &reference.colour_scale[range.clone()];
        let out_light = &mut out.light[range.clone()];
        let out_red = &mut out.red[range.clone()];
        let out_blue = &mut out.blue[range.clone()];
        let out_level = &mut out.level[range];
        for i in 0..n {
            let floor_red = high_half(level[i], red_share[i]);
            let floor_blue = high_half(level[i], blue_share[i]);
            let floor_green = level[i] - floor_red - floor_blue;
            let r = in_floor_light(red[i], to_red, floor_red);
            let g = in_floor_light(green[i], to_green, floor_green);
            let b = in_floor_light(blue[i], to_blue, floor_blue);
            let sum = r + g + b;
            out_level[i] = sum;
            let light = sum as i16 - level[i] as i16;
            let red = r as i16 - high_half(sum, red_share[i]) as i16;
            let blue = b as i16 - high_half(sum, blue_share[i]) as i16;
            out_light[i] = scaled(light, light_scale[i]);
            out_red[i] = scaled(red, colour_scale[i]);
            out_blue[i] = scaled(blue, colour_scale[i]);
        }
    }
}

/// A channel of the frame in the light of the floor's picture, sixteenths of a level.
#[inline(always)]
fn in_floor_light(channel: u8, factor: u16, floor: u16) -> u16 {
    let value = high_half(u16::from(channel) << 8, factor).min(CHANNEL_MAX);
    let cut_off = if channel >= SATURATED { floor } else { 0 };
    value.max(cut_off)
}

/// Upper half of a product of two 16-bit numbers: one instruction for eight pixels.
#[inline(always)]
fn high_half(a: u16, b: u16) -> u16 {
    ((u32::from(a) * u32::from(b)) >> 16) as u16
}

/// A difference in parts of the noise.
#[inline(always)]
fn scaled(difference: i16, scale: i16) -> i16 {
    let parts = ((i32::from(difference) * i32::from(scale)) >> 16) as i16;
    parts.clamp(-DIFFERENCE_MAX, DIFFERENCE_MAX)
}

impl<T> Colour<'_, T> {
    pub(crate) fn assert_size(&self, size: Size) {
        assert_len("red", self.red.len(), size);
        assert_len("green", self.green.len(), size);
        assert_len("blue", self.blue.len(), size);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ONE: Size = Size {
        width: 1,
        height: 1,
    };
    const NOISE: NoiseSettings = NoiseSettings {
        min: 2.0,
        light: 0.0,
        colour: 0.0,
        displacement_px: 0.0,
    };

    /// Light, red and blue between two pictures of one colour each, in PARTS of a noise of two levels.
    fn between(picture: [u8; 3], floor: [u8; 3], gains: Gains) -> [i16; 3] {
        let floor = floor.map(|level| [u16::from(level) << 8]);
        let (mut level, mut red_share, mut blue_share) = ([0], [0], [0]);
        let (mut light_scale, mut colour_scale) = ([0], [0]);
        prepare(
            Colour {
                red: &floor[0],
                green: &floor[1],
                blue: &floor[2],
            },
            &[0],
            ONE,
            0..1,
            &mut ReferenceMut {
                level: &mut level,
                red_share: &mut red_share,
                blue_share: &mut blue_share,
                light_scale: &mut light_scale,
                colour_scale: &mut colour_scale,
            },
            &NOISE,
        );
        let picture = picture.map(|level| [level]);
        let (mut light, mut red, mut blue, mut sum) = ([0], [0], [0], [0]);
        difference(
            Colour {
                red: &picture[0],
                green: &picture[1],
                blue: &picture[2],
            },
            gains,
            Reference {
                level: &level,
                red_share: &red_share,
                blue_share: &blue_share,
                light_scale: &light_scale,
                colour_scale: &colour_scale,
            },
            ONE,
            DifferenceMut {
                light: &mut light,
                red: &mut red,
                blue: &mut blue,
                level: &mut sum,
            },
        );
        [light[0], red[0], blue[0]]
    }

    #[test]
    fn a_shadow_changes_lightness_and_no_colour() {
        let [light, red, blue] = between([60, 80, 40], [120, 160, 80], Gains::NONE);
        // 60 levels of lightness are 30 times the noise.
        assert!((light + 30 * PARTS).abs() <= 1, "{light}");
        assert!(red.abs() <= 1 && blue.abs() <= 1, "{red} {blue}");
    }

    #[test]
    fn grey_on_grey_is_a_difference_of_lightness() {
        let [light, red, blue] = between([132; 3], [120; 3], Gains::NONE);
        assert!((light - 6 * PARTS).abs() <= 1, "{light}");
        assert!(red.abs() <= 1 && blue.abs() <= 1, "{red} {blue}");
    }

    #[test]
    fn another_light_is_divided_out() {
        let gains = Gains {
            red: 0.5,
            green: 0.75,
            blue: 1.25,
        };
        for difference in between([60, 120, 100], [120, 160, 80], gains) {
            assert!(difference.abs() <= 2, "{difference}");
        }
    }

    #[test]
    fn what_the_camera_cut_off_is_not_darker_than_the_floor() {
        let gains = Gains {
            red: 1.5,
            green: 1.5,
            blue: 1.5,
        };
        let [light, ..] = between([255; 3], [220; 3], gains);
        assert!(light.abs() <= 1, "{light}");
    }

    proptest! {
        #[test]
        fn differences_are_the_formula(picture: [u8; 3], floor in any::<[u8; 3]>()) {
            prop_assume!(picture.iter().all(|&level| level < SATURATED));
            let [r, g, b] = picture.map(f64::from);
            let [r0, g0, b0] = floor.map(f64::from);
            let (sum, floor_sum) = (r + g + b, r0 + g0 + b0);
            prop_assume!(floor_sum >= 30.0);
            let unit = f64::from(PARTS) / 2.0;
            let expected = [
                (sum - floor_sum) / 3.0 * unit,
                (r - sum * r0 / floor_sum) * unit,
                (b - sum * b0 / floor_sum) * unit,
            ];
            let found = between(picture, floor, Gains::NONE);
            for (found, expected) in found.into_iter().zip(expected) {
                // Sixteenths of a level and 65536ths are rounded down, four times.
                prop_assert!((f64::from(found) - expected).abs() < 2.5, "{found} {expected}");
            }
        }
    }
}
