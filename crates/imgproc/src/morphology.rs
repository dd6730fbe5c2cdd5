//! Opening and closing of a mask with 3x3 windows (section 2.1.1 of the paper).
//!
//! Pixels outside the picture neither erode nor dilate, so an object at the border keeps its full
//! extent.
//!
//! Cost: two passes each for opening and closing, four operations per pixel and pass.

use crate::Size;
use crate::window::map_3x3;

/// Keeps a pixel only where the whole 3x3 window is set.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub fn erode_3x3(mask: &[u8], size: Size, out: &mut [u8]) {
    let and = |a: u8, b: u8, c: u8| a & b & c;
    map_3x3(mask, size, out, and, and);
}

/// Sets a pixel where any pixel of the 3x3 window is set.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub fn dilate_3x3(mask: &[u8], size: Size, out: &mut [u8]) {
    let or = |a: u8, b: u8, c: u8| a | b | c;
    map_3x3(mask, size, out, or, or);
}

/// Erosion, then dilation: removes everything that does not contain a 3x3 square. Overwrites
/// `mask`; `scratch` may have any content.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub fn open_3x3(mask: &mut [u8], size: Size, scratch: &mut [u8]) {
    erode_3x3(mask, size, scratch);
    dilate_3x3(scratch, size, mask);
}

/// Dilation, then erosion: fills every gap that does not contain a 3x3 square. Overwrites `mask`;
/// `scratch` may have any content.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub fn close_3x3(mask: &mut [u8], size: Size, scratch: &mut [u8]) {
    dilate_3x3(mask, size, scratch);
    erode_3x3(scratch, size, mask);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contour::tests::drawing;
    use crate::window::naive;
    use proptest::prelude::*;

    #[test]
    fn opening_removes_specks_and_keeps_squares() {
        let (size, mut mask) = drawing(
            "#......
             ...###.
             ...###.
             .#.###.
             .......
             ##....#",
        );
        let (_, expected) = drawing(
            ".......
             ...###.
             ...###.
             ...###.
             .......
             .......",
        );
        open_3x3(&mut mask, size, &mut [7; 42]);
        assert_eq!(mask, expected);
    }

    #[test]
    fn closing_fills_gaps_and_keeps_what_is_far_apart() {
        let (size, mut mask) = drawing(
            "###.###......
             ###.###......
             #.#.###...#..
             ###.###......
             ###.###......",
        );
        let (_, expected) = drawing(
            "#######......
             #######......
             #######...#..
             #######......
             #######......",
        );
        close_3x3(&mut mask, size, &mut [7; 65]);
        assert_eq!(mask, expected);
    }

    proptest! {
        #[test]
        fn erosion_and_dilation_equal_the_naive_window((size, mask) in naive::planes(1)) {
            let mut out = std::vec![0xa5; size.area()];
            erode_3x3(&mask, size, &mut out);
            prop_assert_eq!(&out, &naive::map_3x3(&mask, size, |w| w.into_iter().min().unwrap_or(0)));
            dilate_3x3(&mask, size, &mut out);
            prop_assert_eq!(&out, &naive::map_3x3(&mask, size, |w| w.into_iter().max().unwrap_or(0)));
        }
    }
}
