//! Pixels in; masks, thresholds, shapes and contours out (sections 2.1 and 2.2.1 of the paper).
//!
//! The modules in the order in which a frame passes through them:
//!
//! 1. [`background`] learns the picture of the empty floor from frames in which objects may move,
//!    and [`noise`] learns how much it changes from frame to frame;
//! 2. [`median`] removes the noise of single pixels;
//! 3. [`light`] measures the brightness of the light, [`difference`] compares a frame with the
//!    floor in that light, in units of noise;
//! 4. [`labels`] separates objects, shadows and floor, [`texture`] decides where the difference
//!    alone cannot;
//! 5. [`morphology`] removes specks from the mask and closes its gaps;
//! 6. [`contour`] finds the shapes in the mask and follows their contours;
//! 7. [`split`] divides the pixels of one shape into light and dark;
//! 8. [`isoline`] follows the border between them with subpixel precision;
//! 9. [`fit`] aligns the picture of a known shape with all pixels, which is more precise still.
//!
//! [`tone`] tells light from grey levels for the last three.
//!
//! All are plain functions over borrowed slices: inputs, then outputs and scratch, then settings.
//! Nothing here allocates, keeps state between calls, or knows about cameras and markers.
//!
//! # Pictures
//!
//! A plane is a slice of [`Size::area`] values, row by row from the top; x points right, y down,
//! and the centre of the top left pixel is (0, 0). A mask is a plane of bytes, 1 for object and 0
//! for floor. Slices of any other length are the caller's mistake and cause a panic.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod background;
pub mod contour;
pub mod difference;
pub mod fit;
pub mod isoline;
pub mod labels;
pub mod light;
pub mod median;
pub mod morphology;
pub mod noise;
pub mod split;
pub mod texture;
pub mod tone;

mod window;

/// Width and height of a picture, in pixels. Pixel (x, y) of a plane is at index `y * width + x`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Size {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Size {
    /// Number of pixels.
    #[must_use]
    pub const fn area(self) -> usize {
        self.width * self.height
    }

    /// The bounds of a whole picture of this size, which must not be empty.
    #[must_use]
    pub const fn bounds(self) -> Bounds {
        Bounds {
            left: 0,
            top: 0,
            right: (self.width - 1) as u16,
            bottom: (self.height - 1) as u16,
        }
    }
}

/// A pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Point {
    /// Column, from the left.
    pub x: u16,
    /// Row, from the top.
    pub y: u16,
}

/// A rectangle of pixels, borders inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Bounds {
    /// Leftmost column.
    pub left: u16,
    /// Topmost row.
    pub top: u16,
    /// Rightmost column.
    pub right: u16,
    /// Bottom row.
    pub bottom: u16,
}

impl Bounds {
    /// The rectangle of one pixel.
    #[must_use]
    pub const fn of(point: Point) -> Self {
        Self {
            left: point.x,
            top: point.y,
            right: point.x,
            bottom: point.y,
        }
    }

    /// The smallest rectangle that contains this one and `point`.
    #[must_use]
    pub fn with(self, point: Point) -> Self {
        Self {
            left: self.left.min(point.x),
            top: self.top.min(point.y),
            right: self.right.max(point.x),
            bottom: self.bottom.max(point.y),
        }
    }

    /// The same rectangle with `margin` more pixels on each side, limited to the picture.
    #[must_use]
    pub fn grown(self, margin: u16, size: Size) -> Self {
        Self {
            left: self.left.saturating_sub(margin),
            top: self.top.saturating_sub(margin),
            right: self.right.saturating_add(margin).min(size.width as u16 - 1),
            bottom: self
                .bottom
                .saturating_add(margin)
                .min(size.height as u16 - 1),
        }
    }

    /// The square with this centre and `half` pixels to each side, clipped to the picture.
    #[must_use]
    pub fn around([x, y]: [f64; 2], half: f64, size: Size) -> Self {
        let cut = |at: f64, length: usize| libm::round(at).clamp(0.0, (length - 1) as f64) as u16;
        Self {
            left: cut(x - half, size.width),
            top: cut(y - half, size.height),
            right: cut(x + half, size.width),
            bottom: cut(y + half, size.height),
        }
    }

    /// The same rectangle, moved by `right` columns and `down` rows.
    #[must_use]
    pub const fn moved(self, right: u16, down: u16) -> Self {
        Self {
            left: self.left + right,
            top: self.top + down,
            right: self.right + right,
            bottom: self.bottom + down,
        }
    }

    /// Number of columns and rows.
    #[must_use]
    pub fn size(self) -> Size {
        Size {
            width: usize::from(self.right - self.left) + 1,
            height: usize::from(self.bottom - self.top) + 1,
        }
    }
}

/// Copies a rectangle of a plane.
///
/// # Panics
///
/// If `plane` does not have `size.area()` values, `out` not `bounds.size().area()`, or the
/// rectangle exceeds the plane.
pub fn crop<T: Copy>(plane: &[T], size: Size, bounds: Bounds, out: &mut [T]) {
    assert_len("plane", plane.len(), size);
    let cut = bounds.size();
    assert_len("out", out.len(), cut);
    for (y, row) in out.chunks_exact_mut(cut.width).enumerate() {
        let start = (usize::from(bounds.top) + y) * size.width + usize::from(bounds.left);
        row.copy_from_slice(&plane[start..start + cut.width]);
    }
}

/// The check that all functions share: a slice matches its size.
#[track_caller]
fn assert_len(name: &str, len: usize, size: Size) {
    assert!(
        len == size.area(),
        "{name} has {len} values, {} x {} pixels were announced",
        size.width,
        size.height
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crop_takes_the_rectangle() {
        let size = Size {
            width: 4,
            height: 3,
        };
        let plane = [0, 1, 2, 3, 10, 11, 12, 13, 20, 21, 22, 23];
        let bounds = Bounds::of(Point { x: 1, y: 1 }).with(Point { x: 2, y: 2 });
        let mut out = [0; 4];
        crop(&plane, size, bounds, &mut out);
        assert_eq!(out, [11, 12, 21, 22]);
    }

    #[test]
    fn bounds_grow_only_to_the_border() {
        let size = Size {
            width: 5,
            height: 4,
        };
        let grown = Bounds::of(Point { x: 1, y: 3 }).grown(2, size);
        assert_eq!(
            grown,
            Bounds {
                left: 0,
                top: 1,
                right: 3,
                bottom: 3
            }
        );
    }
}
