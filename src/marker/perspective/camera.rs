//! How a camera with four unknowns stretches plates: slope of the floor over the focal length in x and
//! y, distortion, and logarithm of the focal length in widths of the picture.
//!
//! A pixel at `q` from the middle of the picture, in widths of the picture, shows the point
//!
//! ```text
//! floor = root(1 + focal² m mᵀ) q / (1 + bend |q|² - m · q)
//! ```
//!
//! of the floor, apart from its scale and direction: `focal · m` is the slope of the floor relative
//! to the picture, `bend` the radial distortion of the lens in the division model (Fitzgibbon
//! 2001). The derivative of this map gives the stretch of a plate ([`CurvedFit::stretch`]), the
//! second derivative how it changes across the plate.
//!
//! [`CurvedFit::stretch`]: imgproc::fit::CurvedFit::stretch

use nalgebra::{Matrix2, SVector, Vector2, Vector4};

/// `1 + bend |q|² - m · q`; proportional to the inverse of the distance from the camera.
pub(super) fn denominator(unknowns: &Vector4<f64>, [x, y]: [f64; 2]) -> f64 {
    1.0 + unknowns[2] * (x * x + y * y) - unknowns[0] * x - unknowns[1] * y
}

/// Derivatives of the denominator.
fn slope_of_denominator(unknowns: &Vector4<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    [
        2.0 * unknowns[2] * x - unknowns[0],
        2.0 * unknowns[2] * y - unknowns[1],
    ]
}

/// Derivatives of `q / denominator`.
fn jacobian(unknowns: &Vector4<f64>, at: [f64; 2]) -> Matrix2<f64> {
    let d = denominator(unknowns, at);
    let slope = slope_of_denominator(unknowns, at);
    Matrix2::from_fn(|i, k| {
        let diagonal = if i == k { 1.0 / d } else { 0.0 };
        diagonal - at[i] * slope[k] / (d * d)
    })
}

/// The two numbers of the stretch at a place, in widths of the picture from its middle.
pub(super) fn stretch(unknowns: &Vector4<f64>, at: [f64; 2]) -> [f64; 2] {
    let jacobian = jacobian(unknowns, at);
    let slope = unknowns[3].exp() * Vector2::new(unknowns[0], unknowns[1]);
    let metric = Matrix2::identity() + slope * slope.transpose();
    // Of the floor, seen from the picture; the picture's is its inverse.
    let on_floor = jacobian.transpose() * metric * jacobian;
    let root = on_floor.determinant().max(1e-12).sqrt();
    let (xx, xy, yy) = (
        on_floor[(1, 1)] / root,
        -on_floor[(0, 1)] / root,
        on_floor[(0, 0)] / root,
    );
    // The logarithm of a symmetric matrix of determinant 1, halved.
    let cosh = ((xx + yy) / 2.0).max(1.0);
    let sinh = (cosh * cosh - 1.0).sqrt();
    let ratio = if sinh > 1e-6 {
        (cosh + sinh).ln() / sinh
    } else {
        1.0
    };
    [(xx - yy) / 4.0 * ratio, xy / 2.0 * ratio]
}

/// The stretch, and its derivatives with respect to the unknowns.
pub(super) fn stretch_and_slopes(
    unknowns: &Vector4<f64>,
    at: [f64; 2],
) -> ([f64; 2], [Vector4<f64>; 2]) {
    const STEP: f64 = 1e-4;
    let mut slopes = [SVector::zeros(); 2];
    for i in 0..4 {
        let moved = |step: f64| {
            let mut unknowns = *unknowns;
            unknowns[i] += step;
            stretch(&unknowns, at)
        };
        let (before, after) = (moved(-STEP), moved(STEP));
        for (slope, (before, after)) in slopes.iter_mut().zip(before.into_iter().zip(after)) {
            slope[i] = (after - before) / (2.0 * STEP);
        }
    }
    (stretch(unknowns, at), slopes)
}

/// Terms of second degree of the map at a place, as movements in the picture: factors of x², xy and
/// y² for x and y. Lengths in widths of the picture.
pub(super) fn curvature(unknowns: &Vector4<f64>, at: [f64; 2]) -> [[f64; 3]; 2] {
    let d = denominator(unknowns, at);
    let slope = slope_of_denominator(unknowns, at);
    let second = |i: usize, j: usize, k: usize| {
        let is = |a: usize, b: usize| f64::from(u8::from(a == b));
        let bend = 2.0 * unknowns[2] * is(j, k);
        -(is(i, j) * slope[k] + is(i, k) * slope[j] + at[i] * bend) / (d * d)
            + 2.0 * at[i] * slope[j] * slope[k] / (d * d * d)
    };
    let terms = [(0, 0, 0.5), (0, 1, 1.0), (1, 1, 0.5)];
    let columns = terms.map(|(j, k, share)| share * Vector2::new(second(0, j, k), second(1, j, k)));
    let inverse = jacobian(unknowns, at).try_inverse();
    let inverse = inverse.unwrap_or_else(Matrix2::identity);
    let [xx, xy, yy] = columns.map(|column| inverse * column);
    [0, 1].map(|i: usize| [xx[i], xy[i], yy[i]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slopes_of_the_map_are_those_of_the_floor() {
        let unknowns = Vector4::new(0.4, -0.3, -0.2, 0.1);
        let floor = |[x, y]: [f64; 2]| [x, y].map(|c| c / denominator(&unknowns, [x, y]));
        let at = [0.3, -0.2];
        const STEP: f64 = 1e-3;
        let moved = |x: f64, y: f64| floor([at[0] + x * STEP, at[1] + y * STEP]);
        let jacobian = jacobian(&unknowns, at);
        let inverse = jacobian.try_inverse().expect("it is regular");
        for i in 0..2 {
            let slope = (moved(1.0, 0.0)[i] - moved(-1.0, 0.0)[i]) / (2.0 * STEP);
            assert!((slope - jacobian[(i, 0)]).abs() < 1e-4);
        }
        let of_second_degree = |direction: [f64; 2]| {
            let [x, y] = direction;
            let (before, after, here) = (moved(-x, -y), moved(x, y), floor(at));
            let bend = [0, 1].map(|i: usize| before[i] + after[i] - 2.0 * here[i]);
            inverse * Vector2::from(bend) / (2.0 * STEP * STEP)
        };
        let found = curvature(&unknowns, at);
        let (along_x, along_y) = (of_second_degree([1.0, 0.0]), of_second_degree([0.0, 1.0]));
        let both = of_second_degree([1.0, 1.0]);
        for (i, [xx, xy, yy]) in found.into_iter().enumerate() {
            assert!((xx - along_x[i]).abs() < 1e-3 && (yy - along_y[i]).abs() < 1e-3);
            assert!((xx + xy + yy - both[i]).abs() < 1e-3);
        }
    }

    /// A camera that is tilted by 30 degrees: its axis, and what is half as far off it.
    #[test]
    fn the_stretch_of_a_tilted_camera() {
        let slope = 30f64.to_radians().tan();
        let unknowns = Vector4::new(0.0, slope, 0.0, 0.0);
        let [s, t] = stretch(&unknowns, [0.0, 0.0]);
        assert!((s + 30f64.to_radians().cos().ln() / 2.0).abs() < 1e-9 && t.abs() < 1e-9);
        assert!(stretch(&unknowns, [0.0, 0.3])[0] > s);
        assert!(stretch(&unknowns, [0.0, -0.3])[0] < s);
    }
}
