//! Learns the picture of the empty floor from frames (section 2.1.1 of the paper asks for a
//! recorded one).
//!
//! It is the median of each pixel over the frames. Whatever covers a pixel for less than half of
//! the time leaves no trace, so objects may move over the floor during learning.
//!
//! # Method
//!
//! The median is found bit by bit from the highest down. A bit is set when at most half of the
//! values are below the number formed by the bits found so far and this one. For a block of pixels
//! this takes one comparison and one addition per frame and bit, without branches and without
//! sorting. Counts are bytes, so a vector register holds as many counts as pixels.
//!
//! Cost: eight passes over all frames.

/// Pixels per block.
const BLOCK: usize = 256;

/// Writes to `out` the lower median of each pixel over the frames: the value at position
/// `(n - 1) / 2` of all `n` in ascending order.
///
/// `frames` holds the planes one after the other, each as long as `out`.
///
/// # Panics
///
/// If `frames` holds no plane, more than 255, or not a whole number of them.
pub fn median_of_frames(frames: &[u8], out: &mut [u8]) {
    let area = out.len();
    assert!(
        area > 0
            && !frames.is_empty()
            && frames.len().is_multiple_of(area)
            && frames.len() / area <= 0xff,
        "{} bytes are not 1 to 255 planes of {area} pixels",
        frames.len()
    );
    // The number of values below the median is at most its position.
    let before = ((frames.len() / area - 1) / 2) as u8;
    for (block, out) in out.chunks_mut(BLOCK).enumerate() {
        let n = out.len();
        out.fill(0);
        for bit in (0..8).rev() {
            let mut below = [0u8; BLOCK];
            let mut candidate = [0u8; BLOCK];
            for (candidate, found) in candidate.iter_mut().zip(&*out) {
                *candidate = found | 1 << bit;
            }
            for plane in frames.chunks_exact(area) {
                let plane = &plane[block * BLOCK..][..n];
                for i in 0..n {
                    below[i] += u8::from(plane[i] < candidate[i]);
                }
            }
            for i in 0..n {
                if below[i] <= before {
                    out[i] = candidate[i];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use random::SplitMix64;
    use std::vec::Vec;

    #[test]
    fn an_object_that_passes_leaves_no_trace() {
        let frames = [[9, 9, 9], [200, 9, 9], [9, 200, 9], [9, 9, 200], [9, 9, 9]].concat();
        let mut floor = [0; 3];
        median_of_frames(&frames, &mut floor);
        assert_eq!(floor, [9; 3]);
    }

    proptest! {
        #[test]
        fn equals_sorting(area in 1usize..600, n in 1usize..12, seed: u32) {
            let mut random = SplitMix64(seed.into());
            let frames: Vec<u8> = (0..area * n)
                .map(|_| random.byte())
                .collect();
            let mut out = std::vec![0x5a; area];
            median_of_frames(&frames, &mut out);
            for (i, &median) in out.iter().enumerate() {
                let mut values: Vec<u8> = frames.iter().skip(i).step_by(area).copied().collect();
                values.sort_unstable();
                prop_assert_eq!(median, values[(n - 1) / 2]);
            }
        }
    }
}
