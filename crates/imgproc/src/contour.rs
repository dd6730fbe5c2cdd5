//! Shapes in a mask and their contours (sections 2.1.2 and 2.1.3 of the paper).
//!
//! The mask is scanned row by row. The first set pixel belongs to a shape and lies on its contour,
//! since nothing above it or to its left is set. [`follow_contour`] walks around the shape from
//! there, [`remove_shape`] erases it, and the scan continues, so each shape is found exactly once.
//!
//! ```
//! use imgproc::{Point, Size, contour};
//! let size = Size { width: 6, height: 3 };
//! let mut mask = [0, 1, 1, 0, 0, 0, //
//!                 0, 1, 1, 0, 0, 1, //
//!                 0, 0, 0, 0, 0, 1];
//! let mut points = [Point::default(); 16];
//! let mut spans = vec![contour::Span::default(); contour::span_capacity(size)];
//! let (mut from, mut lengths) = (0, vec![]);
//! while let Some(start) = contour::next_shape(&mask, size, from) {
//!     lengths.push(contour::follow_contour(&mask, size, start, &mut points).unwrap().len());
//!     contour::remove_shape(&mut mask, size, start, &mut spans);
//!     from = usize::from(start.y) * size.width + usize::from(start.x);
//! }
//! assert_eq!(lengths, [4, 2]);
//! ```
//!
//! # Differences from the paper
//!
//! * The loop in its figure 5 never ends on an isolated pixel, and it reads outside the picture at
//!   the border. Here a shape of one pixel has a contour of one point, and pixels outside the
//!   picture count as clear.
//! * It ends when the start is reached again, which is too early if the shape is one pixel wide
//!   there. Here the walk ends when it leaves the start in the same direction as the first time.
//! * A contour that does not fit the buffer is reported.

use crate::{Bounds, Point, Size, assert_len};

/// The eight neighbours, clockwise from the upper left, as in the paper.
const DIRECTIONS: [(isize, isize); 8] = [
    (-1, -1),
    (0, -1),
    (1, -1),
    (1, 0),
    (1, 1),
    (0, 1),
    (-1, 1),
    (-1, 0),
];

/// The contour has more points than the buffer. The shape can still be removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ContourTooLong;

/// A run of set pixels in a row: scratch of [`remove_shape`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Span {
    y: u16,
    first: u16,
    last: u16,
}

/// What [`remove_shape`] erased.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Removed {
    /// Number of pixels.
    pub area: usize,
    /// Number of pixels with a value above 1.
    pub cores: usize,
    /// Bounding box of the pixels.
    pub bounds: Bounds,
}

/// First set pixel at or after index `from`, in row-major order.
///
/// # Panics
///
/// If `mask` does not have `size.area()` values.
#[must_use]
pub fn next_shape(mask: &[u8], size: Size, from: usize) -> Option<Point> {
    assert_len("mask", mask.len(), size);
    const STRIDE: usize = 64;
    let rest = mask.get(from..)?;
    // Most of a mask is empty, so skip it in chunks.
    let empty = rest
        .chunks_exact(STRIDE)
        .take_while(|chunk| chunk.iter().fold(0, |any, &m| any | m) == 0)
        .count();
    let index = from + empty * STRIDE + rest[empty * STRIDE..].iter().position(|&m| m != 0)?;
    Some(Point {
        x: (index % size.width) as u16,
        y: (index / size.width) as u16,
    })
}

/// Walks clockwise (as seen on the screen) around the shape that `start` belongs to and returns the
/// pixels on the way. Each step goes to one of eight neighbours. A pixel that is passed twice
/// appears twice.
///
/// `start` must be the first pixel of the shape in row-major order, as [`next_shape`] finds it.
///
/// # Errors
///
/// [`ContourTooLong`] if `points` is too short.
///
/// # Panics
///
/// If `mask` does not have `size.area()` values, or `start` is not set.
pub fn follow_contour<'a>(
    mask: &[u8],
    size: Size,
    start: Point,
    points: &'a mut [Point],
) -> Result<&'a [Point], ContourTooLong> {
    assert_len("mask", mask.len(), size);
    assert!(
        is_set(mask, size, start, (0, 0)),
        "the contour starts at {start:?}, which is not set"
    );
    // The first set neighbour, clockwise from direction `from`.
    let next = |at: Point, from: usize| {
        (0..8)
            .map(|turn| (from + turn) % 8)
            .find(|&direction| is_set(mask, size, at, DIRECTIONS[direction]))
    };
    let mut n = 0;
    let mut push = |point: Point| {
        *points.get_mut(n).ok_or(ContourTooLong)? = point;
        n += 1;
        Ok(())
    };
    push(start)?;
    let Some(first) = next(start, 0) else {
        return Ok(&points[..1]);
    };
    let (mut at, mut direction) = (start, first);
    loop {
        let (dx, dy) = DIRECTIONS[direction];
        at = Point {
            x: (at.x as isize + dx) as u16,
            y: (at.y as isize + dy) as u16,
        };
        // Start at the neighbour after the one we came from, which is set and so ends the search.
        direction = next(at, (direction + 5) % 8).unwrap_or(first);
        if at == start && direction == first {
            return Ok(&points[..n]);
        }
        push(at)?;
    }
}

/// Points of the longest contour worth following in a picture: eight times its perimeter. Longer
/// contours are noise.
#[must_use]
pub const fn contour_capacity(size: Size) -> usize {
    16 * (size.width + size.height)
}

/// Number of spans that [`remove_shape`] needs: the maximum number of runs in a mask.
#[must_use]
pub const fn span_capacity(size: Size) -> usize {
    size.width.div_ceil(2) * size.height
}

/// Clears all pixels connected to `start` (8-connectivity). `spans` is scratch.
///
/// # Panics
///
/// If `mask` does not have `size.area()` values, `spans` has fewer than [`span_capacity`], or
/// `start` is not set.
pub fn remove_shape(mask: &mut [u8], size: Size, start: Point, spans: &mut [Span]) -> Removed {
    assert_len("mask", mask.len(), size);
    assert!(
        spans.len() >= span_capacity(size),
        "{} spans, {} are needed",
        spans.len(),
        span_capacity(size)
    );
    let mut removed = Removed {
        area: 0,
        cores: 0,
        bounds: Bounds::of(start),
    };
    // A span is erased as soon as it is found, so it is found only once and there is room for all.
    let mut n = 0;
    let mut erase = |mask: &mut [u8], x: u16, y: u16, spans: &mut [Span], n: &mut usize| {
        let row = &mut mask[usize::from(y) * size.width..][..size.width];
        let mut first = usize::from(x);
        while first > 0 && row[first - 1] != 0 {
            first -= 1;
        }
        let mut last = usize::from(x);
        while last + 1 < row.len() && row[last + 1] != 0 {
            last += 1;
        }
        removed.cores += row[first..=last].iter().filter(|&&m| m > 1).count();
        row[first..=last].fill(0);
        let span = Span {
            y,
            first: first as u16,
            last: last as u16,
        };
        removed.area += last - first + 1;
        removed.bounds = removed
            .bounds
            .with(Point { x: span.first, y })
            .with(Point { x: span.last, y });
        spans[*n] = span;
        *n += 1;
        last
    };
    assert!(
        is_set(mask, size, start, (0, 0)),
        "the shape starts at {start:?}, which is not set"
    );
    erase(mask, start.x, start.y, spans, &mut n);
    while n > 0 {
        n -= 1;
        let Span { y, first, last } = spans[n];
        for y in [y.wrapping_sub(1), y + 1] {
            if usize::from(y) >= size.height {
                continue;
            }
            let end = (usize::from(last) + 2).min(size.width);
            let mut x = usize::from(first.saturating_sub(1));
            while x < end {
                if mask[usize::from(y) * size.width + x] != 0 {
                    x = erase(mask, x as u16, y, spans, &mut n);
                }
                x += 1;
            }
        }
    }
    removed
}

/// Sets all pixels of `mask` on or inside a contour: the mask of the cut-out (section 2.2.1).
/// `mask` is a plane of `bounds.size()` whose top left pixel is that of `bounds`.
///
/// # Panics
///
/// If `mask` does not have `bounds.size().area()` values, or the contour leaves `bounds`.
pub fn fill_contour(contour: &[Point], bounds: Bounds, mask: &mut [u8]) {
    const ON: u8 = 1;
    const CROSSED: u8 = 2;
    let size = bounds.size();
    assert_len("mask", mask.len(), size);
    mask.fill(0);
    let index = |point: Point| {
        usize::from(point.y - bounds.top) * size.width + usize::from(point.x - bounds.left)
    };
    // A step between two rows crosses the upper row at the step's upper end. Pixels right of an odd
    // number of crossings are inside.
    let ends = contour.iter().zip(contour.iter().cycle().skip(1));
    for (&from, &to) in ends {
        mask[index(from)] |= ON;
        if from.y != to.y {
            mask[index(if from.y < to.y { from } else { to })] ^= CROSSED;
        }
    }
    for row in mask.chunks_exact_mut(size.width) {
        let mut crossed = 0;
        for pixel in row {
            crossed ^= *pixel & CROSSED;
            *pixel = u8::from((*pixel & ON) | crossed != 0);
        }
    }
}

/// Whether the neighbour of `at` in a direction is set. Pixels outside the picture are not.
fn is_set(mask: &[u8], size: Size, at: Point, (dx, dy): (isize, isize)) -> bool {
    let x = (at.x as isize + dx) as usize;
    let y = (at.y as isize + dy) as usize;
    x < size.width && y < size.height && mask[y * size.width + x] != 0
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::window::naive;
    use proptest::prelude::*;
    use std::{vec, vec::Vec};

    /// Parses a drawing of a mask: `#` is set, `.` is clear.
    pub(crate) fn drawing(rows: &str) -> (Size, Vec<u8>) {
        let rows: Vec<&str> = rows.lines().map(str::trim).collect();
        let size = Size {
            width: rows[0].len(),
            height: rows.len(),
        };
        (
            size,
            rows.concat().bytes().map(|c| u8::from(c == b'#')).collect(),
        )
    }

    fn contour_of(rows: &str) -> Vec<(u16, u16)> {
        let (size, mask) = drawing(rows);
        let start = next_shape(&mask, size, 0).expect("a shape is drawn");
        let mut points = [Point::default(); 64];
        let contour =
            follow_contour(&mask, size, start, &mut points).expect("the buffer is long enough");
        contour.iter().map(|p| (p.x, p.y)).collect()
    }

    #[test]
    fn an_isolated_pixel_is_a_contour_of_one_point() {
        assert_eq!(contour_of("...\n.#.\n..."), [(1, 1)]);
        assert_eq!(contour_of("#"), [(0, 0)]);
    }

    #[test]
    fn a_line_is_followed_forth_and_back() {
        assert_eq!(contour_of("###"), [(0, 0), (1, 0), (2, 0), (1, 0)]);
    }

    #[test]
    fn a_square_at_the_border_is_followed_clockwise() {
        assert_eq!(contour_of("##\n##"), [(0, 0), (1, 0), (1, 1), (0, 1)]);
    }

    #[test]
    fn a_start_that_is_passed_twice_does_not_end_the_walk() {
        // Two arms start at the first pixel; the paper's loop ends after the right one.
        let contour = contour_of(
            "..#..
             .#.#.
             #...#",
        );
        assert_eq!(
            contour,
            [
                (2, 0),
                (3, 1),
                (4, 2),
                (3, 1),
                (2, 0),
                (1, 1),
                (0, 2),
                (1, 1)
            ]
        );
    }

    #[test]
    fn a_hole_is_not_part_of_the_contour() {
        let contour = contour_of(
            "###
             #.#
             ###",
        );
        assert_eq!(contour.len(), 8);
        let (_, filled) = drawing("###\n###\n###");
        let points: Vec<Point> = contour.iter().map(|&(x, y)| Point { x, y }).collect();
        let mut mask = vec![7; 9];
        fill_contour(
            &points,
            Bounds {
                left: 0,
                top: 0,
                right: 2,
                bottom: 2,
            },
            &mut mask,
        );
        assert_eq!(mask, filled);
    }

    #[test]
    fn a_contour_that_does_not_fit_is_reported() {
        let (size, mask) = drawing("##\n##");
        let start = Point { x: 0, y: 0 };
        assert_eq!(
            follow_contour(&mask, size, start, &mut [Point::default(); 3]),
            Err(ContourTooLong)
        );
    }

    /// All pixels connected to `start`, found with a simple stack of pixels.
    fn component(mask: &[u8], size: Size, start: Point) -> Vec<u8> {
        let mut found = vec![0; size.area()];
        let mut stack = vec![start];
        while let Some(at) = stack.pop() {
            let index = usize::from(at.y) * size.width + usize::from(at.x);
            if found[index] != 0 {
                continue;
            }
            found[index] = 1;
            for (dx, dy) in DIRECTIONS {
                if is_set(mask, size, at, (dx, dy)) {
                    stack.push(Point {
                        x: (at.x as isize + dx) as u16,
                        y: (at.y as isize + dy) as u16,
                    });
                }
            }
        }
        found
    }

    /// Marks the pixels that can be reached from outside over clear pixels (4-connectivity): no
    /// contour encloses them.
    fn outside(shape: &[u8], size: Size) -> Vec<bool> {
        let mut reached = vec![false; size.area()];
        let border = (0..size.area()).filter(|i| {
            let (x, y) = (i % size.width, i / size.width);
            x == 0 || y == 0 || x + 1 == size.width || y + 1 == size.height
        });
        let mut stack: Vec<usize> = border.collect();
        while let Some(i) = stack.pop() {
            if shape[i] != 0 || core::mem::replace(&mut reached[i], true) {
                continue;
            }
            let (x, y) = (i % size.width, i / size.width);
            if x > 0 {
                stack.push(i - 1);
            }
            if x + 1 < size.width {
                stack.push(i + 1);
            }
            if y > 0 {
                stack.push(i - size.width);
            }
            if y + 1 < size.height {
                stack.push(i + size.width);
            }
        }
        reached
    }

    proptest! {
        #[test]
        fn every_shape_is_found_once_and_enclosed_by_its_contour((size, mask) in naive::planes(1)) {
            let mut left = mask.clone();
            let mut spans = vec![Span::default(); span_capacity(size)];
            let mut points = vec![Point::default(); 8 * size.area() + 8];
            let (mut from, mut area) = (0, 0);
            while let Some(start) = next_shape(&left, size, from) {
                let shape = component(&left, size, start);
                let contour = follow_contour(&left, size, start, &mut points).expect("no shape is that long").to_vec();
                let removed = remove_shape(&mut left, size, start, &mut spans);
                prop_assert_eq!(removed.area, shape.iter().map(|&p| usize::from(p)).sum::<usize>());
                area += removed.area;
                let around = contour.iter().fold(Bounds::of(start), |bounds, &p| bounds.with(p));
                prop_assert_eq!(removed.bounds, around);

                let mut filled = vec![0; removed.bounds.size().area()];
                fill_contour(&contour, removed.bounds, &mut filled);
                let mut expected = vec![0; filled.len()];
                let enclosed: Vec<u8> = outside(&shape, size).iter().map(|&o| u8::from(!o)).collect();
                crate::crop(&enclosed, size, removed.bounds, &mut expected);
                prop_assert_eq!(filled, expected);
                from = usize::from(start.y) * size.width + usize::from(start.x);
            }
            prop_assert_eq!(area, mask.iter().filter(|&&m| m != 0).count());
        }
    }
}
