//! From differences to a mask: object where the 3x3 window differs enough in sum (section 2.1.1 of the paper).
//!
//! Cost: one pass, six operations a pixel.

use crate::Size;
use crate::window::map_3x3;

/// Sets the pixels around which the nine differences sum up to more than `threshold`. Outside the picture the border is
/// repeated.
///
/// # Panics
///
/// When a slice has not `size.area()` values.
pub fn window_threshold(difference: &[u8], size: Size, mask: &mut [u8], threshold: u16) {
    let sum = |a: u8, b: u8, c: u8| u16::from(a) + u16::from(b) + u16::from(c);
    map_3x3(difference, size, mask, sum, |left, mid, right| {
        u8::from(left + mid + right > threshold)
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::window::naive;
    use proptest::prelude::*;

    #[test]
    fn the_sum_of_the_window_decides_not_the_pixel() {
        let size = Size {
            width: 5,
            height: 3,
        };
        let mut difference = [0; 15];
        difference[7] = 40;
        let mut mask = [9; 15];
        window_threshold(&difference, size, &mut mask, 39);
        assert_eq!(mask, [0, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0]);
        window_threshold(&difference, size, &mut mask, 40);
        assert_eq!(mask, [0; 15]);
    }

    proptest! {
        #[test]
        fn equals_the_sum_spelled_out((size, plane) in naive::planes(255), threshold in 0u16..2400) {
            let mut mask = std::vec![9; size.area()];
            window_threshold(&plane, size, &mut mask, threshold);
            let expected = naive::map_3x3(&plane, size, |window| {
                u8::from(window.into_iter().map(u16::from).sum::<u16>() > threshold)
            });
            prop_assert_eq!(mask, expected);
        }
    }
}
