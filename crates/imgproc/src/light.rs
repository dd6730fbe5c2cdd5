//! How much brighter or dimmer the light is than in the picture of the floor.
//!
//! Objects cover less than half of the picture, so the median of the pixels' ratios to the floor is
//! that of the light. A camera's automatic exposure and white balance act in the same way: one
//! factor per channel.

/// Darker pixels of the floor carry no information about the light.
const DARKEST: u16 = 16;

/// Clipped pixels carry no information either, except where the floor was clipped too: there the
/// light is about the same.
const BRIGHTEST: u8 = 250;

/// Bins per unit of the ratio.
const BINS_PER_UNIT: u32 = 256;

/// Ratios of 8 and more share a bin.
const BINS: usize = 8 * BINS_PER_UNIT as usize + 1;

/// Minimum number of pixels for a median.
const PIXELS_MIN: u32 = 64;

/// The median ratio of a channel to the floor's, over every `stride`th pixel where `skip` is 0.
/// `floor` is in 256ths of a grey level. `None` if there are too few pixels.
///
/// # Panics
///
/// If the slices differ in length or `stride` is 0.
#[must_use]
pub fn channel_gain(channel: &[u8], floor: &[u16], skip: &[u8], stride: usize) -> Option<f32> {
    assert!(
        channel.len() == floor.len() && channel.len() == skip.len(),
        "{} pixels, {} of the floor, {} to skip",
        channel.len(),
        floor.len(),
        skip.len()
    );
    let mut bins = [0u32; BINS];
    let mut n = 0;
    let pixels = channel.iter().zip(floor).zip(skip).step_by(stride);
    for ((&channel, &floor), &skip) in pixels {
        let cut_off = channel >= BRIGHTEST;
        let floor_cut_off = floor >= u16::from(BRIGHTEST) * 256;
        if skip != 0 || floor < DARKEST * 256 || cut_off && !floor_cut_off {
            continue;
        }
        // Rounded to the middle of a grey level, so that dark pixels are not biased.
        let ratio = match cut_off {
            true => BINS_PER_UNIT,
            false => u32::from(channel) * 256 * BINS_PER_UNIT / u32::from(floor),
        };
        bins[(ratio as usize).min(BINS - 1)] += 1;
        n += 1;
    }
    if n < PIXELS_MIN {
        return None;
    }
    let mut below = 0;
    for (bin, &count) in bins.iter().enumerate() {
        if 2 * (below + count) >= n {
            let within = (n as f32 / 2.0 - below as f32) / count as f32;
            return Some((bin as f32 + within) / BINS_PER_UNIT as f32);
        }
        below += count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn a_third_of_the_picture_may_be_covered() {
        let floor: Vec<u16> = (0..3000u32).map(|i| (60 + i % 120) as u16 * 256).collect();
        for gain in [0.3f32, 0.7, 1.0, 1.28] {
            let frame: Vec<u8> = floor
                .iter()
                .enumerate()
                .map(|(i, &f)| {
                    let seen = if i % 3 == 0 {
                        240.0
                    } else {
                        f32::from(f) / 256.0 * gain
                    };
                    seen.round() as u8
                })
                .collect();
            let skip = std::vec![0; floor.len()];
            let found = channel_gain(&frame, &floor, &skip, 1).expect("enough pixels");
            assert!((found / gain - 1.0).abs() < 0.02, "{found} for {gain}");
        }
    }

    #[test]
    fn a_clipped_white_floor_has_unchanged_light() {
        let floor = [255 * 256; 1000];
        let mut frame = [255u8; 1000];
        frame[..300].fill(20);
        let found = channel_gain(&frame, &floor, &[0; 1000], 1).expect("enough pixels");
        assert!((found - 1.0).abs() < 0.01, "{found}");
        let dim = [100u8; 1000];
        let found = channel_gain(&dim, &floor, &[0; 1000], 1).expect("enough pixels");
        assert!((found - 100.0 / 255.0).abs() < 0.01, "{found}");
    }

    #[test]
    fn too_few_pixels_give_no_result() {
        assert_eq!(channel_gain(&[100; 70], &[25_600; 70], &[1; 70], 1), None);
    }
}
