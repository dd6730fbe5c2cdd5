//! Labels pixels by their differences: floor, shadow, object (section 2.1.1 of the paper).
//!
//! As in the paper, the sum of the differences in the 3x3 window decides, not the single pixel.
//! Differences keep their signs, so noise cancels and objects do not.
//!
//! | the window is | and | label |
//! | --- | --- | --- |
//! | of another colour | | [`COLOURED`] |
//! | brighter | of the floor's colour | [`BRIGHT`] |
//! | darker | of the floor's colour, by a factor that shade explains | [`SHADE`] |
//! | darker | of the floor's colour, by more than that | [`BLACK`] |
//!
//! The light in a shadow comes from other sources and differs in colour from the missing light. So
//! a difference in colour is ignored if it is in proportion to the darkening.
//!
//! A weak difference belongs to an object only near a strong one, so object labels have two
//! strengths.
//!
//! Cost: four passes, about forty operations per pixel.

use crate::difference::PARTS;
use crate::window::map_3x3;
use crate::{Size, assert_len};

/// The empty floor.
pub const FLOOR: u8 = 0;
/// Darker than the floor, but no darker than a shadow.
pub const SHADE: u8 = 1;
/// Brighter than the floor, of the same colour.
pub const BRIGHT: u8 = 2;
/// Darker than a shadow, of the floor's colour.
pub const BLACK: u8 = 3;
/// Of a different colour than the floor.
pub const COLOURED: u8 = 4;
/// Added to [`BRIGHT`], [`BLACK`] and [`COLOURED`] where the difference is strong.
pub const STRONG: u8 = 8;

/// Thresholds of the labels. Differences are means over the window, in units of the noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LabelSettings {
    /// Smaller differences are noise.
    pub weak: f32,
    /// An object has at least this difference somewhere.
    pub strong: f32,
    /// A shadow keeps at least this share of the light.
    pub shadow_min: f32,
    /// Maximum change of colour in a shadow, as a share of its change in lightness.
    pub shadow_tint: f32,
}

/// Differences of a frame from the floor; see [`DifferenceMut`](crate::difference::DifferenceMut).
#[derive(Debug, Clone, Copy)]
pub struct Difference<'a> {
    /// Brighter or darker.
    pub light: &'a [i16],
    /// Redder or greener.
    pub red: &'a [i16],
    /// Bluer or greener.
    pub blue: &'a [i16],
    /// Sum of the frame's channels.
    pub level: &'a [u16],
}

/// Scratch of [`label_pixels`]: three planes of arbitrary content.
#[derive(Debug)]
pub struct WindowsMut<'a> {
    /// Of lightness.
    pub light: &'a mut [i16],
    /// Of red.
    pub red: &'a mut [i16],
    /// Of blue.
    pub blue: &'a mut [i16],
}

/// Writes the label of each pixel, and to `own` the difference of the pixel itself, in halves of
/// the noise. Outside the picture the border is repeated. `floor_level` is that of the
/// [`Reference`](crate::difference::Reference).
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub fn label_pixels(
    difference: Difference<'_>,
    floor_level: &[u16],
    size: Size,
    out: &mut [u8],
    own: &mut [u8],
    windows: WindowsMut<'_>,
    settings: &LabelSettings,
) {
    let WindowsMut { light, red, blue } = windows;
    window_sum(difference.light, size, light);
    window_sum(difference.red, size, red);
    window_sum(difference.blue, size, blue);
    assert_len("level", difference.level.len(), size);
    assert_len("floor_level", floor_level.len(), size);
    assert_len("out", out.len(), size);
    assert_len("own", own.len(), size);
    // Thresholds for the sum over nine pixels.
    let in_sum = |noise: f32| (noise * 9.0 * f32::from(PARTS)).min(32767.0) as i16;
    let (weak, strong) = (in_sum(settings.weak), in_sum(settings.strong));
    // A pixel is only next to an object if its window is an object's but the pixel itself is floor.
    let weak_own = (settings.weak * f32::from(PARTS)).min(32767.0) as i16;
    let tint = (settings.shadow_tint.clamp(0.0, 1.0) * 256.0) as i32;
    let min = (settings.shadow_min.clamp(0.0, 1.0) * 65535.0) as u32;
    const BLOCK: usize = 128;
    for start in (0..size.area()).step_by(BLOCK) {
        let range = start..(start + BLOCK).min(size.area());
        let n = range.len();
        let (light, red, blue) = (
            &light[range.clone()],
            &red[range.clone()],
            &blue[range.clone()],
        );
        let own_light = &difference.light[range.clone()];
        let own_red = &difference.red[range.clone()];
        let own_blue = &difference.blue[range.clone()];
        let level = &difference.level[range.clone()];
        let floor_level = &floor_level[range.clone()];
        let (out, own) = (&mut out[range.clone()], &mut own[range]);
        for i in 0..n {
            let darker = (-light[i]).max(0);
            let tinted = ((i32::from(darker) * tint) >> 8) as i16;
            let colour = (chroma(red[i], blue[i]) - tinted).max(0);
            let dark = u32::from(level[i]) < (u32::from(floor_level[i]) * min) >> 16;
            let black = if dark { darker } else { 0 };
            let max = colour.max(light[i]).max(black);
            let differs = chroma(own_red[i], own_blue[i]).max(own_light[i].saturating_abs());
            own[i] = (differs / (PARTS / 2)).min(255) as u8;
            let label = if colour >= weak {
                COLOURED
            } else if light[i] >= weak {
                BRIGHT
            } else {
                BLACK
            };
            let strength = if max >= strong { STRONG } else { 0 };
            let object = if max >= weak && differs >= weak_own {
                label + strength
            } else {
                FLOOR
            };
            out[i] = if object == FLOOR && darker >= weak {
                SHADE
            } else {
                object
            };
        }
    }
}

/// Length of a chromaticity vector: the largest of its components red, green and blue.
#[inline(always)]
fn chroma(red: i16, blue: i16) -> i16 {
    let green = red.saturating_add(blue);
    red.saturating_abs()
        .max(blue.saturating_abs())
        .max(green.saturating_abs())
}

/// Sum over the 3x3 window. Differences are at most 3200, so nine of them fit.
fn window_sum(plane: &[i16], size: Size, out: &mut [i16]) {
    let sum = |a: i16, b: i16, c: i16| a + b + c;
    map_3x3(plane, size, out, sum, sum);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    const SIZE: Size = Size {
        width: 9,
        height: 9,
    };
    const SETTINGS: LabelSettings = LabelSettings {
        weak: 2.0,
        strong: 4.0,
        shadow_min: 0.4,
        shadow_tint: 0.1,
    };

    /// The labels in the middle of a 5x5 square that differs by (light, red, blue) from a floor of
    /// level 6000, and of the pixel next to the square.
    fn label_of([light, red, blue]: [i16; 3], level: u16) -> (u8, u8) {
        let square = |value: i16, outside: i16| {
            let mut plane = vec![outside; SIZE.area()];
            for y in 2..7 {
                plane[y * SIZE.width + 2..y * SIZE.width + 7].fill(value);
            }
            plane
        };
        let levels = square(level as i16, 6000);
        let (light, red, blue) = (square(light, 0), square(red, 0), square(blue, 0));
        let levels: std::vec::Vec<u16> = levels.into_iter().map(|l| l as u16).collect();
        let (mut out, mut own) = (vec![9; SIZE.area()], vec![9; SIZE.area()]);
        let scratch = || vec![99; SIZE.area()];
        label_pixels(
            Difference {
                light: &light,
                red: &red,
                blue: &blue,
                level: &levels,
            },
            &vec![6000; SIZE.area()],
            SIZE,
            &mut out,
            &mut own,
            WindowsMut {
                light: &mut scratch(),
                red: &mut scratch(),
                blue: &mut scratch(),
            },
            &SETTINGS,
        );
        (out[4 * SIZE.width + 4], out[4 * SIZE.width + 1])
    }

    #[test]
    fn the_table_of_labels() {
        let noise = PARTS;
        assert_eq!(label_of([0, 0, 0], 6000), (FLOOR, FLOOR));
        assert_eq!(label_of([3 * noise, 0, 0], 6600), (BRIGHT, FLOOR));
        assert_eq!(label_of([5 * noise, 0, 0], 6900), (BRIGHT + STRONG, FLOOR));
        assert_eq!(label_of([-30 * noise, 0, 0], 3600).0, SHADE);
        assert_eq!(label_of([-60 * noise, 0, 0], 900), (BLACK + STRONG, SHADE));
        assert_eq!(
            label_of([0, 5 * noise, 0], 6000),
            (COLOURED + STRONG, FLOOR)
        );
        assert_eq!(label_of([0, 0, -3 * noise], 6000), (COLOURED, FLOOR));
        // Green is minus the sum of red and blue.
        assert_eq!(
            label_of([0, 3 * noise, 3 * noise], 6000).0,
            COLOURED + STRONG
        );
    }

    #[test]
    fn a_shadow_may_be_tinted_by_its_depth() {
        assert_eq!(label_of([-30 * PARTS, 0, 3 * PARTS], 3600).0, SHADE);
        assert_eq!(
            label_of([-30 * PARTS, 0, 8 * PARTS], 3600).0,
            COLOURED + STRONG
        );
    }
}
