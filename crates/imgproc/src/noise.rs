//! How much a pixel of the empty floor changes from frame to frame, learned from the same frames as
//! the median.
//!
//! # Method
//!
//! The variance of each pixel over the frames in which it is near its median. Near means within
//! four times the median of the distances from it (the median absolute deviation) plus two grey
//! levels. Whatever covers a pixel for less than half of the time and differs from it by more does
//! not count. For Gaussian noise the limit is at 2.7 standard deviations plus two grey levels;
//! cutting off the tails makes the standard deviation up to 5 % too low. The two grey levels keep
//! the limit away from noise below one grey level, whose median distance is 0. If something covers
//! a pixel for a fifth of the time, the limit is at 4 to 6 standard deviations; for two fifths, it
//! moves the median too, and the limit is at 8 on average and at 13 in some pixels.
//!
//! The variance is about the mean of the near values, not about the median. The median is a whole
//! number, and on a quiet floor an offset of half a grey level is as much as the noise. The
//! camera's rounding to whole grey levels is part of what is measured and adds 1/12 to the
//! variance.
//!
//! The variance of one pixel over 24 frames has a standard error of 30 %. [`mean_3x3`] of the
//! standard deviations reduces it to a few percent, but blurs the border between a quiet and a
//! noisy floor by a pixel.
//!
//! Deliberately absent: a covariance of the colours. A camera's sharpening and chroma subsampling
//! correlate them, but not enough to justify six numbers per pixel.

use crate::window::{BLOCK, map_3x3};
use crate::{Size, assert_len};

/// Bits of the median distance. With 31 or more the standard deviation is above 46 grey levels and
/// no longer noise.
const DISTANCE_BITS: u32 = 5;

/// Limit of the distance from the median: a factor of the median distance, and grey levels on top.
const NEAR: (u8, u8) = (4, 2);

/// Adds to `variance` the variance of each pixel over the frames in which it is near its median, in
/// square grey levels. A pixel that is near in only one frame adds nothing.
///
/// `frames` holds the planes one after the other, each as long as `median`, which
/// [`median_of_frames`](crate::background::median_of_frames) computed from them.
///
/// # Panics
///
/// If `variance` is not as long as `median`, or `frames` holds no plane, more than 255, or not a
/// whole number of them.
pub fn add_variance(frames: &[u8], median: &[u8], variance: &mut [f32]) {
    let area = median.len();
    assert!(
        area > 0
            && variance.len() == area
            && !frames.is_empty()
            && frames.len().is_multiple_of(area)
            && frames.len() / area <= 0xff,
        "{} bytes are not 1 to 255 planes of {area} pixels and {} variances",
        frames.len(),
        variance.len()
    );
    for (block, out) in variance.chunks_mut(BLOCK).enumerate() {
        let (start, n) = (block * BLOCK, out.len());
        let planes = || frames.chunks_exact(area).map(|p| &p[start..][..n]);
        let median = &median[start..][..n];
        let limit = limits(planes(), median, frames.len() / area);

        let (mut near, mut sum, mut squares) = ([0i32; BLOCK], [0i32; BLOCK], [0i32; BLOCK]);
        for plane in planes() {
            for i in 0..n {
                let is_near = i32::from(plane[i].abs_diff(median[i]) <= limit[i]);
                let away = is_near * (i32::from(plane[i]) - i32::from(median[i]));
                near[i] += is_near;
                sum[i] += away;
                squares[i] += away * away;
            }
        }
        for (i, variance) in out.iter_mut().enumerate() {
            // At most 255 values of at most 126: exact in 32 bits.
            let (near, sum) = (near[i] as f32, sum[i] as f32);
            *variance += (squares[i] as f32 - sum * sum / near).max(0.0) / (near - 1.0).max(1.0);
        }
    }
}

/// Maximum distance from the median for the values of one block. The median distance is found bit
/// by bit, like the median itself.
fn limits<'a>(
    planes: impl Iterator<Item = &'a [u8]> + Clone,
    median: &[u8],
    n_frames: usize,
) -> [u8; BLOCK] {
    let n = median.len();
    let before = ((n_frames - 1) / 2) as u8;
    let mut distance = [0u8; BLOCK];
    for bit in (0..DISTANCE_BITS).rev() {
        let candidate = distance.map(|found| found | 1 << bit);
        let mut below = [0u8; BLOCK];
        for plane in planes.clone() {
            for i in 0..n {
                below[i] += u8::from(plane[i].abs_diff(median[i]) < candidate[i]);
            }
        }
        for i in 0..n {
            if below[i] <= before {
                distance[i] = candidate[i];
            }
        }
    }
    distance.map(|distance| NEAR.0 * distance + NEAR.1)
}

/// Writes the rounded mean of the 3x3 window around each pixel to `out`. Outside the picture the
/// border is repeated.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub fn mean_3x3(plane: &[u8], size: Size, out: &mut [u8]) {
    let down = |above, here, below| u16::from(above) + u16::from(here) + u16::from(below);
    let across = |left: u16, mid: u16, right: u16| ((left + mid + right + 4) / 9) as u8;
    map_3x3(plane, size, out, down, across);
}

/// Weights of red, green and blue for brightness (BT.601).
const BRIGHTNESS: [f32; 3] = [0.299, 0.587, 0.114];

/// Approximate number of pixels sampled for the noise of a frame.
const SAMPLES: usize = 3000;

/// Standard deviation of a single frame's brightness noise, in grey levels.
///
/// `frame` holds red, green and blue. `floor` is the same of the empty floor, in 256ths of a grey
/// level; each channel is `gains` times as bright in the frame. Measures how much a pixel differs
/// from its eight neighbours (the second difference in x of that in y; Immerkær 1996), minus the
/// part that the floor explains. The median over the picture is used, since objects cover only a
/// small part of it.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
#[must_use]
pub fn frame_noise(frame: [&[u8]; 3], floor: [&[u16]; 3], gains: [f32; 3], size: Size) -> f32 {
    for (frame, floor) in frame.iter().zip(floor) {
        assert_len("frame", frame.len(), size);
        assert_len("floor", floor.len(), size);
    }
    let Size { width, height } = size;
    if width < 3 || height < 3 {
        return 0.0;
    }
    const STEPS_PER_LEVEL: f32 = 2.0;
    let mut counts = [0u32; 1024];
    let mut n = 0;
    let step = (size.area() / SAMPLES).max(1);
    // A step coprime to the width would be better still; borders are skipped.
    for i in (width + 1..size.area() - width - 1).step_by(step) {
        let x = i % width;
        if x == 0 || x == width - 1 {
            continue;
        }
        let mut sum = 0.0;
        for ((frame, floor), (gain, weight)) in
            frame.iter().zip(floor).zip(gains.iter().zip(BRIGHTNESS))
        {
            let at = |i: usize| f32::from(frame[i]) - gain / 256.0 * f32::from(floor[i]);
            let row = |i: usize| at(i - 1) - 2.0 * at(i) + at(i + 1);
            sum += weight * (row(i - width) - 2.0 * row(i) + row(i + width));
        }
        let bin = (sum.abs() * STEPS_PER_LEVEL) as usize;
        counts[bin.min(counts.len() - 1)] += 1;
        n += 1;
    }
    let mut below = 0;
    for (bin, &count) in counts.iter().enumerate() {
        if 2 * (below + count) >= n && count > 0 {
            let share = (n as f32 / 2.0 - below as f32) / count as f32;
            // For Gaussian noise the median distance is 0.6745 deviations, and the squares of the
            // nine weights add up to 36.
            return (bin as f32 + share) / STEPS_PER_LEVEL / (0.6745 * 6.0);
        }
        below += count;
    }
    0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::background::median_of_frames;
    use crate::window::naive;
    use proptest::prelude::*;
    use random::SplitMix64;
    use std::vec::Vec;

    /// The same, written naively for one pixel.
    fn naive_variance(values: &[u8]) -> f32 {
        let middle = |values: &mut Vec<u8>| {
            values.sort_unstable();
            values[(values.len() - 1) / 2]
        };
        let median = middle(&mut values.to_vec());
        let mut distances = values.iter().map(|v| v.abs_diff(median)).collect();
        let limit = 4 * middle(&mut distances).min(31) + 2;
        let near = values.iter().filter(|v| v.abs_diff(median) <= limit);
        let near: Vec<f32> = near.map(|&value| f32::from(value)).collect();
        let mean = near.iter().sum::<f32>() / near.len() as f32;
        let squares: f32 = near.iter().map(|value| (value - mean).powi(2)).sum();
        squares / (near.len() as f32 - 1.0).max(1.0)
    }

    fn variances(frames: &[u8], area: usize) -> Vec<f32> {
        let (mut median, mut variance) = (std::vec![0; area], std::vec![0.0; area]);
        median_of_frames(frames, &mut median);
        add_variance(frames, &median, &mut variance);
        variance
    }

    proptest! {
        #[test]
        fn equals_the_naive_variance(area in 1usize..600, n in 1usize..12, spread in 1u32..256, seed: u32) {
            let mut random = SplitMix64(seed.into());
            let frames: Vec<u8> = (0..area * n)
                .map(|_| (random.bits() % u64::from(spread)) as u8)
                .collect();
            for (i, variance) in variances(&frames, area).into_iter().enumerate() {
                let values: Vec<u8> = frames.iter().skip(i).step_by(area).copied().collect();
                let expected = naive_variance(&values);
                prop_assert!((variance - expected).abs() <= 1e-4 * expected.max(1.0), "{} {}", variance, expected);
            }
        }

        #[test]
        fn the_mean_is_that_of_nine((size, plane) in naive::planes(255)) {
            let mut out = std::vec![0xa5; size.area()];
            mean_3x3(&plane, size, &mut out);
            let mean = |window: [u8; 9]| {
                ((window.map(u32::from).iter().sum::<u32>() + 4) / 9) as u8
            };
            prop_assert_eq!(out, naive::map_3x3(&plane, size, mean));
        }
    }

    #[test]
    fn passing_objects_are_not_noise() {
        // 109, 110 and 111 on the floor, and an object for two of five frames.
        assert_eq!(variances(&[109, 200, 110, 200, 111], 1), [1.0]);
        assert_eq!(variances(&[109, 20, 110, 20, 111], 1), [1.0]);
    }

    #[test]
    fn variances_add_up_and_one_frame_has_none() {
        let mut variance = [2.5];
        add_variance(&[7], &[7], &mut variance);
        assert_eq!(variance, [2.5]);
        add_variance(&[9, 10, 11], &[10], &mut variance);
        assert_eq!(variance, [3.5]);
    }

    #[test]
    #[should_panic(expected = "5 bytes are not 1 to 255 planes of 2 pixels")]
    fn a_wrong_length_is_a_mistake() {
        add_variance(&[0; 5], &[0; 2], &mut [0.0; 2]);
    }

    #[test]
    fn the_noise_of_a_frame_excludes_the_texture_of_the_floor() {
        let size = Size {
            width: 200,
            height: 150,
        };
        let mut state = 7u64;
        let mut normal = || {
            (0..12)
                .map(|_| {
                    state = state
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1_442_695_040_888_963_407);
                    (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
                })
                .sum::<f32>()
        };
        // A floor that alternates by 60 grey levels from pixel to pixel, in four fifths of its
        // light.
        let floor: std::vec::Vec<u16> = (0..size.area())
            .map(|i| (120 + 60 * (i % 2) as u16) * 256)
            .collect();
        for sigma in [1.0, 3.0, 12.0] {
            let frame: std::vec::Vec<u8> = floor
                .iter()
                .map(|&floor| (0.8 * f32::from(floor) / 256.0 + sigma * normal()).round() as u8)
                .collect();
            let noise = frame_noise([&frame; 3], [&floor; 3], [0.8; 3], size);
            let expected = (sigma * sigma + 1.0 / 12.0).sqrt();
            assert!(
                (noise / expected - 1.0).abs() < 0.06,
                "{noise}, not {expected}"
            );
        }
    }
}
