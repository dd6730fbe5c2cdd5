//! 3x3 median: removes the noise of single pixels and keeps edges (section 2.1.1 of the paper).
//!
//! Each column of the window is sorted. The median of nine is the median of the largest low, the
//! middle mid and the smallest high. Minimum and maximum are the only operations, so the loop has
//! no branches.
//!
//! Cost: one pass, about 20 operations per pixel, vectorised.

use crate::Size;
use crate::window::{PADDED, for_each_block};

/// Writes the median of the 3x3 window around each pixel to `out`. Outside the picture the border
/// is repeated.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
///
/// # Example
///
/// ```
/// use imgproc::{Size, median::median_3x3};
/// let speck = [5, 5, 5, 5, 99, 5, 5, 5, 5];
/// let mut out = [0; 9];
/// median_3x3(&speck, Size { width: 3, height: 3 }, &mut out);
/// assert_eq!(out, [5; 9]);
/// ```
pub fn median_3x3(plane: &[u8], size: Size, out: &mut [u8]) {
    let (mut low, mut mid, mut high) = ([0; PADDED], [0; PADDED], [0; PADDED]);
    for_each_block(plane, size, out, |[above, here, below], out| {
        let n = out.len();
        let (low, mid, high) = (&mut low[..n + 2], &mut mid[..n + 2], &mut high[..n + 2]);
        for i in 0..n + 2 {
            (low[i], mid[i], high[i]) = sorted(above[i], here[i], below[i]);
        }
        for (i, out) in out.iter_mut().enumerate() {
            let lowest = low[i].max(low[i + 1]).max(low[i + 2]);
            let middle = median(mid[i], mid[i + 1], mid[i + 2]);
            let highest = high[i].min(high[i + 1]).min(high[i + 2]);
            *out = median(lowest, middle, highest);
        }
    });
}

/// Three values in ascending order.
fn sorted(a: u8, b: u8, c: u8) -> (u8, u8, u8) {
    let (low, high) = (a.min(b), a.max(b));
    (low.min(c), low.max(high.min(c)), high.max(c))
}

/// The median of three values.
fn median(a: u8, b: u8, c: u8) -> u8 {
    a.min(b).max(a.max(b).min(c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::window::naive;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_sorting_nine((size, plane) in naive::planes(255)) {
            let mut out = std::vec![0xa5; size.area()];
            median_3x3(&plane, size, &mut out);
            let expected = naive::map_3x3(&plane, size, |mut window| {
                window.sort_unstable();
                window[4]
            });
            prop_assert_eq!(out, expected);
        }
    }

    #[test]
    #[should_panic(expected = "plane has 3 values, 2 x 2 pixels were announced")]
    fn a_wrong_length_is_a_mistake() {
        median_3x3(
            &[0; 3],
            Size {
                width: 2,
                height: 2,
            },
            &mut [0; 4],
        );
    }
}
