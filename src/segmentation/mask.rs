//! From pixel labels to the mask: opening, closing, and removal of lens blur (section 2.1.1 of the
//! paper).

use imgproc::Size;
use imgproc::labels::{BRIGHT, STRONG};
use imgproc::morphology::{dilate_3x3, erode_3x3, open_3x3};

/// Added to the 1 of an object pixel that differs strongly and is the centre of a 5x5 square of
/// object pixels.
const CORE: u8 = 2;

/// Writes the mask: non-zero for objects. `own` is the difference of each single pixel; the two
/// planes of `scratch` are overwritten.
pub(super) fn make_mask(
    labels: &[u8],
    own: &[u8],
    size: Size,
    mask: &mut Vec<u8>,
    [scratch, inner]: [&mut Vec<u8>; 2],
) {
    for (mask, &label) in mask.iter_mut().zip(labels) {
        *mask = u8::from(label & !STRONG >= BRIGHT);
    }
    // A certain object may be too thin for the opening, for example the rim of a small plate.
    // Between the rim and the white area there is a line as grey as the floor.
    open_3x3(mask, size, scratch);
    for (mask, &label) in mask.iter_mut().zip(labels) {
        *mask |= u8::from(label & STRONG != 0);
    }
    close_gaps(mask, size, scratch);
    open_3x3(mask, size, scratch);
    strip_blur(mask, own, size, scratch);
    erode_3x3(mask, size, scratch);
    erode_3x3(scratch, size, inner);
    for ((mask, &inside), &label) in mask.iter_mut().zip(inner.iter()).zip(labels) {
        if inside != 0 && label & STRONG != 0 {
            *mask |= CORE;
        }
    }
}

/// Closing by a 5x5 window: between the two colours of a robot there is a line that has neither.
fn close_gaps(mask: &mut Vec<u8>, size: Size, scratch: &mut Vec<u8>) {
    for step in [dilate_3x3, dilate_3x3, erode_3x3, erode_3x3] {
        step(mask, size, scratch);
        std::mem::swap(mask, scratch);
    }
}

/// Removes pixels at the border of the mask that differ by less than half of the difference of
/// their surroundings: the lens blurs an object into the floor, and its border is half-way.
fn strip_blur(mask: &mut [u8], own: &[u8], size: Size, scratch: &mut [u8]) {
    let Size { width, height } = size;
    scratch.copy_from_slice(mask);
    let before = scratch;
    for y in 2..height.saturating_sub(2) {
        for x in 2..width.saturating_sub(2) {
            let i = y * width + x;
            let border = before[i] != 0
                && (before[i - 1] & before[i + 1] & before[i - width] & before[i + width]) == 0;
            if !border {
                continue;
            }
            let max = (y - 2..=y + 2)
                .flat_map(|y| y * width + x - 2..=y * width + x + 2)
                .filter(|&i| before[i] != 0)
                .map(|i| own[i])
                .max();
            if max.is_some_and(|max| own[i] < max / 2) {
                mask[i] = 0;
            }
        }
    }
}
