//! Light and shadow let the floor's texture show through, objects hide it.
//!
//! A shadow, a patch of sun and a lamp multiply the floor by something that hardly changes from pixel to pixel. So the fine
//! texture of the frame should be that of the floor, times the ratio of brightness; where an object stands, it is the
//! object's own or none. [`visibility`] is the share of the floor's texture that is found in the frame: about 1 for light and
//! shadow, about 0 for an object. It needs a floor with a texture above the noise, and says nothing otherwise.
//!
//! # Method
//!
//! Texture is a pixel minus the mean of the four at a distance of two: a gradient of light, the penumbra of a shadow, leaves
//! nothing in it. Over a 13x13 window, with `t` the frame's texture, `t₀` the floor's and `s` the ratio of the windows'
//! brightness, the visibility is `Σ t t₀ / (s Σ t₀²)`: least squares for the factor of the floor's texture, divided by the
//! factor that light would give. A sharp edge in the window would outweigh all texture; `t` is therefore bounded by
//! twice what light would make of the floor's (as in a Huber estimator).

use crate::{Size, assert_len};

/// The window reaches so far from its centre.
const REACH: usize = 6;

/// Distance of the pixels whose mean is subtracted.
const STEP: usize = 2;

/// What is seen of the floor's texture in one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visibility {
    /// Share of the floor's texture that shows through, about 0 to 1.
    pub share: f32,
    /// How well it is known: the share's standard deviation is the reciprocal.
    pub signal: f32,
}

/// How much of the floor's texture shows through around a pixel; `None` within 8 pixels of the border, and where the signal is less
/// than `signal_least`. Only pixels whose index `counts` are looked at. `level` and `floor_level` are sums of channels, as in
/// [`Reference`](crate::difference::Reference), `noise` the standard deviation of the floor's level.
///
/// # Panics
///
/// When a plane has not `size.area()` values.
#[must_use]
pub fn visibility(
    level: &[u16],
    floor_level: &[u16],
    size: Size,
    (x, y): (usize, usize),
    noise: f32,
    signal_least: f32,
    counts: impl Fn(usize) -> bool,
) -> Option<Visibility> {
    assert_len("level", level.len(), size);
    assert_len("floor_level", floor_level.len(), size);
    let margin = REACH + STEP;
    if x < margin || y < margin || x + margin >= size.width || y + margin >= size.height {
        return None;
    }
    let texture = |plane: &[u16], i: usize| {
        let around = i32::from(plane[i - STEP])
            + i32::from(plane[i + STEP])
            + i32::from(plane[i - STEP * size.width])
            + i32::from(plane[i + STEP * size.width]);
        i32::from(plane[i]) - around / 4
    };
    let rows = || (y - REACH..=y + REACH).map(|y| y * size.width + x - REACH);
    let (mut sum, mut floor_sum, mut power, mut pixels) = (0u32, 0u32, 0i64, 0i64);
    for start in rows() {
        for i in (start..=start + 2 * REACH).filter(|&i| counts(i)) {
            pixels += 1;
            sum += u32::from(level[i]);
            floor_sum += u32::from(floor_level[i]);
            power += i64::from(texture(floor_level, i)).pow(2);
        }
    }
    let ratio = sum as f32 / floor_sum.max(1) as f32;
    // The noise of a pixel and of a mean of four. Most of it is that of the light itself, whose variance follows the light: in
    // the frame it is less by the root of the ratio, and the signal by the ratio.
    let root = ((ratio * 65536.0) as u32).isqrt() as f32 / 256.0;
    let signal = root * (power.max(0).isqrt() as f32) / (1.12 * noise);
    if signal < signal_least {
        return None;
    }
    let typical = (power / pixels.max(1)).max(0).isqrt() as f32;
    let bound = (2.0 * ratio * typical) as i32 + 1;
    let mut common = 0i64;
    for start in rows() {
        for i in (start..=start + 2 * REACH).filter(|&i| counts(i)) {
            let seen = texture(level, i).clamp(-bound, bound);
            common += i64::from(seen) * i64::from(texture(floor_level, i));
        }
    }
    Some(Visibility {
        share: common as f32 / (ratio * power as f32),
        signal,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const SIZE: Size = Size {
        width: 40,
        height: 30,
    };

    fn carpet(seed: u32) -> Vec<u16> {
        let mut state = seed;
        (0..SIZE.area())
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                5000 + (state >> 23) as u16
            })
            .collect()
    }

    #[test]
    fn a_shadow_shows_the_floor_and_an_object_does_not() {
        let floor = carpet(1);
        let at = |level: &[u16], x| {
            visibility(level, &floor, SIZE, (x, 14), 16.0, 8.0, |_| true).map(|seen| seen.share)
        };
        let shadow: Vec<u16> = floor.iter().map(|&l| l * 2 / 10).collect();
        let seen = at(&shadow, 20).expect("the carpet has a texture");
        assert!((seen - 1.0).abs() < 0.05, "{seen}");
        let plain = std::vec![1000; SIZE.area()];
        assert_eq!(at(&plain, 20), Some(0.0));
        let other = at(&carpet(2), 20).expect("the carpet has a texture");
        assert!(other.abs() < 0.3, "{other}");
    }

    #[test]
    fn a_sharp_border_of_a_shadow_does_not_hide_the_floor() {
        let floor = carpet(1);
        let half: Vec<u16> = floor
            .iter()
            .enumerate()
            .map(|(i, &l)| if i % SIZE.width < 20 { l / 2 } else { l })
            .collect();
        for x in 10..30 {
            let seen = visibility(&half, &floor, SIZE, (x, 14), 16.0, 8.0, |_| true)
                .expect("texture")
                .share;
            assert!(seen > 0.4, "{seen} at {x}");
        }
    }

    #[test]
    fn a_plain_floor_tells_nothing() {
        let plain = std::vec![5000; SIZE.area()];
        assert_eq!(
            visibility(&carpet(1), &plain, SIZE, (20, 14), 16.0, 8.0, |_| true),
            None
        );
    }
}
