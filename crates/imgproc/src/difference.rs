//! Difference between a frame and the empty floor, in units of noise (section 2.1.1 of the paper).
//!
//! If the light changes, a floor pixel keeps its chromaticity: all channels change by the same
//! factor. So the three channels are split into a part that light can change and a part that it
//! cannot:
//!
//! ```text
//! lightness   L = (S - S₀) / 3         S = R + G + B, S₀ the floor's
//! red         r = R - S R₀/S₀          deviation from the floor's colour in the frame's light
//! blue        b = B - S B₀/S₀          (green is minus the sum of both)
//! ```
//!
//! Red and blue form a chromaticity vector, in grey levels of the frame. It needs no angle and no
//! division, and has no singularity at grey, black or white. A grey camera gives zeros.
//!
//! Each difference is divided by its noise on the empty floor, which [`prepare`] puts into the
//! [`Reference`]:
//!
//! * variation of the pixel from frame to frame, learned with the floor;
//! * variation of the light, as a share of the floor's brightness;
//! * displacement by a fraction of a pixel at the floor's own edges, since cameras shake and get
//!   nudged;
//! * compression and rounding.
//!
//! # Differences from the paper
//!
//! * Hue is weighted by saturation: in the vector, the hue of a grey floor has no weight. The
//!   paper's plain difference of hues is noise there.
//! * Lightness is not discarded but kept separate, since only it distinguishes grey from grey.
//!   [`labels`](crate::labels) decides which part of it is shadow.
//! * Thresholds are in one unit for all floors and cameras instead of steps of hue.
//!
//! # Cost
//!
//! One pass of 16-bit integer arithmetic in blocks, about forty operations per pixel.

use crate::{Size, assert_len};

/// Pixels per block.
const BLOCK: usize = 128;

/// Differences are in units of the noise divided by this.
pub const PARTS: i16 = 8;

/// Maximum difference; larger ones saturate. Nine of them fit into 16 bits.
const DIFFERENCE_MAX: i16 = 400 * PARTS;

/// Brightness is in sixteenths of a grey level, so that the sum of three channels fits into 16
/// bits.
const FINE: u32 = 16;

/// Maximum of a channel: twice white, for frames that are darker than the floor's picture.
const CHANNEL_MAX: u16 = 2 * 255 * FINE as u16;

/// A channel with at least this value counts as clipped by the camera: the scene may be any
/// brighter.
const SATURATED: u8 = 250;

/// Maximum noise of a sensor, in grey levels. Pixels that vary more vary together with their
/// neighbours.
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

/// How much a pixel of the empty floor varies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseSettings {
    /// Of any pixel, in grey levels: rounding and compression.
    pub min: f32,
    /// Of the light, as a share of the floor's brightness.
    pub light: f32,
    /// Of the light's colour, as a share of the floor's brightness.
    pub colour: f32,
    /// Of the camera's position, in pixels.
    pub displacement_px: f32,
}

/// The floor, prepared for comparison with frames: planes to be written.
#[derive(Debug)]
pub struct ReferenceMut<'a> {
    /// Sum of the channels, in sixteenths of a grey level.
    pub level: &'a mut [u16],
    /// Red's share of the sum, in 65536ths.
    pub red_share: &'a mut [u16],
    /// Blue's share of the sum, in 65536ths.
    pub blue_share: &'a mut [u16],
    /// Factor from lightness to units of its noise.
    pub light_scale: &'a mut [i16],
    /// Factor from chromaticity to units of its noise.
    pub colour_scale: &'a mut [i16],
}

/// The floor, prepared for comparison with frames.
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

/// Difference of a frame from the floor: planes to be written.
#[derive(Debug)]
pub struct DifferenceMut<'a> {
    /// Brighter (positive) or darker than the floor, in noise / [`PARTS`].
    pub light: &'a mut [i16],
    /// Redder than the floor in the same light, in noise / [`PARTS`].
    pub red: &'a mut [i16],
    /// Bluer than the floor in the same light, in noise / [`PARTS`].
    pub blue: &'a mut [i16],
    /// Sum of the frame's channels, converted to the floor's light, in sixteenths of a grey level.
    pub level: &'a mut [u16],
}

/// Brightness of the light now as a multiple of that in the floor's picture, per channel.
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
    /// The light did not change.
    pub const NONE: Self = Self {
        red: 1.0,
        green: 1.0,
        blue: 1.0,
    };
}

/// Prepares rows of the floor for comparison. `floor` is in 256ths of a grey level, `noise` is the
/// standard deviation of each pixel in eighths of a grey level.
///
/// # Panics
///
/// If a slice does not have `size.area()` values, or the rows are not all in the picture.
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
            // Grey levels of the mean channel; 768 = 3 channels in 256ths.
            let mean = here as f32 / 768.0;
            let slope = (high - low) as f32 / (2.0 * 768.0) * settings.displacement_px;
            let varies = f32::from(noise[i]) / 8.0;
            let square = |x: f32| x * x;
            // Sensor noise is independent between pixels and channels. It halves in the mean over a
            // window and three channels; in chromaticity, the difference of two channels, it drops
            // by at least a quarter.
            let light = square(varies - varies.min(SENSOR_MAX) / 2.0)
                + square(settings.min)
                + square(settings.light * mean)
                + square(slope);
            let colour = square(varies - varies.min(SENSOR_MAX) / 4.0)
                + square(settings.min)
                + square(settings.colour * mean)
                + square(slope / 2.0);
            // At most white, rounded down, so that the shares stay below 1.
            let share = |channel: u16| (u64::from(channel) * 65535 / u64::from(here.max(1))) as u16;
            out.level[i] = (here * FINE / 256) as u16;
            out.red_share[i] = share(floor.red[i]);
            out.blue_share[i] = share(floor.blue[i]);
            // From sixteenths (a sum of three channels, or one channel) to noise / PARTS, in
            // 65536ths.
            let per = f32::from(PARTS) * 65536.0 / FINE as f32;
            out.light_scale[i] = (per / 3.0 / root(light)).min(32767.0) as i16;
            out.colour_scale[i] = (per / root(colour)).min(32767.0) as i16;
        }
    }
}

/// Square root to three digits, enough for a scale; `core` has none.
fn root(square: f32) -> f32 {
    (((square * 65536.0) as u64).isqrt() as f32 / 256.0).max(1.0 / 256.0)
}

/// Writes the difference of each pixel from the floor.
///
/// A channel that the camera clipped at white counts as bright as the floor if the floor is
/// brighter.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
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
    // 256 * 16 (sixteenths) / 65536 after the product: a factor of 1 is 4096.
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

/// A channel of the frame converted to the light of the floor's picture, in sixteenths of a grey
/// level.
#[inline(always)]
fn in_floor_light(channel: u8, factor: u16, floor: u16) -> u16 {
    let value = high_half(u16::from(channel) << 8, factor).min(CHANNEL_MAX);
    let cut_off = if channel >= SATURATED { floor } else { 0 };
    value.max(cut_off)
}

/// Upper half of the product of two 16-bit numbers: one instruction for eight pixels.
#[inline(always)]
fn high_half(a: u16, b: u16) -> u16 {
    ((u32::from(a) * u32::from(b)) >> 16) as u16
}

/// A difference in noise / PARTS.
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

    /// Light, red and blue between two single-colour pictures, in noise / PARTS, with a noise of
    /// two grey levels.
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
        // 60 grey levels of lightness are 30 times the noise.
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
    fn clipped_pixels_are_not_darker_than_the_floor() {
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
                // Sixteenths of a grey level and 65536ths are rounded down, four times.
                prop_assert!((f64::from(found) - expected).abs() < 2.5, "{found} {expected}");
            }
        }
    }
}
