//! Contours of shapes that are seen at an angle.
//!
//! At an angle, a small shape is an affine picture of itself. [`normalise`] divides out everything
//! but a rotation: it moves the centroid of the area to zero, and maps the second moments of the
//! area to those of a disc. Two pictures of one shape then differ by a rotation and the start
//! point, which [`align`] finds over the full circle: a normalised contour has no orientation of
//! its own.
//!
//! A descriptor ([`describe`](crate::descriptor::describe)) distinguishes more shapes, because it
//! does not ignore how long they are. This is for those that it does not recognise.

use crate::contour::{edges, region, resample_mapped};
use crate::fft::{fft, inverse_fft};
use crate::{Complex32, N};

/// A normalised contour, and what it was normalised by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normalised {
    /// Spectrum of the contour, divided by [`N`]; `[0]` is 0.
    pub coefficients: [Complex32; N],
    /// Centroid of the area, pixels.
    pub centre: [f32; 2],
    /// From the normalised contour to pixels from the centre: a symmetric matrix.
    pub to_pixels: [[f32; 2]; 2],
}

impl Normalised {
    /// Absolute values of the coefficients. Neither a rotation nor the start point changes them, so
    /// that [`min_distance`](crate::matching::min_distance) gives a bound of [`align`]'s.
    #[must_use]
    pub fn magnitudes(&self) -> [f32; N] {
        self.coefficients.map(|c| libm::sqrtf(c.norm_sqr()))
    }
}

/// The rotation between two normalised contours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aligned {
    /// Mean squared distance between their points, where a disc has a radius of 1.
    pub distance: f32,
    /// From the reference to the contour, radians.
    pub turn_rad: f32,
}

/// Normalises a contour, which runs clockwise on the screen. `None` if it encloses no area.
#[must_use]
pub fn normalise(points: &[[f32; 2]]) -> Option<Normalised> {
    if points.len() < 3 {
        return None;
    }
    let region = region(points);
    let [x0, y0] = region.centre;
    let (mut xx, mut xy, mut yy) = (0.0f64, 0.0f64, 0.0f64);
    for (a, b) in edges(points) {
        let (ax, ay) = (f64::from(a[0] - x0), f64::from(a[1] - y0));
        let (bx, by) = (f64::from(b[0] - x0), f64::from(b[1] - y0));
        let cross = ax * by - bx * ay;
        xx += cross * (ax * ax + ax * bx + bx * bx);
        xy += cross * (2.0 * ax * ay + ax * by + bx * ay + 2.0 * bx * by);
        yy += cross * (ay * ay + ay * by + by * by);
    }
    // A disc of radius 1 has a mean square of 1/4 along each axis.
    let scale = 4.0 / f64::from(region.area);
    let [xx, xy, yy] = [xx * scale / 12.0, xy * scale / 24.0, yy * scale / 12.0];
    let determinant = xx * yy - xy * xy;
    // Also catches NaN.
    if !(region.area > 0.0 && determinant > 1e-6) {
        return None;
    }
    // The square root of a symmetric matrix.
    let root = libm::sqrt(determinant);
    let per_trace = 1.0 / libm::sqrt(xx + yy + 2.0 * root);
    let [a, b, d] = [
        (xx + root) * per_trace,
        xy * per_trace,
        (yy + root) * per_trace,
    ];
    let [inverse_a, inverse_b, inverse_d] = [d / root, -b / root, a / root].map(|c| c as f32);
    let mut coefficients = resample_mapped(points, |[x, y]| {
        let (x, y) = (x - x0, y - y0);
        [inverse_a * x + inverse_b * y, inverse_b * x + inverse_d * y]
    });
    fft(&mut coefficients);
    coefficients.iter_mut().for_each(|f| *f /= N as f32);
    coefficients[0] = Complex32::new(0.0, 0.0);
    let [a, b, d] = [a, b, d].map(|c| c as f32);
    Some(Normalised {
        coefficients,
        centre: region.centre,
        to_pixels: [[a, b], [b, d]],
    })
}

/// Maximum number of rotations of [`align`].
pub const ROTATIONS: usize = 3;

/// Finds the rotations, with their start points, for which a contour is near to a reference: the
/// nearest one first, then other local minima of the distance. Shapes may have several: all
/// triangles become equilateral.
#[must_use]
pub fn align(contour: &Normalised, reference: &Normalised) -> [Option<Aligned>; ROTATIONS] {
    let mut products = [Complex32::new(0.0, 0.0); N];
    let mut power = 0.0;
    for (product, (c, r)) in products
        .iter_mut()
        .zip(contour.coefficients.iter().zip(&reference.coefficients))
    {
        *product = c * r.conj();
        power += c.norm_sqr() + r.norm_sqr();
    }
    // The correlation for a start point `s` samples later: sum of products[k] exp(2πjks / N).
    let mut correlations = products;
    inverse_fft(&mut correlations);
    let norms = correlations.map(|c| c.norm_sqr());
    let mut maxima = [None::<usize>; ROTATIONS];
    for s in 0..N {
        let is_maximum = norms[s] >= norms[(s + N - 1) % N] && norms[s] > norms[(s + 1) % N];
        let less = |kept: &Option<usize>| kept.is_none_or(|kept| norms[kept] < norms[s]);
        if let Some(place) = maxima.iter().position(less).filter(|_| is_maximum) {
            maxima[place..].rotate_right(1);
            maxima[place] = Some(s);
        }
    }
    maxima.map(|s| {
        let correlation = maximum(&products, s? as f32);
        Some(Aligned {
            distance: (power - 2.0 * correlation.norm()).max(0.0),
            turn_rad: correlation.arg(),
        })
    })
}

/// The correlation at its maximum near a start point: that of a parabola through three points,
/// twice.
fn maximum(products: &[Complex32; N], mut s: f32) -> Complex32 {
    // For every frequency the phase of the one before, turned by a step.
    let at = |s: f32| -> Complex32 {
        let step = Complex32::from_polar(1.0, core::f32::consts::TAU * s / N as f32);
        let (mut phase, mut sum) = (Complex32::new(1.0, 0.0), products[0]);
        for k in 1..=N / 2 {
            phase *= step;
            sum += products[k] * phase;
            if k < N / 2 {
                sum += products[N - k] * phase.conj();
            }
        }
        sum
    };
    for apart in [1.0, 0.25] {
        let [before, here, after] = [s - apart, s, s + apart].map(|s| at(s).norm());
        let bend = before + after - 2.0 * here;
        if bend < -1e-9 {
            s += (0.5 * apart * (before - after) / bend).clamp(-apart, apart);
        }
    }
    at(s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::min_distance;
    use crate::wrapped;
    use core::f32::consts::PI;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// A flag on its pole.
    const FLAG: [[f32; 2]; 7] = [
        [-4.0, -10.0],
        [8.0, -10.0],
        [8.0, -1.0],
        [1.0, -1.0],
        [1.0, 10.0],
        [-4.0, 10.0],
        [-4.0, 0.0],
    ];

    fn mapped(matrix: [[f32; 2]; 2], by: [f32; 2], first: usize) -> Vec<[f32; 2]> {
        (0..FLAG.len())
            .map(|i| {
                let [x, y] = FLAG[(i + first) % FLAG.len()];
                let row = |i: usize| matrix[i][0] * x + matrix[i][1] * y + by[i];
                [row(0), row(1)]
            })
            .collect()
    }

    #[test]
    fn a_square_becomes_one_with_the_moments_of_a_disc() {
        let square = [[3.0, 5.0], [43.0, 5.0], [43.0, 25.0], [3.0, 25.0]];
        let normalised = normalise(&square).expect("it has an area");
        assert_eq!(normalised.centre, [23.0, 15.0]);
        // A side of sqrt(3) has a mean square of 1/4.
        let expected = [[40.0 / 3f32.sqrt(), 0.0], [0.0, 20.0 / 3f32.sqrt()]];
        for (row, expected) in normalised.to_pixels.iter().zip(expected) {
            assert!((row[0] - expected[0]).abs() + (row[1] - expected[1]).abs() < 1e-3);
        }
    }

    #[test]
    fn what_has_no_area_or_runs_the_other_way_is_not_normalised() {
        assert_eq!(normalise(&[[1.0, 1.0], [5.0, 1.0]]), None);
        assert_eq!(normalise(&[[1.0, 1.0], [5.0, 1.0], [9.0, 1.0]]), None);
        let mut backwards = FLAG;
        backwards.reverse();
        assert_eq!(normalise(&backwards), None);
    }

    #[test]
    fn a_triangle_has_three_rotations() {
        let triangle = normalise(&[[3.0, 5.0], [43.0, 25.0], [7.0, 65.0]]).expect("an area");
        let mut turns = align(&triangle, &triangle).map(|aligned| {
            let Aligned { distance, turn_rad } = aligned.expect("three rotations");
            assert!(distance < 0.01, "{distance}");
            turn_rad
        });
        turns.sort_by(f32::total_cmp);
        for (turn, expected) in turns.into_iter().zip([-1.0, 0.0, 1.0]) {
            assert!((turn - expected * 2.0 * PI / 3.0).abs() < 0.01, "{turns:?}");
        }
    }

    proptest! {
        #[test]
        fn an_affine_picture_is_found(
            turn in -PI..PI,
            stretch in 0.5f32..1.0,
            along in -PI..PI,
            size in 0.3f32..4.0,
            first in 0usize..7,
        ) {
            let reference = normalise(&FLAG).expect("it has an area");
            let (sin, cos) = along.sin_cos();
            let (sin_turn, cos_turn) = turn.sin_cos();
            // Turned, then compressed along a direction.
            let [a, b, d] = [
                size * (stretch * cos * cos + sin * sin),
                size * (stretch - 1.0) * sin * cos,
                size * (stretch * sin * sin + cos * cos),
            ];
            let matrix = [
                [a * cos_turn + b * sin_turn, -a * sin_turn + b * cos_turn],
                [b * cos_turn + d * sin_turn, -b * sin_turn + d * cos_turn],
            ];
            let seen = normalise(&mapped(matrix, [70.0, 40.0], first)).expect("it has an area");
            let [Some(Aligned { distance, turn_rad }), ..] = align(&seen, &reference) else {
                return Err(TestCaseError::fail("no rotation"));
            };
            prop_assert!(distance < 0.01, "{distance}");
            let min = min_distance(&seen.magnitudes(), &reference.magnitudes());
            prop_assert!(min <= distance + 1e-4, "{min}");
            // What the alignment says the map is.
            let (sin, cos) = turn_rad.sin_cos();
            let product = |a: [[f32; 2]; 2], b: [[f32; 2]; 2]| {
                [0, 1].map(|i: usize| [0, 1].map(|k: usize| a[i][0] * b[0][k] + a[i][1] * b[1][k]))
            };
            let [[a, b], [_, d]] = reference.to_pixels;
            let inverse = [[d, -b], [-b, a]].map(|row| row.map(|c| c / (a * d - b * b)));
            let found = product(product(seen.to_pixels, [[cos, -sin], [sin, cos]]), inverse);
            for (found, expected) in found.iter().flatten().zip(matrix.iter().flatten()) {
                prop_assert!((found - expected).abs() < 0.04 * size, "{found} for {expected}");
            }
        }

        #[test]
        fn another_shape_is_far_away(turn in -PI..PI) {
            let (sin, cos) = turn.sin_cos();
            let flag = normalise(&mapped([[cos, -sin], [sin, cos]], [9.0, 9.0], 0)).expect("an area");
            let square = [[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]];
            let square = normalise(&square).expect("an area");
            let nearest = |reference| align(&flag, reference)[0].expect("a nearest one");
            prop_assert!(nearest(&square).distance > 0.05);
            prop_assert!(wrapped(nearest(&flag).turn_rad).abs() < 1e-3);
        }
    }
}
