//! Limits of the image size.

use imgproc::Size;

/// Maximum side of an image, in pixels. Every source rejects larger sizes before allocating, and no
/// product of two sides and a few bytes per pixel overflows.
pub const MAX_SIDE: usize = 16_384;

/// Maximum number of pixels, 8192x8192. A header of a few bytes may claim any size, and the program
/// uses some 100 bytes per pixel.
pub const AREA_MAX: usize = 1 << 26;

/// Whether a size is within the limits.
pub(crate) const fn size_is_possible(size: Size) -> bool {
    let Size { width, height } = size;
    width >= 1 && width <= MAX_SIDE && height >= 1 && height <= MAX_SIDE && size.area() <= AREA_MAX
}
