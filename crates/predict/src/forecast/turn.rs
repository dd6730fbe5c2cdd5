//! Least-squares fit of a constant turn.
//!
//! An object that moves at constant speed and turns at the constant rate w is at
//!
//! ```text
//! p(t) = p0 + v * g(t),   g(t) = (sin wt + i (1 - cos wt)) / w
//! ```
//!
//! with positions as complex numbers and t = 0 at the newest sample. For a given w this is linear
//! in p0 and v. These two are eliminated (variable projection), and Gauss-Newton searches for w
//! alone. The search starts from two chords: a chord of an arc is parallel to the tangent at the
//! middle of its time. The angle between the chords over the older and the newer samples, divided
//! by the time between their middles, is therefore w, exactly so without noise.
//!
//! A turn rate fitted to noise ruins a forecast. The rate is therefore scaled by 1 - var(w)/w², not
//! below 0 (the positive-part James-Stein factor). A rate well above its uncertainty stays; any
//! other vanishes and leaves a line.

use libm::{atan2, sincos};

use crate::forecast::past::{Point, weight};
use crate::vector::{add, complex_mul, conjugate, norm_squared, scale, sub};

/// Position and velocity at the newest sample, and the turn rate. `None` for fewer than three
/// points, or if they do not move.
pub(crate) fn turn(points: &[Point], max_rad_s: f64) -> Option<([f64; 2], [f64; 2], f64)> {
    if points.len() < 3 {
        return None;
    }
    let mut rate = rate_from_chords(points)?.clamp(-max_rad_s, max_rad_s);
    let mut fit = TurnFit::of(points, rate)?;
    // Three points determine the rate exactly. For more points, a second step would make no
    // difference.
    if points.len() > 3 && fit.information > 0.0 {
        rate = (rate + fit.gradient / fit.information).clamp(-max_rad_s, max_rad_s);
        fit = TurnFit::of(points, rate)?;
    }
    let certainty = fit.certainty(points.len(), rate);
    if certainty < 1.0 {
        rate *= certainty;
        fit = TurnFit::of(points, rate)?;
    }
    Some((fit.origin, fit.velocity, rate))
}

/// Angle between the chords over the older and the newer half of the points, divided by the time
/// between the middles of the halves. `None` if a chord has no direction.
fn rate_from_chords(points: &[Point]) -> Option<f64> {
    let (newest, oldest) = (points.first()?, points.last()?);
    let middle = &points[points.len() / 2];
    let older = sub(middle.position, oldest.position);
    let newer = sub(newest.position, middle.position);
    let [dot, cross] = complex_mul(newer, conjugate(older));
    if cross == 0.0 && dot == 0.0 {
        return None;
    }
    Some(atan2(cross, dot) / (0.5 * -oldest.time_s))
}

/// The best p0 and v for a turn rate, and how the squared residual changes with the rate.
struct TurnFit {
    origin: [f64; 2],
    velocity: [f64; 2],
    /// Weighted sum of squared residuals.
    residual: f64,
    /// Half the decrease of `residual` per rad/s of the rate.
    gradient: f64,
    /// Gauss-Newton curvature. The noise variance divided by it is the variance of the rate.
    information: f64,
}

impl TurnFit {
    fn of(points: &[Point], rate: f64) -> Option<Self> {
        let oldest_s = points.last()?.time_s;
        // With the residual r = p - p0 - v g and its derivative v g', both follow from these
        // weighted sums.
        let (mut n, mut g, mut g_squared) = (0.0, [0.0; 2], 0.0);
        let (mut d, mut d_squared, mut d_by_g) = ([0.0; 2], 0.0, [0.0; 2]);
        let (mut p, mut p_squared, mut p_by_g, mut p_by_d) = ([0.0; 2], 0.0, [0.0; 2], [0.0; 2]);
        for point in points {
            let weight = weight(point, oldest_s);
            let (arc, derivative) = arc(rate, point.time_s);
            let [weighed_arc, weighed_derivative, weighed_place] =
                [arc, derivative, point.position].map(|vector| scale(vector, weight));
            n += weight;
            g = add(g, weighed_arc);
            g_squared += weight * norm_squared(arc);
            d = add(d, weighed_derivative);
            d_squared += weight * norm_squared(derivative);
            d_by_g = add(d_by_g, complex_mul(weighed_derivative, conjugate(arc)));
            p = add(p, weighed_place);
            p_squared += weight * norm_squared(point.position);
            p_by_g = add(p_by_g, complex_mul(weighed_place, conjugate(arc)));
            p_by_d = add(p_by_d, complex_mul(weighed_place, conjugate(derivative)));
        }
        // About the means, which eliminates p0.
        let about = |product: [f64; 2], a: [f64; 2], b: [f64; 2]| {
            sub(product, scale(complex_mul(a, conjugate(b)), 1.0 / n))
        };
        let g_spread = g_squared - norm_squared(g) / n;
        let d_spread = d_squared - norm_squared(d) / n;
        let d_by_g = about(d_by_g, d, g);
        let p_by_g = about(p_by_g, p, g);
        let p_by_d = about(p_by_d, p, d);
        let velocity = scale(p_by_g, 1.0 / g_spread);
        let origin = scale(sub(p, complex_mul(velocity, g)), 1.0 / n);
        let residual =
            (p_squared - norm_squared(p) / n - norm_squared(velocity) * g_spread).max(0.0);
        // Sum of the real part of r times the conjugate of v g'.
        let slope = sub(p_by_d, complex_mul(velocity, conjugate(d_by_g)));
        let gradient = slope[0] * velocity[0] + slope[1] * velocity[1];
        let information = norm_squared(velocity) * (d_spread - norm_squared(d_by_g) / g_spread);
        let finite = velocity.iter().chain(&origin).all(|c| c.is_finite())
            && gradient.is_finite()
            && information.is_finite();
        finite.then_some(Self {
            origin,
            velocity,
            residual,
            gradient,
            information,
        })
    }

    /// The factor 1 - var(w)/w², or 0. The variance assumes that the weights are inverse variances.
    /// For points of equal variance it is about a sixth larger.
    fn certainty(&self, n_points: usize, rate: f64) -> f64 {
        let freedom = (2 * n_points).saturating_sub(5) as f64;
        let variance = self.residual / freedom / self.information;
        let certainty = 1.0 - variance / (rate * rate);
        // Points that do not determine the rate have no information. The comparison is then false
        // for NaN.
        if self.information > 0.0 && certainty > 0.0 {
            certainty
        } else {
            0.0
        }
    }
}

/// g(t) of the module documentation and its derivative by the turn rate. Near zero, a series
/// replaces the quotients, which would lose their digits.
fn arc(rate: f64, time_s: f64) -> ([f64; 2], [f64; 2]) {
    let angle = rate * time_s;
    let squared = time_s * time_s;
    if angle.abs() < 1e-3 {
        (
            [time_s * (1.0 - angle * angle / 6.0), time_s * (0.5 * angle)],
            [
                -squared * angle / 3.0,
                squared * (0.5 - angle * angle / 8.0),
            ],
        )
    } else {
        let (sine, cosine) = sincos(angle);
        let arc = [sine / rate, (1.0 - cosine) / rate];
        // d/dw (sin wt)/w = (t cos wt - g_x)/w and likewise for y.
        let derivative = [
            (time_s * cosine - arc[0]) / rate,
            (time_s * sine - arc[1]) / rate,
        ];
        (arc, derivative)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivative_of_the_arc_equals_difference_quotient() {
        for (rate, time_s) in [(0.5, -0.4), (-3.0, 0.9), (1e-3, -0.5), (0.0, 0.3)] {
            let h = 1e-5;
            let (_, analytic) = arc(rate, time_s);
            let [above, below] = [h, -h].map(|h| arc(rate + h, time_s).0);
            let numeric = scale(sub(above, below), 0.5 / h);
            assert!(
                norm_squared(sub(analytic, numeric)) < 1e-12,
                "{rate} {time_s}: {analytic:?} {numeric:?}"
            );
        }
    }
}
