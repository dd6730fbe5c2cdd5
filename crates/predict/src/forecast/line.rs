//! Weighted least-squares fit of a straight line.

use crate::forecast::past::{Point, weight};
use crate::vector::{add, scale, sub};

/// Constant velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Line {
    /// Fitted position at the newest sample.
    pub(crate) origin: [f64; 2],
    /// Units per second.
    pub(crate) velocity: [f64; 2],
    /// Mean of the times, not positive.
    mean_s: f64,
    /// Variances caused by unit noise in every position: of the mean position, covariance with the
    /// velocity, of the velocity.
    noise: [f64; 3],
}

impl Line {
    /// `None` for fewer than two points.
    pub(crate) fn fit(points: &[Point]) -> Option<Self> {
        let [_, .., oldest] = points else {
            return None;
        };
        let (mut n, mut mean_s, mut mean) = (0.0, 0.0, [0.0; 2]);
        for point in points {
            let weight = weight(point, oldest.time_s);
            n += weight;
            mean_s += weight * point.time_s;
            mean = add(mean, scale(point.position, weight));
        }
        mean_s /= n;
        mean = scale(mean, 1.0 / n);
        let (mut spread_s2, mut moment, mut squares) = (0.0, [0.0; 2], [0.0; 3]);
        for point in points {
            let weight = weight(point, oldest.time_s);
            let time_s = point.time_s - mean_s;
            spread_s2 += weight * time_s * time_s;
            moment = add(moment, scale(sub(point.position, mean), weight * time_s));
            for (sum, of_time) in squares.iter_mut().zip([1.0, time_s, time_s * time_s]) {
                *sum += weight * weight * of_time;
            }
        }
        let velocity = scale(moment, 1.0 / spread_s2);
        let [position, both, slope] = squares;
        Some(Self {
            origin: sub(mean, scale(velocity, mean_s)),
            velocity,
            mean_s,
            noise: [
                position / (n * n),
                both / (n * spread_s2),
                slope / (spread_s2 * spread_s2),
            ],
        })
    }

    /// Position at a time after the newest sample.
    pub(crate) fn at(&self, time_s: f64) -> [f64; 2] {
        add(self.origin, scale(self.velocity, time_s))
    }

    /// Variance of the position `ahead_s` after the newest sample that is caused by unit noise in
    /// every position.
    pub(crate) fn noise_gain(&self, ahead_s: f64) -> f64 {
        let from_mean_s = ahead_s - self.mean_s;
        let [position, both, slope] = self.noise;
        position + from_mean_s * (2.0 * both + from_mean_s * slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::past::tests::points;

    #[test]
    fn line_through_three_points_by_hand() {
        let at = |time_s: f64, x: f64| Point {
            time_s,
            position: [x, 0.0],
        };
        // Weights 1, 3/5, 1/5: mean time -5/9, mean position -4/3.
        let line = Line::fit(&[at(0.0, 0.0), at(-1.0, -3.0), at(-2.0, -3.0)]).expect("points");
        assert!((line.velocity[0] - 75.0 / 38.0).abs() < 1e-12);
        assert!((line.at(0.0)[0] + 9.0 / 38.0).abs() < 1e-12);
    }

    #[test]
    fn noise_gain_is_the_sum_over_all_positions() {
        let (mut points, _) = points(7, |t| [3.0 * t, 0.0]);
        let line = Line::fit(&points).expect("points");
        for ahead_s in [0.0, 0.3, 2.0] {
            let mut gain = 0.0;
            for i in 0..points.len() {
                points[i].position[1] = 1.0;
                let moved = Line::fit(&points).expect("points").at(ahead_s)[1];
                points[i].position[1] = 0.0;
                gain += moved * moved;
            }
            assert!((line.noise_gain(ahead_s) - gain).abs() < 1e-9, "{gain}");
        }
    }
}
