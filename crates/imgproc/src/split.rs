//! Separates light and dark pixels of a cut-out by its histogram (section 2.2.1 of the paper).
//!
//! Two Gaussians are fitted to the histogram iteratively; the threshold is half-way between their
//! centres. Only the centres are needed and the border is half-way, so each round divides the
//! pixels at the threshold and takes the mean of each side as the next centre. The threshold moves
//! in only one direction, so the rounds end (Ridler and Calvard, "Picture thresholding using an
//! iterative selection method", 1978).
//!
//! Half-way between the two levels is also where an ideal edge crosses a pixel's area, so a contour
//! at this threshold does not move with changes of light or even blur.
//!
//! Cost: one pass over the pixels, then at most 256 steps per round.

/// Number of pixels of each of 256 intensities.
pub type Histogram = [u32; 256];

/// Two levels of intensity and the border between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Split {
    /// Mean of the dark pixels.
    pub dark: f32,
    /// Mean of the light pixels.
    pub light: f32,
    /// Half-way between them. Pixels below are dark.
    pub threshold: f32,
}

/// Counts the pixels selected by `mask`.
///
/// # Panics
///
/// If `plane` and `mask` differ in length.
#[must_use]
pub fn histogram(plane: &[u8], mask: &[u8]) -> Histogram {
    assert_eq!(plane.len(), mask.len(), "plane and mask differ in length");
    let mut histogram = [0; 256];
    for (&value, &selected) in plane.iter().zip(mask) {
        // Adding the mask instead of testing it: no branch to mispredict.
        histogram[usize::from(value)] += u32::from(selected);
    }
    histogram
}

/// Divides a histogram into light and dark. `None` if there are fewer than two different
/// intensities.
#[must_use]
pub fn split(histogram: &Histogram) -> Option<Split> {
    let first = histogram.iter().position(|&n| n > 0)?;
    let last = histogram.iter().rposition(|&n| n > 0)?;
    if first == last {
        return None;
    }
    // Start between the extremes, not at the mean, where a large plate would outweigh a small
    // marker.
    let mut threshold = (first + last) as f32 / 2.0;
    for _ in 0..histogram.len() {
        let (dark, light) = means(histogram, threshold);
        let next = (dark + light) / 2.0;
        if (next - threshold).abs() < 1e-3 {
            return Some(Split {
                dark,
                light,
                threshold,
            });
        }
        threshold = next;
    }
    let (dark, light) = means(histogram, threshold);
    Some(Split {
        dark,
        light,
        threshold,
    })
}

/// Mean intensities below the threshold and from it on. Both sides hold pixels as long as the
/// threshold is between the smallest and the largest intensity.
fn means(histogram: &Histogram, threshold: f32) -> (f32, f32) {
    let mut counts = [0u64; 2];
    let mut sums = [0u64; 2];
    for (value, &n) in histogram.iter().enumerate() {
        let side = usize::from(value as f32 >= threshold);
        counts[side] += u64::from(n);
        sums[side] += u64::from(n) * value as u64;
    }
    let mean = |side: usize| sums[side] as f32 / counts[side].max(1) as f32;
    (mean(0), mean(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn two_levels_are_split_half_way() {
        let plane = [40, 42, 38, 40, 220, 218, 222, 220, 220, 220, 220, 220, 0, 0];
        let mut mask = [1; 14];
        mask[12..].fill(0);
        let split = split(&histogram(&plane, &mask)).expect("two levels");
        assert_eq!(
            (split.dark, split.light, split.threshold),
            (40.0, 220.0, 130.0)
        );
    }

    #[test]
    fn one_level_is_not_split() {
        assert_eq!(split(&histogram(&[7; 5], &[1; 5])), None);
        assert_eq!(split(&histogram(&[7, 9], &[0; 2])), None);
    }

    proptest! {
        #[test]
        fn the_threshold_is_half_way_and_each_side_has_its_mean(values in proptest::collection::vec(0u8.., 2..400)) {
            prop_assume!(values.iter().any(|&v| v != values[0]));
            let histogram = histogram(&values, &std::vec![1; values.len()]);
            let split = split(&histogram).expect("at least two intensities");
            prop_assert!((split.threshold - (split.dark + split.light) / 2.0).abs() < 2e-3);
            prop_assert_eq!((split.dark, split.light), means(&histogram, split.threshold));
            prop_assert!(split.dark < split.threshold && split.threshold < split.light);
        }
    }
}
