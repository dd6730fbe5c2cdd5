//! Pixels in; masks, thresholds, shapes and contours out (sections 2.1 and 2.2.1 of the paper).
#![no_std]
#![forbid(unsafe_code)]

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
}
