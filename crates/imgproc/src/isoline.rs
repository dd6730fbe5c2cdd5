//! The border between dark and light, with subpixel precision.
//!
//! Grey values are taken as heights at the pixel centres. The contour is the line at the height of
//! the threshold, straight between the points where it crosses from one centre to the next
//! (marching squares: Lorensen and Cline 1987, in two dimensions). A contour of whole pixels moves
//! in steps when the marker moves; this one moves continuously.
//!
//! If the four corners of a cell alternate between dark and light, the line can pass in two ways.
//! The mean of the four decides, so that the choice depends on the picture alone.
//!
//! Cost: bounded by the number of points of the contour.

use crate::{Point, Size, assert_len};

/// Why there is no contour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IsolineError {
    /// The dark region reaches the border of the plane: its contour is not closed.
    NotClosed,
    /// The contour has more points than the buffer.
    TooLong,
}

// Sides of a cell, clockwise; the fourth is the left.
const TOP: usize = 0;
const RIGHT: usize = 1;
const BOTTOM: usize = 2;

/// Follows the line at the height `threshold` around the dark region that `start` belongs to,
/// clockwise as seen on the screen. Dark is below the threshold. Returns the points (x, y) in
/// pixels.
///
/// `start` must be dark with a light pixel to its left, like the first pixel of a dark region in
/// row-major order.
///
/// # Errors
///
/// [`IsolineError`] if the line leaves the plane or `points` is too short.
///
/// # Panics
///
/// If `plane` does not have `size.area()` values, or `start` is not as described.
pub fn follow_isoline<'a>(
    plane: &[u8],
    size: Size,
    start: Point,
    threshold: f32,
    points: &'a mut [[f32; 2]],
) -> Result<&'a [[f32; 2]], IsolineError> {
    assert_len("plane", plane.len(), size);
    let height = |x: usize, y: usize| f32::from(plane[y * size.width + x]);
    let (start_x, start_y) = (usize::from(start.x), usize::from(start.y));
    if start_x == 0 || start_y == 0 {
        return Err(IsolineError::NotClosed);
    }
    assert!(
        height(start_x, start_y) < threshold && height(start_x - 1, start_y) >= threshold,
        "the isoline starts at {start:?}, which is not dark with light to its left"
    );
    // A cell has the coordinates of its top left corner. With dark on the right, the line enters
    // the cell above the first crossing through that cell's bottom side.
    let first = (start_x - 1, start_y - 1, BOTTOM);
    let (mut x, mut y, mut entry) = first;
    let mut n = 0;
    loop {
        let corners = [
            height(x, y),
            height(x + 1, y),
            height(x + 1, y + 1),
            height(x, y + 1),
        ];
        *points.get_mut(n).ok_or(IsolineError::TooLong)? =
            crossing(x, y, entry, corners, threshold);
        n += 1;
        let exit = exit_side(corners, entry, threshold);
        // The line enters the neighbour through the opposite side.
        entry = (exit + 2) % 4;
        let (next_x, next_y) = match exit {
            TOP => (x, y.wrapping_sub(1)),
            RIGHT => (x + 1, y),
            BOTTOM => (x, y + 1),
            _ => (x.wrapping_sub(1), y),
        };
        if next_x >= size.width - 1 || next_y >= size.height - 1 {
            return Err(IsolineError::NotClosed);
        }
        (x, y) = (next_x, next_y);
        if (x, y, entry) == first {
            return Ok(&points[..n]);
        }
    }
}

/// The side through which the line leaves a cell entered through `entry`, with dark on its right.
fn exit_side(corners: [f32; 4], entry: usize, threshold: f32) -> usize {
    // Corner i is the first corner of side i, clockwise. With dark on the right, the line enters
    // through a side from dark to light and leaves through one from light to dark.
    let dark = corners.map(|corner| corner < threshold);
    let leaves = |side: usize| !dark[side] && dark[(side + 1) % 4];
    let (left, straight, right) = ((entry + 1) % 4, (entry + 2) % 4, (entry + 3) % 4);
    if leaves(left) && leaves(right) {
        // A dark centre joins both dark corners, so the line keeps both on its right.
        let centre = corners.iter().sum::<f32>() / 4.0;
        return if centre < threshold { left } else { right };
    }
    if leaves(left) {
        left
    } else if leaves(right) {
        right
    } else {
        straight
    }
}

/// Where the line crosses a side of the cell (x, y).
fn crossing(x: usize, y: usize, side: usize, corners: [f32; 4], threshold: f32) -> [f32; 2] {
    let (from, to) = (corners[side], corners[(side + 1) % 4]);
    let share = (threshold - from) / (to - from);
    let (x, y) = (x as f32, y as f32);
    match side {
        TOP => [x + share, y],
        RIGHT => [x + 1.0, y + share],
        BOTTOM => [x + 1.0 - share, y + 1.0],
        _ => [x, y + 1.0 - share],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::{vec, vec::Vec};

    /// Twice the signed area: positive if clockwise on the screen, y down.
    fn twice_area(points: &[[f32; 2]]) -> f32 {
        let next = points.iter().cycle().skip(1);
        points
            .iter()
            .zip(next)
            .map(|(a, b)| a[0] * b[1] - b[0] * a[1])
            .sum()
    }

    #[test]
    fn a_dark_pixel_is_a_diamond() {
        let size = Size {
            width: 3,
            height: 3,
        };
        let plane = [100, 100, 100, 100, 0, 100, 100, 100, 100];
        let mut points = [[0.0; 2]; 8];
        let line =
            follow_isoline(&plane, size, Point { x: 1, y: 1 }, 25.0, &mut points).expect("closed");
        assert_eq!(line, [[0.75, 1.0], [1.0, 0.75], [1.25, 1.0], [1.0, 1.25]]);
    }

    #[test]
    fn a_saddle_with_a_dark_centre_joins_both_corners() {
        let size = Size {
            width: 4,
            height: 4,
        };
        #[rustfmt::skip]
        let joined = |corner: u8| [
            90, 90, 90, 90,
            90,  0, corner, 90,
            90, corner, 0, 90,
            90, 90, 90, 90,
        ];
        let mut points = [[0.0; 2]; 16];
        let start = Point { x: 1, y: 1 };
        assert_eq!(
            follow_isoline(&joined(60), size, start, 50.0, &mut points).map(<[_]>::len),
            Ok(8)
        );
        assert_eq!(
            follow_isoline(&joined(200), size, start, 50.0, &mut points).map(<[_]>::len),
            Ok(4)
        );
    }

    #[test]
    fn a_region_at_the_border_is_not_closed() {
        let size = Size {
            width: 3,
            height: 3,
        };
        let plane = [100, 100, 100, 100, 0, 0, 100, 100, 100];
        let mut points = [[0.0; 2]; 8];
        let start = Point { x: 1, y: 1 };
        assert_eq!(
            follow_isoline(&plane, size, start, 25.0, &mut points),
            Err(IsolineError::NotClosed)
        );
        let closed = [100, 100, 100, 100, 0, 100, 100, 100, 100];
        assert_eq!(
            follow_isoline(&closed, size, start, 25.0, &mut points[..3]),
            Err(IsolineError::TooLong)
        );
    }

    proptest! {
        /// A dark disc whose pixels are weighted by distance from the rim: the line must be the
        /// circle.
        #[test]
        fn a_disc_is_a_circle(x in 10f32..14.0, y in 10f32..14.0, radius in 3f32..8.0) {
            let size = Size { width: 24, height: 24 };
            let plane: Vec<u8> = (0..size.area())
                .map(|i| {
                    let (dx, dy) = ((i % 24) as f32 - x, (i / 24) as f32 - y);
                    (128.0 + 60.0 * ((dx * dx + dy * dy).sqrt() - radius)).clamp(0.0, 255.0) as u8
                })
                .collect();
            let first = plane.iter().position(|&p| p < 128).expect("the disc is dark");
            let start = Point { x: (first % 24) as u16, y: (first / 24) as u16 };
            let mut points = vec![[0.0; 2]; 200];
            let line = follow_isoline(&plane, size, start, 128.0, &mut points).expect("closed");
            for point in line {
                let distance = ((point[0] - x).powi(2) + (point[1] - y).powi(2)).sqrt();
                prop_assert!((distance - radius).abs() < 0.1, "{distance} from the centre, not {radius}");
            }
            let area = twice_area(line) / 2.0;
            let expected = core::f32::consts::PI * radius * radius;
            prop_assert!((area - expected).abs() < 0.05 * expected, "area {area}, not {expected}");
        }

        /// The walk ends on any picture: closed, outside the plane, or out of space.
        #[test]
        fn every_walk_ends(plane in proptest::collection::vec(0u8..4, 36)) {
            let size = Size { width: 6, height: 6 };
            let mut points = vec![[0.0; 2]; 200];
            for i in 0..36 {
                if i % 6 > 0 && plane[i] < 2 && plane[i - 1] >= 2 {
                    let start = Point { x: (i % 6) as u16, y: (i / 6) as u16 };
                    let walked = follow_isoline(&plane, size, start, 1.5, &mut points);
                    prop_assert_ne!(walked, Err(IsolineError::TooLong));
                }
            }
        }
    }
}
