//! Symmetric 2x2 covariance matrices.

use libm::sqrt;

use crate::vector::{add, scale};

/// Rows of a covariance of (x, y).
pub(crate) type Covariance = [[f64; 2]; 2];

/// Sum of the variances.
pub(crate) fn trace(covariance: &Covariance) -> f64 {
    covariance[0][0] + covariance[1][1]
}

/// The nearest symmetric, positive semidefinite matrix to one that rounding or a caller made
/// slightly invalid. NaN counts as 0.
pub(crate) fn semidefinite(matrix: &Covariance) -> Covariance {
    let [[xx, xy], [yx, yy]] = *matrix;
    let number = |value: f64| if value.is_nan() { 0.0 } else { value };
    let [xx, yy] = [xx, yy].map(|variance| number(variance).clamp(0.0, f64::MAX));
    // The root of each factor: their product may overflow.
    let bound = sqrt(xx) * sqrt(yy);
    let off_diagonal = number(0.5 * (xy + yx)).clamp(-bound, bound);
    [[xx, off_diagonal], [off_diagonal, yy]]
}

/// Rotates a covariance given along and across `direction` (a unit vector) to the x and y axes.
pub(crate) fn rotated(covariance: &Covariance, direction: [f64; 2]) -> Covariance {
    let [[along, both], [_, across]] = *covariance;
    let [c, s] = direction;
    let xy = c * s * (along - across) + (c * c - s * s) * both;
    semidefinite(&[
        [c * c * along - 2.0 * c * s * both + s * s * across, xy],
        [xy, s * s * along + 2.0 * c * s * both + c * c * across],
    ])
}

/// Kalman update of a position: the correction that follows from `innovation`, and the remaining
/// covariance. `None` if neither side has any noise.
pub(crate) fn kalman_update(
    forecast: &Covariance,
    noise: &Covariance,
    innovation: [f64; 2],
) -> Option<([f64; 2], Covariance)> {
    let [[a, b], [_, d]] = [0, 1].map(|i| add(forecast[i], noise[i]));
    // Both are positive semidefinite, so the determinant is negative only through rounding.
    let determinant = a * d - b * b;
    if determinant <= 0.0 || !determinant.is_finite() {
        return None;
    }
    let inverse = [[d, -b], [-b, a]].map(|row| scale(row, 1.0 / determinant));
    let gain = [0, 1].map(|i| {
        let row: [f64; 2] = forecast[i];
        [0, 1].map(|j| row[0] * inverse[0][j] + row[1] * inverse[1][j])
    });
    let correction = gain.map(|row| row[0] * innovation[0] + row[1] * innovation[1]);
    // gain * noise equals (1 - gain) * forecast and loses fewer digits.
    let left = gain.map(|row| [0, 1].map(|j| row[0] * noise[0][j] + row[1] * noise[1][j]));
    // A tiny determinant makes the inverse overflow.
    let finite = correction
        .iter()
        .chain(left.as_flattened())
        .all(|value| value.is_finite());
    finite.then(|| (correction, semidefinite(&left)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_by_a_right_angle_swaps_the_axes() {
        let turned = rotated(&[[4.0, 1.0], [1.0, 9.0]], [0.0, 1.0]);
        assert_eq!(turned, [[9.0, -1.0], [-1.0, 4.0]]);
    }

    #[test]
    fn rotation_keeps_trace_and_determinant() {
        let turned = rotated(&[[4.0, 1.0], [1.0, 9.0]], [0.6, 0.8]);
        let determinant = turned[0][0] * turned[1][1] - turned[0][1] * turned[1][0];
        assert!((trace(&turned) - 13.0).abs() < 1e-12);
        assert!((determinant - 35.0).abs() < 1e-12);
    }

    #[test]
    fn repairs_invalid_covariances() {
        let repaired = semidefinite(&[[4.0, 100.0], [0.0, 9.0]]);
        assert_eq!(repaired, [[4.0, 6.0], [6.0, 9.0]]);
        let repaired = semidefinite(&[[4.0, 1.0], [1.0, -1e-200]]);
        assert_eq!(repaired, [[4.0, 0.0], [0.0, 0.0]]);
        let repaired = semidefinite(&[[f64::NAN, f64::NAN], [0.0, f64::INFINITY]]);
        assert_eq!(repaired, [[0.0, 0.0], [0.0, f64::MAX]]);
    }

    #[test]
    fn kalman_update_weighs_by_variance() {
        let (correction, left) = kalman_update(
            &[[1.0, 0.0], [0.0, 3.0]],
            &[[3.0, 0.0], [0.0, 1.0]],
            [4.0, 4.0],
        )
        .expect("noise on both sides");
        assert_eq!(correction, [1.0, 3.0]);
        assert_eq!(left, [[0.75, 0.0], [0.0, 0.75]]);
        assert_eq!(
            kalman_update(&[[0.0; 2]; 2], &[[0.0; 2]; 2], [1.0, 1.0]),
            None
        );
    }
}
