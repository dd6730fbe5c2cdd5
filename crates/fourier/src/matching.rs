//! Comparison with references (section 2.2.3 of the paper).
//!
//! By Parseval's theorem, the squared distance between the points of two normalised contours is
//! [`N`] times that between their coefficients. So the mean over the points is computed from the
//! coefficients, without an inverse transform.
//!
//! The orientation of a descriptor is known up to half a turn. Half a turn of orientation and start
//! point only changes the sign of the coefficients of even frequency, so one pass gives the
//! distances to a reference and to the reference rotated by 180 degrees.
//!
//! # Differences from the paper
//!
//! The paper takes the orientation from F1 and F(N-1) alone, which hold only a small part of the
//! information. Here, once the reference is known, rotation and shift of the start point are fitted
//! over all coefficients (two unknowns, least squares, Gauss-Newton). The distance is the residual
//! of the fit.

use crate::descriptor::Descriptor;
use crate::fft::frequency;
use crate::{Complex32, N, wrapped};

/// Rounds of the fit. A third would change the orientation by less than a thousandth of a degree.
const FIT_ROUNDS: usize = 2;

/// Result of comparing a descriptor with one reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Mean squared distance between the points of the contours, in units of the squared size.
    pub distance: f32,
    /// Orientation of the contour minus that of the reference, in radians, within (-π, π].
    pub turn_rad: f32,
}

/// Compares a descriptor with one reference, upright and rotated by 180 degrees, and returns the
/// nearer one.
#[must_use]
pub fn compare(descriptor: &Descriptor, reference: &Descriptor) -> Match {
    let [upright, turned] = distances(descriptor, reference);
    compare_one_way(descriptor, reference, turned < upright)
}

/// Compares a descriptor with one reference, upright and rotated by 180 degrees.
#[must_use]
pub fn compare_both_ways(descriptor: &Descriptor, reference: &Descriptor) -> [Match; 2] {
    [false, true].map(|half_turn| compare_one_way(descriptor, reference, half_turn))
}

fn compare_one_way(descriptor: &Descriptor, reference: &Descriptor, half_turn: bool) -> Match {
    let (turn, distance) = fit(&descriptor.coefficients, &reference.coefficients, half_turn);
    let half = if half_turn {
        core::f32::consts::PI
    } else {
        0.0
    };
    Match {
        distance,
        turn_rad: wrapped(descriptor.orientation_rad - reference.orientation_rad + half + turn),
    }
}

/// Lower bound of the distance over all rotations and shifts of the start point, from the
/// [magnitudes](Descriptor::magnitudes) of two descriptors: both change only phases.
#[must_use]
pub fn min_distance(a: &[f32; N], b: &[f32; N]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Mean squared distance between the points of two normalised contours, and the same with the
/// second one rotated by 180 degrees.
#[must_use]
pub fn distances(a: &Descriptor, b: &Descriptor) -> [f32; 2] {
    let (mut odd, mut even, mut even_turned) = (0.0, 0.0, 0.0);
    for k in 1..N {
        let (a, b) = (a.coefficients[k], b.coefficients[k]);
        if k % 2 == 1 {
            odd += (a - b).norm_sqr();
        } else {
            even += (a - b).norm_sqr();
            even_turned += (a + b).norm_sqr();
        }
    }
    [odd + even, odd + even_turned]
}

/// Fits a small rotation and a small shift of the start point that map `reference` onto
/// `coefficients`. Returns the rotation and the mean squared distance that remains.
fn fit(coefficients: &[Complex32; N], reference: &[Complex32; N], half_turn: bool) -> (f32, f32) {
    let target = |k: usize| {
        if half_turn && k.is_multiple_of(2) {
            -reference[k]
        } else {
            reference[k]
        }
    };
    let (mut turn, mut shift) = (0.0, 0.0);
    let mut left = 0.0;
    for round in 0..=FIT_ROUNDS {
        // Derivatives of target * exp(j (turn + frequency * shift)): itself times j and j *
        // frequency.
        let (mut tt, mut ts, mut ss, mut tr, mut sr) = (0.0, 0.0, 0.0, 0.0, 0.0);
        left = 0.0;
        let phases = phases(turn, shift);
        for (k, coefficient) in coefficients.iter().enumerate().skip(1) {
            let f = frequency(k) as f32;
            let model = target(k) * phases[k];
            let residual = coefficient - model;
            let power = model.norm_sqr();
            // Real part of conj(j * model) * residual.
            let along = (model.conj() * residual).im;
            tt += power;
            ts += power * f;
            ss += power * f * f;
            tr += along;
            sr += along * f;
            left += residual.norm_sqr();
        }
        let determinant = tt * ss - ts * ts;
        if round == FIT_ROUNDS || determinant <= f32::EPSILON {
            break;
        }
        turn += (tr * ss - sr * ts) / determinant;
        shift += (sr * tt - tr * ts) / determinant;
    }
    (turn, left)
}

/// `exp(j (turn + frequency * shift))` for each coefficient, computed from its neighbour's.
fn phases(turn: f32, shift: f32) -> [Complex32; N] {
    let step = Complex32::from_polar(1.0, shift);
    let mut phases = [Complex32::from_polar(1.0, turn); N];
    for k in (1..N).take_while(|&k| frequency(k) > 0) {
        phases[k] = phases[k - 1] * step;
    }
    for k in (1..N).rev().take_while(|&k| frequency(k) < 0) {
        phases[k] = phases[(k + 1) % N] * step.conj();
    }
    phases
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contour::resample;
    use crate::descriptor::describe;
    use crate::fft::inverse_fft;
    use core::f32::consts::PI;
    use proptest::prelude::*;

    /// A half disc: clockwise on the screen, flat side left.
    fn half_disc(turn_rad: f32, radius: f32) -> Descriptor {
        let points: std::vec::Vec<[f32; 2]> = (0..=60)
            .map(|i| {
                let angle = -PI / 2.0 + PI * i as f32 / 60.0 + turn_rad;
                [
                    50.0 + radius * libm::cosf(angle),
                    60.0 + radius * libm::sinf(angle),
                ]
            })
            .collect();
        describe(&resample(&points), 0.05).expect("half a disc has an orientation")
    }

    fn triangle() -> Descriptor {
        describe(&resample(&[[0.0, -9.0], [4.0, 5.0], [-4.0, 5.0]]), 0.05).expect("it is long")
    }

    #[test]
    fn the_same_shape_is_near_and_another_is_not() {
        let reference = half_disc(0.0, 10.0);
        assert!(compare(&half_disc(1.0, 30.0), &reference).distance < 1e-4);
        assert!(compare(&triangle(), &reference).distance > 1e-2);
    }

    proptest! {
        #[test]
        fn the_turn_is_found_over_the_full_circle(turn in -PI..PI, radius in 2f32..80.0) {
            let found = compare(&half_disc(turn, radius), &half_disc(0.0, 10.0));
            prop_assert!(wrapped(found.turn_rad - turn).abs() < 0.01, "{} instead of {turn}", found.turn_rad);
        }

        #[test]
        fn distances_are_those_of_the_points(turn in -PI..PI) {
            let points = |d: &Descriptor, sign: f32| {
                let mut c = d.coefficients;
                c.iter_mut().skip(2).step_by(2).for_each(|f| *f *= sign);
                inverse_fft(&mut c);
                c
            };
            let (a, b) = (half_disc(turn, 10.0), triangle());
            for (i, sign) in [1.0, -1.0].into_iter().enumerate() {
                let squares = points(&a, 1.0).into_iter().zip(points(&b, sign)).map(|(a, b)| (a - b).norm_sqr());
                let mean = squares.sum::<f32>() / N as f32;
                prop_assert!((distances(&a, &b)[i] - mean).abs() < 1e-4);
            }
        }

        #[test]
        fn no_distance_is_less_than_the_minimum(
            points in proptest::collection::vec((0f32..90.0, 0f32..90.0), 3..9),
        ) {
            let points: std::vec::Vec<[f32; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
            let Ok(a) = describe(&resample(&points), 0.05) else { return Ok(()) };
            for b in [triangle(), half_disc(1.0, 20.0)] {
                let min = min_distance(&a.magnitudes(), &b.magnitudes());
                for found in compare_both_ways(&a, &b) {
                    prop_assert!(found.distance >= min - 1e-4 * (1.0 + min));
                }
            }
            prop_assert!(min_distance(&a.magnitudes(), &a.magnitudes()) < 1e-9);
        }
    }
}
