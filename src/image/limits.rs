//! How large a picture may be.

use imgproc::Size;

/// Longest side of a picture, in pixels. Larger sizes are refused by every source before anything is allocated, and no
/// product of two sides and a few bytes a pixel overflows.
pub const MAX_SIDE: usize = 16_384;

/// Most pixels of a picture, 8192x8192. A header of a few bytes may claim any size, and the program takes some 100 bytes a pixel.
pub const AREA_MAX: usize = 1 << 26;

/// Whether a picture may have this size.
pub(crate) const fn size_is_possible(size: Size) -> bool {
    let Size { width, height } = size;
    width >= 1 && width <= MAX_SIDE && height >= 1 && height <= MAX_SIDE && size.area() <= AREA_MAX
}
