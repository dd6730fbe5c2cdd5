//! The 3x3 window that median, threshold, erosion and dilation share.
//!
//! All four first combine the three pixels of a column and then three neighbouring columns. Done in blocks of a few dozen
//! columns that stay in registers and the first cache level, both steps are plain loops over arrays, which the compiler
//! turns into vector instructions.
//!
//! Outside the picture the nearest pixel of the border counts. For a mask that means: what lies outside neither erodes nor
//! dilates.

use crate::{Size, assert_len};

/// Columns of one block.
const BLOCK: usize = 128;

/// Writes to each pixel of `out` what `across` makes of its three columns, each of which `down` made of three pixels.
///
/// `down` gets the pixels above, at and below; `across` the columns left, at and right.
///
/// # Panics
///
/// When a slice has not `size.area()` values.
pub(crate) fn map_3x3<Column: Copy + Default>(
    plane: &[u8],
    size: Size,
    out: &mut [u8],
    down: impl Fn(u8, u8, u8) -> Column,
    across: impl Fn(Column, Column, Column) -> u8,
) {
    assert_len("plane", plane.len(), size);
    assert_len("out", out.len(), size);
    let Size { width, height } = size;
    if width == 0 {
        return;
    }
    let row = |y: usize| &plane[y * width..(y + 1) * width];
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        let above = row(y.saturating_sub(1));
        let here = row(y);
        let below = row((y + 1).min(height - 1));
        // columns[i] belongs to pixel start + i - 1: one more on either side of the block.
        let mut columns = [Column::default(); BLOCK + 2];
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            let start = block * BLOCK;
            let n = out.len();
            let column = |x: usize| down(above[x], here[x], below[x]);
            columns[0] = column(start.saturating_sub(1));
            columns[n + 1] = column((start + n).min(width - 1));
            let (above, here, below) = (
                &above[start..][..n],
                &here[start..][..n],
                &below[start..][..n],
            );
            for (i, column) in columns[1..=n].iter_mut().enumerate() {
                *column = down(above[i], here[i], below[i]);
            }
            let (left, mid, right) = (&columns[..n], &columns[1..=n], &columns[2..n + 2]);
            for (i, out) in out.iter_mut().enumerate() {
                *out = across(left[i], mid[i], right[i]);
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod naive {
    //! The window spelled out: the reference for the tests of everything that uses it.
    use super::*;
    use std::vec::Vec;

    /// What `pixel` makes of the nine values around each pixel, the border repeated outwards.
    pub(crate) fn map_3x3(plane: &[u8], size: Size, pixel: impl Fn([u8; 9]) -> u8) -> Vec<u8> {
        let at = |x: isize, y: isize| {
            let x = x.clamp(0, size.width as isize - 1) as usize;
            let y = y.clamp(0, size.height as isize - 1) as usize;
            plane[y * size.width + x]
        };
        (0..size.area() as isize)
            .map(|i| {
                let (x, y) = (i % size.width as isize, i / size.width as isize);
                pixel(core::array::from_fn(|k| {
                    at(x + k as isize % 3 - 1, y + k as isize / 3 - 1)
                }))
            })
            .collect()
    }

    /// Planes of all small sizes, and some wider than a block.
    pub(crate) fn planes(max: u8) -> impl proptest::strategy::Strategy<Value = (Size, Vec<u8>)> {
        use proptest::prelude::*;
        prop_oneof![(1usize..9, 1usize..9), (120usize..140, 1usize..4)].prop_flat_map(
            move |(width, height)| {
                let size = Size { width, height };
                (Just(size), proptest::collection::vec(0..=max, size.area()))
            },
        )
    }
}
