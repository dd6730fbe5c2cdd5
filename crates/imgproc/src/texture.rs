//! Light and shadow let the floor's texture show through; objects hide it.
//!
//! A shadow, a patch of sun and a lamp multiply the floor by a factor that hardly changes from
//! pixel to pixel. So the fine texture of the frame should be that of the floor times the ratio of
//! brightness. An object has its own texture or none. [`visibility`] is the share of the floor's
//! texture found in the frame: about 1 for light and shadow, about 0 for an object. It needs a
//! floor with a texture above the noise, and it reports its confidence.
//!
//! # Method
//!
//! Texture is a pixel minus the mean of the four pixels at a distance of two, which removes
//! gradients of light. Over a 21x21 window, with `t` the frame's texture, `t₀` the floor's and `s`
//! the ratio of the windows' brightness, the visibility is `Σ t t₀ / (s Σ t₀²)`: the least-squares
//! factor of the floor's texture, divided by the factor expected from the light.
//!
//! Edges would outweigh all texture, and a black robot is next to its black shadow. So a pixel
//! counts only if its ratio of brightness to the floor is within a fifth of that of the pixel in
//! question (as in a bilateral filter), and none of its four neighbours lies across an edge. The
//! ratios compared are means of 3x3 pixels, since single ones would favour pixels that match the
//! floor's texture by chance.
//!
//! Cost: about fifty operations for each pixel prepared, and a thousand for each place queried.

use crate::{Size, assert_len};

/// Half-size of the window.
const REACH: usize = 10;

/// Distance of the pixels whose mean is subtracted.
const STEP: usize = 2;

/// Minimum number of pixels for a result.
const PIXELS_MIN: u32 = 12;

/// Ratios are in this many parts.
const RATIO_ONE: u32 = 1024;

/// Standard deviation of the quantisation of levels: sum of the channels in sixteenths of a grey
/// level.
const STEPS: f32 = 8.0;

/// Minimum standard deviation of noise assumed for the expected visibility, two grey levels:
/// compression removes fainter texture.
const NOISE_MIN: f32 = 96.0;

/// Visibility of the floor's texture at one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visibility {
    /// Share of the floor's texture that shows through, about 0 to 1.
    pub share: f32,
    /// The share in units of its standard deviation. From 4 on it is hardly a coincidence.
    pub seen: f32,
    /// The value of `seen` if all of the texture showed through. Less than 4 is not conclusive.
    pub visible: f32,
}

/// Planes that [`visibility`] compares, to be written.
#[derive(Debug)]
pub struct TexturesMut<'a> {
    /// Ratio of brightness to the floor, in 1024ths; 0 where a pixel does not count.
    pub ratio: &'a mut [u16],
    /// Texture of the frame; only where `ratio` is not 0.
    pub frame: &'a mut [i16],
    /// Texture of the floor; only where `ratio` is not 0.
    pub floor: &'a mut [i16],
}

/// Planes that [`visibility`] compares.
#[derive(Debug, Clone, Copy)]
pub struct Textures<'a> {
    /// See [`TexturesMut`].
    pub ratio: &'a [u16],
    /// See [`TexturesMut`].
    pub frame: &'a [i16],
    /// See [`TexturesMut`].
    pub floor: &'a [i16],
}

/// Writes the textures of all pixels whose index `counts`, except those within 2 pixels of the
/// border. `level` and `floor_level` are sums of channels in sixteenths of a grey level, as in
/// [`Reference`](crate::difference::Reference).
///
/// # Panics
///
/// If a plane does not have `size.area()` values.
pub fn textures(
    level: &[u16],
    floor_level: &[u16],
    size: Size,
    out: &mut TexturesMut<'_>,
    counts: impl Fn(usize) -> bool,
) {
    assert_len("level", level.len(), size);
    assert_len("floor_level", floor_level.len(), size);
    assert_len("ratio", out.ratio.len(), size);
    assert_len("frame", out.frame.len(), size);
    assert_len("floor", out.floor.len(), size);
    let Size { width, height } = size;
    out.ratio.fill(0);
    if width <= 2 * STEP || height <= 2 * STEP {
        return;
    }
    let sum_3x3 = |plane: &[u16], i: usize| {
        let row =
            |i: usize| u32::from(plane[i - 1]) + u32::from(plane[i]) + u32::from(plane[i + 1]);
        row(i - width) + row(i) + row(i + width)
    };
    let texture = |plane: &[u16], i: usize| {
        let around = arms(i, width)
            .map(|i| i32::from(plane[i]))
            .iter()
            .sum::<i32>();
        // Levels are at most 24480, so this fits.
        (i32::from(plane[i]) - around / 4) as i16
    };
    for y in STEP..height - STEP {
        let row = y * width;
        for i in (row + STEP..row + width - STEP).filter(|&i| counts(i)) {
            let (seen, floor) = (sum_3x3(level, i), sum_3x3(floor_level, i));
            let ratio = u64::from(seen) * u64::from(RATIO_ONE) / u64::from(floor.max(1));
            out.ratio[i] = ratio.clamp(1, 0xffff) as u16;
            out.frame[i] = texture(level, i);
            out.floor[i] = texture(floor_level, i);
        }
    }
    // The texture of a pixel next to an edge contains the edge. Its ratio is kept for pixels on the
    // same side.
    for y in STEP..height - STEP {
        let row = y * width;
        for i in row + STEP..row + width - STEP {
            let here = u32::from(out.ratio[i]);
            if here > 0
                && arms(i, width)
                    .into_iter()
                    .any(|arm| !alike(here, u32::from(out.ratio[arm]), 3))
            {
                out.floor[i] = 0;
                out.frame[i] = 0;
            }
        }
    }
}

/// How much of the floor's texture shows through around a pixel. `None` if the pixel does not
/// count, or too few similar pixels are around it.
///
/// # Panics
///
/// If a plane does not have `size.area()` values, or the pixel is not in the picture.
#[must_use]
pub fn visibility(
    textures: Textures<'_>,
    size: Size,
    (x, y): (usize, usize),
) -> Option<Visibility> {
    assert_len("ratio", textures.ratio.len(), size);
    assert_len("frame", textures.frame.len(), size);
    assert_len("floor", textures.floor.len(), size);
    let Size { width, height } = size;
    let here = u32::from(textures.ratio[y * width + x]);
    if here == 0 {
        return None;
    }
    let columns = x.saturating_sub(REACH)..(x + REACH + 1).min(width);
    let (low, high) = ((here * 4 / 5).max(1), here * 6 / 5);
    let (mut pixels, mut ratios) = (0u32, 0u32);
    let (mut common, mut power, mut floor_power) = (0i64, 0i64, 0i64);
    for y in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
        let row = y * width + columns.start..y * width + columns.end;
        let (ratio, frame, floor) = (
            &textures.ratio[row.clone()],
            &textures.frame[row.clone()],
            &textures.floor[row],
        );
        for ((&ratio, &frame), &floor) in ratio.iter().zip(frame).zip(floor) {
            let (ratio, frame, floor) = (u32::from(ratio), i64::from(frame), i64::from(floor));
            let like = (low..=high).contains(&ratio) && (frame, floor) != (0, 0);
            if like {
                pixels += 1;
                ratios += ratio;
                common += frame * floor;
                power += frame * frame;
                floor_power += floor * floor;
            }
        }
    }
    if pixels < PIXELS_MIN || floor_power == 0 {
        return None;
    }
    let n = pixels as f32;
    let ratio = ratios as f32 / n / RATIO_ONE as f32;
    let (common, power, floor_power) = (common as f32, power as f32, floor_power as f32);
    // The part that the floor's texture does not explain is noise.
    let unexplained = ((power - common * common / floor_power) / n).max(NOISE_MIN * NOISE_MIN);
    Some(Visibility {
        share: common / (ratio * floor_power),
        seen: common / (root(floor_power) * root(power.max(n * STEPS * STEPS))) * root(n),
        visible: ratio * root(floor_power / unexplained),
    })
}

/// The four pixels whose mean is subtracted.
fn arms(i: usize, width: usize) -> [usize; 4] {
    [i - STEP, i + STEP, i - STEP * width, i + STEP * width]
}

/// Whether two ratios differ by less than some tenths of the first.
fn alike(a: u32, b: u32, tenths: u32) -> bool {
    10 * a.abs_diff(b) <= tenths * a
}

/// Square root, which `core` does not have, to three digits from 1 to 2⁴⁸.
fn root(square: f32) -> f32 {
    ((f64::from(square) * 65536.0) as u64).isqrt() as f32 / 256.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use random::SplitMix64;
    use std::vec;
    use std::vec::Vec;

    const SIZE: Size = Size {
        width: 48,
        height: 36,
    };

    /// Numbers below 512.
    fn random(seed: u64) -> impl Iterator<Item = u16> {
        let mut random = SplitMix64(seed << 32);
        std::iter::repeat_with(move || (random.bits() >> 55) as u16)
    }

    fn carpet(seed: u64) -> Vec<u16> {
        random(seed)
            .map(|more| 5000 + 2 * more)
            .take(SIZE.area())
            .collect()
    }

    fn seen(level: &[u16], floor: &[u16], at: (usize, usize)) -> Option<Visibility> {
        let mut ratio = vec![7; SIZE.area()];
        let (mut frame, mut of_floor) = (vec![9; SIZE.area()], vec![9; SIZE.area()]);
        let mut out = TexturesMut {
            ratio: &mut ratio,
            frame: &mut frame,
            floor: &mut of_floor,
        };
        textures(level, floor, SIZE, &mut out, |_| true);
        let textures = Textures {
            ratio: &ratio,
            frame: &frame,
            floor: &of_floor,
        };
        visibility(textures, SIZE, at)
    }

    #[test]
    fn a_shadow_shows_the_floor_and_an_object_does_not() {
        let floor = carpet(1);
        let shadow: Vec<u16> = floor.iter().map(|&l| l * 2 / 10).collect();
        let shown = seen(&shadow, &floor, (20, 16)).expect("the carpet has a texture");
        assert!((shown.share - 1.0).abs() < 0.05, "{shown:?}");
        assert!(shown.seen > 10.0 && shown.visible > 10.0, "{shown:?}");
        let noisy = |level: u16| random(7).map(move |n| level + n / 8).take(SIZE.area());
        for hidden in [noisy(4000).collect(), carpet(2)] {
            let hidden: Vec<u16> = hidden;
            let hidden = seen(&hidden, &floor, (20, 16)).expect("the carpet has a texture");
            assert!(
                hidden.share.abs() < 0.2 && hidden.seen.abs() < 3.0,
                "{hidden:?}"
            );
            assert!(hidden.visible > 5.0, "{hidden:?}");
        }
    }

    #[test]
    fn a_black_thing_beside_a_shadow_does_not_disturb_it() {
        let floor = carpet(1);
        let level = |(i, &l): (usize, &u16)| match i % SIZE.width {
            0..16 => l,
            16..26 => l * 3 / 10,
            26..36 => 700,
            _ => l,
        };
        let level: Vec<u16> = floor.iter().enumerate().map(level).collect();
        for x in 16..36 {
            let share = seen(&level, &floor, (x, 16)).map(|seen| seen.share);
            match x {
                18..24 => assert!(share.is_some_and(|share| share > 0.9), "{share:?} at {x}"),
                28..34 => assert!(share.is_none_or(|share| share < 0.1), "{share:?} at {x}"),
                // The mean of 3x3 pixels lies between both sides.
                _ => {}
            }
        }
    }

    #[test]
    fn a_plain_floor_has_no_visibility() {
        let plain = vec![5000; SIZE.area()];
        assert!(seen(&carpet(1), &plain, (20, 14)).is_none());
    }

    #[test]
    fn pictures_of_any_size_are_processed() {
        for (width, height) in [(0, 0), (1, 1), (4, 9), (5, 5), (9, 4)] {
            let size = Size { width, height };
            let level = vec![5000u16; size.area()];
            let mut ratio = vec![1; size.area()];
            let (mut frame, mut floor) = (vec![0; size.area()], vec![0; size.area()]);
            let mut out = TexturesMut {
                ratio: &mut ratio,
                frame: &mut frame,
                floor: &mut floor,
            };
            textures(&level, &level, size, &mut out, |_| true);
            let expected = width.saturating_sub(4) * height.saturating_sub(4);
            assert_eq!(
                ratio.iter().filter(|&&ratio| ratio == 1024).count(),
                expected
            );
        }
    }
}
