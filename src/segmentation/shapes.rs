//! The shapes of a mask. Each contour is traced once (section 2.1.2 of the paper) and used by all
//! later stages.

use std::ops::Range;

use imgproc::contour::{
    Removed, Span, contour_capacity, follow_contour, next_shape, remove_shape, span_capacity,
};
use imgproc::{Bounds, Point, Size};

/// Maximum number of shapes per frame; the excess is counted.
pub(crate) const MAX_SHAPES: usize = scene::MAX_OBJECTS;

/// One shape.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape<'a> {
    /// Clockwise on the screen, starting with the first pixel in reading order.
    pub(crate) contour: &'a [Point],
    /// The bounding rectangle.
    pub(crate) bounds: Bounds,
    /// It may continue in an area where the floor is unknown.
    pub(crate) is_cut: bool,
}

/// The shapes of one mask, in reading order.
#[derive(Debug)]
pub(crate) struct Shapes {
    size: Size,
    kept: Vec<Kept>,
    /// The contours of all kept shapes, concatenated.
    points: Vec<Point>,
    n_points: usize,
    overflow: u32,
    spans: Vec<Span>,
}

/// A shape, with its contour as a range of all points.
#[derive(Debug)]
struct Kept {
    contour: Range<usize>,
    bounds: Bounds,
    is_cut: bool,
}

/// A shape that was found, before the decision to keep it.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) start: Point,
    pub(super) removed: Removed,
    /// Points of its contour; `None` if they did not fit.
    contour: Option<Range<usize>>,
}

/// State of a search, which consumes its mask.
#[derive(Debug)]
pub(super) struct Search {
    from: usize,
}

impl Shapes {
    /// Allocates for masks of one size.
    pub(super) fn new(size: Size) -> Self {
        Self {
            size,
            kept: Vec::with_capacity(MAX_SHAPES),
            points: vec![Point::default(); size.area().max(contour_capacity(size))],
            n_points: 0,
            overflow: 0,
            spans: vec![Span::default(); span_capacity(size)],
        }
    }

    /// The kept shapes.
    pub(crate) fn iter(&self) -> impl Iterator<Item = Shape<'_>> {
        self.kept.iter().map(|kept| Shape {
            contour: &self.points[kept.contour.clone()],
            bounds: kept.bounds,
            is_cut: kept.is_cut,
        })
    }

    /// Number of shapes that did not fit, or whose contour was too long; those are noise.
    pub(crate) fn overflow(&self) -> u32 {
        self.overflow
    }

    /// Removes all shapes and starts a search.
    pub(super) fn search(&mut self) -> Search {
        self.clear();
        Search { from: 0 }
    }

    pub(super) fn clear(&mut self) {
        self.kept.clear();
        self.n_points = 0;
        self.overflow = 0;
    }

    /// Removes the next shape from the mask and returns it.
    pub(super) fn next(&mut self, search: &mut Search, mask: &mut [u8]) -> Option<Found> {
        let start = next_shape(mask, self.size, search.from)?;
        search.from = usize::from(start.y) * self.size.width + usize::from(start.x);
        let free = &mut self.points[self.n_points..];
        let room = free.len().min(contour_capacity(self.size));
        let contour = follow_contour(mask, self.size, start, &mut free[..room]).ok();
        Some(Found {
            start,
            contour: contour.map(|contour| self.n_points..self.n_points + contour.len()),
            removed: remove_shape(mask, self.size, start, &mut self.spans),
        })
    }

    /// The contour of the shape found last; `None` if it is too long.
    pub(super) fn contour(&self, found: &Found) -> Option<&[Point]> {
        found.contour.clone().map(|range| &self.points[range])
    }

    /// Keeps the shape found last.
    pub(super) fn keep(&mut self, found: Found, is_cut: bool) {
        match found.contour {
            Some(contour) if self.kept.len() < MAX_SHAPES => {
                self.n_points = contour.end;
                self.kept.push(Kept {
                    contour,
                    bounds: found.removed.bounds,
                    is_cut,
                });
            }
            _ => self.overflow += 1,
        }
    }

    /// Removes from `mask` a shape that was found in a copy of it.
    pub(super) fn remove(&mut self, found: &Found, mask: &mut [u8]) {
        remove_shape(mask, self.size, found.start, &mut self.spans);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size {
        width: 8,
        height: 4,
    };

    /// All shapes of at least `area_min` pixels in a mask drawn with `#`.
    fn shapes(rows: [&str; 4], area_min: usize) -> Shapes {
        let mut mask: Vec<u8> = rows
            .iter()
            .flat_map(|row| row.bytes().map(|b| u8::from(b == b'#')))
            .collect();
        let mut shapes = Shapes::new(SIZE);
        let mut search = shapes.search();
        while let Some(found) = shapes.next(&mut search, &mut mask) {
            if found.removed.area >= area_min {
                shapes.keep(found, false);
            }
        }
        assert!(mask.iter().all(|&pixel| pixel == 0), "the mask is used up");
        shapes
    }

    #[test]
    fn shapes_come_in_reading_order_with_their_own_contours() {
        let shapes = shapes(["##....##", "##....##", "........", "..#####."], 1);
        let found: Vec<_> = shapes
            .iter()
            .map(|shape| (shape.contour.len(), shape.bounds.left, shape.bounds.bottom))
            .collect();
        // The contour of a line of five pixels runs there and back.
        assert_eq!(found, [(4, 0, 1), (4, 6, 1), (8, 2, 3)]);
        assert_eq!(shapes.overflow(), 0);
    }

    #[test]
    fn a_shape_that_is_not_kept_leaves_its_room_to_the_next() {
        let shapes = shapes(["##....#.", "##......", "........", "..#####."], 4);
        let contours: Vec<_> = shapes.iter().map(|shape| shape.contour).collect();
        assert_eq!(contours.len(), 2);
        assert_eq!(contours[1][0], Point { x: 2, y: 3 });
    }

    #[test]
    fn more_shapes_than_there_is_room_for_are_counted() {
        let size = Size {
            width: 4 * MAX_SHAPES,
            height: 3,
        };
        let mut mask = vec![0; size.area()];
        mask.iter_mut()
            .take(size.width)
            .step_by(2)
            .for_each(|pixel| *pixel = 1);
        let mut shapes = Shapes::new(size);
        let mut search = shapes.search();
        while let Some(found) = shapes.next(&mut search, &mut mask) {
            shapes.keep(found, false);
        }
        assert_eq!(shapes.iter().count(), MAX_SHAPES);
        assert_eq!(shapes.overflow() as usize, MAX_SHAPES);
    }
}
