//! The 3x3 window shared by median, threshold, erosion and dilation.
//!
//! All four first combine the three pixels of a column and then three neighbouring columns. In
//! blocks of a few hundred columns that stay in the L1 cache, both steps are plain loops over
//! arrays, which the compiler vectorises. The three values of a column must be in three arrays: an
//! array of triples is not vectorised.
//!
//! Outside the picture the nearest border pixel is used. For a mask this means that pixels outside
//! neither erode nor dilate.

use crate::{Size, assert_len};

/// Pixels per block.
pub(crate) const BLOCK: usize = 256;

/// A block with one more column on each side.
pub(crate) const PADDED: usize = BLOCK + 2;

/// Calls `work` with each block of `out` and the rows above, at and below it. Each row has
/// `out.len() + 2` pixels: one more on each side.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub(crate) fn for_each_block<Pixel: Copy + Default, Out>(
    plane: &[Pixel],
    size: Size,
    out: &mut [Out],
    mut work: impl FnMut([&[Pixel]; 3], &mut [Out]),
) {
    assert_len("plane", plane.len(), size);
    assert_len("out", out.len(), size);
    let Size { width, height } = size;
    if width == 0 {
        return;
    }
    let mut padded = [[Pixel::default(); PADDED]; 3];
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        let rows = [y.saturating_sub(1), y, (y + 1).min(height - 1)];
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            let (start, n) = (block * BLOCK, out.len());
            for (padded, row) in padded.iter_mut().zip(rows) {
                let row = &plane[row * width..][..width];
                padded[0] = row[start.saturating_sub(1)];
                padded[1..=n].copy_from_slice(&row[start..start + n]);
                padded[n + 1] = row[(start + n).min(width - 1)];
            }
            let [above, here, below] = &padded;
            work([&above[..n + 2], &here[..n + 2], &below[..n + 2]], out);
        }
    }
}

/// For each pixel, combines three columns with `across`, each of them combined from three pixels
/// with `down`.
///
/// # Panics
///
/// If a slice does not have `size.area()` values.
pub(crate) fn map_3x3<Pixel: Copy + Default, Column: Copy + Default, Out>(
    plane: &[Pixel],
    size: Size,
    out: &mut [Out],
    down: impl Fn(Pixel, Pixel, Pixel) -> Column,
    across: impl Fn(Column, Column, Column) -> Out,
) {
    let mut columns = [Column::default(); PADDED];
    for_each_block(plane, size, out, |[above, here, below], out| {
        let n = out.len();
        let columns = &mut columns[..n + 2];
        for (i, column) in columns.iter_mut().enumerate() {
            *column = down(above[i], here[i], below[i]);
        }
        let (left, mid, right) = (&columns[..n], &columns[1..=n], &columns[2..]);
        for (i, out) in out.iter_mut().enumerate() {
            *out = across(left[i], mid[i], right[i]);
        }
    });
}

#[cfg(test)]
pub(crate) mod naive {
    //! A naive version of the window: the reference for the tests of everything that uses it.
    use super::*;
    use std::vec::Vec;

    /// Applies `pixel` to the nine values around each pixel, with the border repeated outwards.
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
        prop_oneof![(1usize..9, 1usize..9), (250usize..264, 1usize..4)].prop_flat_map(
            move |(width, height)| {
                let size = Size { width, height };
                (Just(size), proptest::collection::vec(0..=max, size.area()))
            },
        )
    }
}
