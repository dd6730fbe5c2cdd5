//! The descriptor: a contour's spectrum, normalised for position, size, orientation and start point
//! (sections 2.2.2 and 2.2.3 of the paper).
//!
//! Moving a contour changes only F0. Scaling multiplies all other coefficients. Rotation by `t`
//! multiplies them by `exp(jt)`. Starting `s` samples later multiplies coefficient `k` by
//! `exp(2πjks / N)`. So with
//!
//! ```text
//! orientation = (arg F1 + arg F(N-1)) / 2      start = (arg F1 - arg F(N-1)) / 2
//! ```
//!
//! `F[k] exp(-j orientation) exp(-jk start) / abs F1` depends on none of them.
//!
//! # Differences from the paper
//!
//! * Equations 3 and 4 lack the factor 1/2: a rotation by `t` adds `t` to both angles and so `2t`
//!   to their sum. The halving causes the ambiguity of 180 degrees: if orientation and start both
//!   change by half a turn, F1 and F(N-1) stay the same. The other coefficients of even frequency
//!   then change sign; see [`matching`](crate::matching).
//! * Equation 6 multiplies coefficient `k` by `exp(jkφ)`, which is correct for frequency `k`, but
//!   the upper half of the spectrum holds the negative frequencies `k - N`. With signed frequencies
//!   any shift is exact, not only whole samples, and the distortion that the paper warns of does
//!   not occur.
//! * F0 is the mean of the samples along the contour, not the centroid of the area. Poses use the
//!   centroid ([`region`](crate::contour::region)), since it does not depend on how noise
//!   distributes the contour's length.

use crate::fft::{fft, frequency};
use crate::{Complex32, N};

/// The normalised spectrum of a contour, and what it was normalised by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Descriptor {
    /// Normalised coefficients. `[0]` is 0, `[1]` is 1, `[N - 1]` is real and not negative.
    pub coefficients: [Complex32; N],
    /// F0: mean of the samples, in pixels.
    pub mean: Complex32,
    /// Absolute value of F1: the radius in pixels for a circle.
    pub size_px: f32,
    /// Orientation in radians, known up to half a turn.
    pub orientation_rad: f32,
}

impl Descriptor {
    /// Absolute values of the coefficients.
    #[must_use]
    pub fn magnitudes(&self) -> [f32; N] {
        self.coefficients
            .map(|coefficient| libm::sqrtf(coefficient.norm_sqr()))
    }
}

/// Why a contour has no descriptor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoDescriptor {
    /// F1 is zero: the contour has no extent or runs counter-clockwise.
    NoExtent,
    /// F(N-1) is so small relative to F1 that the orientation is noise: square, disc, equilateral
    /// star.
    NoOrientation {
        /// Ratio of the absolute values of F(N-1) and F1.
        elongation: f32,
    },
}

impl Descriptor {
    /// Ratio of the absolute values of F(N-1) and F1: how well the shape shows its orientation. 0
    /// for a circle, 1 for a line.
    #[must_use]
    pub fn elongation(&self) -> f32 {
        self.coefficients[N - 1].re
    }
}

/// Normalises the spectrum of a contour that was sampled clockwise on the screen.
///
/// # Errors
///
/// [`NoDescriptor`] if size or orientation cannot be normalised. The elongation must be at least
/// `elongation_min`.
pub fn describe(samples: &[Complex32; N], elongation_min: f32) -> Result<Descriptor, NoDescriptor> {
    let mut spectrum = *samples;
    fft(&mut spectrum);
    spectrum.iter_mut().for_each(|f| *f /= N as f32);
    let mean = spectrum[0];
    let (first, last) = (spectrum[1], spectrum[N - 1]);
    let (size_px, last_size) = (first.norm(), last.norm());
    // Also catches NaN. A contour in the wrong direction has its extent in F(N-1).
    if !(size_px > 1e-6 && size_px >= last_size) {
        return Err(NoDescriptor::NoExtent);
    }
    let elongation = last_size / size_px;
    if elongation < elongation_min {
        return Err(NoDescriptor::NoOrientation { elongation });
    }
    let orientation_rad = (first.arg() + last.arg()) / 2.0;
    let start = (first.arg() - last.arg()) / 2.0;
    for (k, f) in spectrum.iter_mut().enumerate() {
        *f *= Complex32::from_polar(
            1.0 / size_px,
            -orientation_rad - frequency(k) as f32 * start,
        );
    }
    spectrum[0] = Complex32::new(0.0, 0.0);
    Ok(Descriptor {
        coefficients: spectrum,
        mean,
        size_px,
        orientation_rad,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contour::resample;
    use core::f32::consts::{PI, TAU};
    use proptest::prelude::*;
    use std::vec::Vec;

    /// An arrowhead, clockwise on the screen.
    const ARROW: [[f32; 2]; 4] = [[0.0, -10.0], [7.0, 8.0], [0.0, 4.0], [-7.0, 8.0]];

    fn moved(
        points: &[[f32; 2]],
        scale: f32,
        turn_rad: f32,
        by: [f32; 2],
        first: usize,
    ) -> Vec<[f32; 2]> {
        let (sin, cos) = libm::sincosf(turn_rad);
        let point = |[x, y]: [f32; 2]| {
            [
                scale * (cos * x - sin * y) + by[0],
                scale * (sin * x + cos * y) + by[1],
            ]
        };
        (0..points.len())
            .map(|i| point(points[(i + first) % points.len()]))
            .collect()
    }

    #[test]
    fn rotationally_symmetric_shapes_have_no_orientation() {
        let square = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]];
        let error = describe(&resample(&square), 0.1).expect_err("a square has no orientation");
        assert!(matches!(error, NoDescriptor::NoOrientation { elongation } if elongation < 1e-5));
    }

    #[test]
    fn a_counter_clockwise_contour_is_refused() {
        let mut backwards = ARROW;
        backwards.reverse();
        assert_eq!(
            describe(&resample(&backwards), 0.1),
            Err(NoDescriptor::NoExtent)
        );
        assert_eq!(
            describe(&[Complex32::new(f32::NAN, 0.0); N], 0.1),
            Err(NoDescriptor::NoExtent)
        );
    }

    #[test]
    fn size_is_the_radius_of_a_circle() {
        let circle =
            core::array::from_fn(|n| Complex32::from_polar(7.5, TAU * n as f32 / N as f32));
        let descriptor = describe(&circle, 0.0).expect("a circle has a size");
        assert!((descriptor.size_px - 7.5).abs() < 1e-5);
        assert!(descriptor.elongation() < 1e-6);
    }

    proptest! {
        #[test]
        fn position_size_orientation_and_start_are_divided_out(
            scale in 0.5f32..20.0,
            turn in -PI..PI,
            x in -500f32..500.0,
            y in -500f32..500.0,
            first in 0usize..4,
        ) {
            let reference = describe(&resample(&ARROW), 0.1).expect("an arrow has an orientation");
            let points = moved(&ARROW, scale, turn, [x, y], first);
            let descriptor = describe(&resample(&points), 0.1).expect("an arrow has an orientation");
            prop_assert!((descriptor.size_px / reference.size_px / scale - 1.0).abs() < 2e-2);

            let half_turns = (descriptor.orientation_rad - reference.orientation_rad - turn) / PI;
            prop_assert!((half_turns - half_turns.round()).abs() < 0.02, "{half_turns} half turns off");
            // Half a turn off: coefficients of even frequency change sign. The start is between two
            // samples of the reference, so sharp corners are sampled beside their tips.
            let sign = if (half_turns.round() as i32) % 2 == 0 { 1.0 } else { -1.0 };
            for k in 1..N {
                let expected = reference.coefficients[k] * if k % 2 == 0 { sign } else { 1.0 };
                let error = (descriptor.coefficients[k] - expected).norm();
                prop_assert!(error < 0.03, "coefficient {k} is {error} off");
            }
        }
    }
}
