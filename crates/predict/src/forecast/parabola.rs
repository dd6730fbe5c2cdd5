//! Least-squares fit of a parabola.

use crate::forecast::past::Point;
use crate::vector::{add, scale, sub};

/// Position, velocity and acceleration at the newest sample. `None` for fewer than three points, or
/// if they are too close together.
pub(crate) fn parabola(points: &[Point]) -> Option<[[f64; 2]; 3]> {
    if points.len() < 3 {
        return None;
    }
    let n = points.len() as f64;
    // Times from the mean in units of the longest, so that the sums are of the order of n.
    let unit_s = -points.last()?.time_s;
    let mean = points
        .iter()
        .map(|point| point.time_s / unit_s)
        .sum::<f64>()
        / n;
    let (mut s2, mut s3, mut s4) = (0.0, 0.0, 0.0);
    let (mut p0, mut p1, mut p2) = ([0.0; 2], [0.0; 2], [0.0; 2]);
    for point in points {
        let t = point.time_s / unit_s - mean;
        let t2 = t * t;
        s2 += t2;
        s3 += t2 * t;
        s4 += t2 * t2;
        p0 = add(p0, point.position);
        p1 = add(p1, scale(point.position, t));
        p2 = add(p2, scale(point.position, t2));
    }
    // The sum of t vanishes in the normal equations.
    let determinant = s2 * (s4 - s2 * s2 / n) - s3 * s3;
    let p2 = sub(p2, scale(p0, s2 / n));
    let second = scale(sub(scale(p2, s2), scale(p1, s3)), 1.0 / determinant);
    let first = scale(sub(p1, scale(second, s3)), 1.0 / s2);
    let middle = scale(sub(p0, scale(second, s2)), 1.0 / n);
    // From the mean time to the newest sample.
    let to = -mean;
    let origin = add(middle, add(scale(first, to), scale(second, to * to)));
    let velocity = scale(add(first, scale(second, 2.0 * to)), 1.0 / unit_s);
    let acceleration = scale(second, 2.0 / (unit_s * unit_s));
    let fit = [origin, velocity, acceleration];
    fit.as_flattened()
        .iter()
        .all(|value| value.is_finite())
        .then_some(fit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::past::tests::points;
    use crate::vector::norm_squared;

    #[test]
    fn parabola_is_exact_on_a_parabola() {
        let position = |t: f64| [3.0 * t * t - 2.0 * t, 5.0 * t + 1.0];
        let (points, newest_s) = points(6, position);
        let [origin, velocity, acceleration] = parabola(&points).expect("six points");
        assert!(norm_squared(origin) < 1e-18);
        let expected = [6.0 * newest_s - 2.0, 5.0];
        assert!(
            norm_squared(sub(velocity, expected)) < 1e-16,
            "{velocity:?}"
        );
        assert!(norm_squared(sub(acceleration, [6.0, 0.0])) < 1e-16);
    }
}
