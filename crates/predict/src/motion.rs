//! Motions that a few numbers describe, fitted to an object's last places by least squares: rest, a straight line,
//! with walls or without, a parabola, and a constant turn (`turn`).
//!
//! Everything is relative to the newest place and its moment, in seconds and units, so that uneven frames and
//! far-away origins do not matter.
//!
//! # Weights
//!
//! Things change their minds: the older a place, the less it tells of what comes. So for lines and turns a place's weight falls
//! evenly with its age, down to a fifth for the oldest. On a motion that changes slowly this is as steady as an even window of two
//! thirds of the length, and follows sooner.

use libm::sinf;

use crate::turn::turn;
use crate::vector::{add, scale, sub};

/// A place of the past relative to the newest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// Seconds after the newest place, not positive.
    pub(crate) time_s: f64,
    pub(crate) place: [f64; 2],
}

/// Places ahead, relative to the newest place. Single precision: relative to a place nearby that is a millionth of
/// the way, and it halves what a track weighs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Motion {
    Rest {
        origin: [f32; 2],
    },
    Line {
        origin: [f32; 2],
        velocity: [f32; 2],
    },
    Turn {
        origin: [f32; 2],
        velocity: [f32; 2],
        rate_rad_s: f32,
    },
    /// Steady acceleration.
    Parabola {
        origin: [f32; 2],
        velocity: [f32; 2],
        acceleration: [f32; 2],
    },
    /// A straight line thrown back by walls, at the angle of incidence.
    Walled {
        origin: [f32; 2],
        velocity: [f32; 2],
        /// Lowest and highest coordinates.
        walls: [[f32; 2]; 2],
    },
}

impl Motion {
    pub(crate) const NONE: Self = Self::Rest { origin: [0.0; 2] };

    /// Place `ahead_s` after the newest, relative to it.
    pub(crate) fn at(&self, ahead_s: f32) -> [f32; 2] {
        let along = |origin: &[f32; 2], velocity: &[f32; 2], time_s: f32| {
            [
                origin[0] + velocity[0] * time_s,
                origin[1] + velocity[1] * time_s,
            ]
        };
        match self {
            Self::Rest { origin } => *origin,
            Self::Line { origin, velocity } => along(origin, velocity, ahead_s),
            Self::Turn {
                origin,
                velocity: [vx, vy],
                rate_rad_s,
            } => {
                let angle = rate_rad_s * ahead_s;
                let [c, s] = if angle.abs() < 1e-2 {
                    [
                        ahead_s * (1.0 - angle * angle / 6.0),
                        ahead_s * (0.5 * angle),
                    ]
                } else {
                    // 1 - cos by the half angle keeps the digits.
                    let half = sinf(0.5 * angle);
                    [sinf(angle) / rate_rad_s, 2.0 * half * half / rate_rad_s]
                };
                [origin[0] + vx * c - vy * s, origin[1] + vx * s + vy * c]
            }
            Self::Parabola {
                origin,
                velocity,
                acceleration,
            } => {
                let half = 0.5 * ahead_s * ahead_s;
                let [x, y] = along(origin, velocity, ahead_s);
                [x + acceleration[0] * half, y + acceleration[1] * half]
            }
            Self::Walled {
                origin,
                velocity,
                walls,
            } => {
                let mut place = along(origin, velocity, ahead_s);
                for (axis, place) in place.iter_mut().enumerate() {
                    let (low, high) = (walls[0][axis], walls[1][axis]);
                    if *place > high {
                        *place = (2.0 * high - *place).max(low);
                    } else if *place < low {
                        *place = (2.0 * low - *place).min(high);
                    }
                }
                place
            }
        }
    }

    /// Velocity at the newest moment.
    pub(crate) fn velocity(&self) -> [f64; 2] {
        match self {
            Self::Rest { .. } => [0.0; 2],
            Self::Line { velocity, .. }
            | Self::Walled { velocity, .. }
            | Self::Parabola { velocity, .. }
            | Self::Turn { velocity, .. } => velocity.map(f64::from),
        }
    }

    /// Turn rate of the velocity.
    pub(crate) fn turn_rate_rad_s(&self) -> f64 {
        match self {
            Self::Turn { rate_rad_s, .. } => f64::from(*rate_rad_s),
            Self::Rest { .. } | Self::Line { .. } | Self::Walled { .. } | Self::Parabola { .. } => {
                0.0
            }
        }
    }

    /// The mean of the points.
    pub(crate) fn rest(points: &[Point]) -> Self {
        let n = points.len() as f64;
        let mean = points
            .iter()
            .fold([0.0; 2], |sum, point| add(sum, scale(point.place, 1.0 / n)));
        Self::Rest {
            origin: single(mean),
        }
    }

    /// The line through the points; rest at the newest for fewer than two.
    pub(crate) fn line(points: &[Point]) -> Self {
        match Line::fit(points) {
            Some(line) => Self::Line {
                origin: single(line.origin),
                velocity: single(line.velocity),
            },
            None => Self::NONE,
        }
    }

    /// The line through the points between walls, given by their lowest and highest coordinates.
    pub(crate) fn walled(points: &[Point], walls: [[f64; 2]; 2]) -> Self {
        match Line::fit(points) {
            Some(line) => Self::Walled {
                origin: single(line.origin),
                velocity: single(line.velocity),
                walls: walls.map(single),
            },
            None => Self::NONE,
        }
    }

    /// The parabola through the points; a line for fewer than three.
    pub(crate) fn parabola(points: &[Point]) -> Self {
        match parabola(points) {
            Some([origin, velocity, acceleration]) => Self::Parabola {
                origin: single(origin),
                velocity: single(velocity),
                acceleration: single(acceleration),
            },
            None => Self::line(points),
        }
    }

    /// The turn through the points, no faster than given; a line for fewer than three or where they stay in place.
    pub(crate) fn turn(points: &[Point], most_rad_s: f64) -> Self {
        match turn(points, most_rad_s) {
            Some((origin, velocity, rate)) => Self::Turn {
                origin: single(origin),
                velocity: single(velocity),
                rate_rad_s: rate as f32,
            },
            None => Self::line(points),
        }
    }
}

/// By how much less the oldest place counts than one of the newest moment.
const FALL: f64 = 0.8;

/// Weight of a place among others, the oldest of which is of the moment `oldest_s`, before the newest.
pub(crate) fn weight(point: &Point, oldest_s: f64) -> f64 {
    1.0 - FALL * point.time_s / oldest_s
}

fn single(vector: [f64; 2]) -> [f32; 2] {
    vector.map(|component| component as f32)
}

/// Steady motion along a straight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Line {
    /// Fitted place at the newest moment.
    pub(crate) origin: [f64; 2],
    /// Units a second.
    pub(crate) velocity: [f64; 2],
    /// Mean of the times, not positive.
    mean_s: f64,
    /// Variances that noise of variance 1 in every place causes: of the mean place, of that and the velocity together, of the
    /// velocity.
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
            mean = add(mean, scale(point.place, weight));
        }
        mean_s /= n;
        mean = scale(mean, 1.0 / n);
        let (mut spread_s2, mut moment, mut squares) = (0.0, [0.0; 2], [0.0; 3]);
        for point in points {
            let weight = weight(point, oldest.time_s);
            let time_s = point.time_s - mean_s;
            spread_s2 += weight * time_s * time_s;
            moment = add(moment, scale(sub(point.place, mean), weight * time_s));
            for (sum, of_time) in squares.iter_mut().zip([1.0, time_s, time_s * time_s]) {
                *sum += weight * weight * of_time;
            }
        }
        let velocity = scale(moment, 1.0 / spread_s2);
        let [place, both, slope] = squares;
        Some(Self {
            origin: sub(mean, scale(velocity, mean_s)),
            velocity,
            mean_s,
            noise: [
                place / (n * n),
                both / (n * spread_s2),
                slope / (spread_s2 * spread_s2),
            ],
        })
    }

    /// Place at a time after the newest moment.
    pub(crate) fn at(&self, time_s: f64) -> [f64; 2] {
        add(self.origin, scale(self.velocity, time_s))
    }

    /// Variance of the place `ahead_s` after the newest moment that noise of variance 1 in every place causes.
    pub(crate) fn noise_gain(&self, ahead_s: f64) -> f64 {
        let from_mean_s = ahead_s - self.mean_s;
        let [place, both, slope] = self.noise;
        place + from_mean_s * (2.0 * both + from_mean_s * slope)
    }
}

/// Place, velocity and acceleration at the newest moment; `None` for fewer than three points or too close ones.
pub(crate) fn parabola(points: &[Point]) -> Option<[[f64; 2]; 3]> {
    if points.len() < 3 {
        return None;
    }
    let n = points.len() as f64;
    // Times from the middle in units of the longest, so that the sums are of the size of n.
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
        p0 = add(p0, point.place);
        p1 = add(p1, scale(point.place, t));
        p2 = add(p2, scale(point.place, t2));
    }
    // Of the normal equations, the sum of t vanishes.
    let determinant = s2 * (s4 - s2 * s2 / n) - s3 * s3;
    let p2 = sub(p2, scale(p0, s2 / n));
    let second = scale(sub(scale(p2, s2), scale(p1, s3)), 1.0 / determinant);
    let first = scale(sub(p1, scale(second, s3)), 1.0 / s2);
    let middle = scale(sub(p0, scale(second, s2)), 1.0 / n);
    // From the middle to the newest moment.
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
    extern crate std;
    use super::*;
    use crate::vector::norm_squared;
    use libm::{cos, sin};
    use std::vec::Vec;

    /// Places of a path at uneven moments, newest first, and the newest moment.
    fn points(n: usize, place: impl Fn(f64) -> [f64; 2]) -> (Vec<Point>, f64) {
        let times: Vec<f64> = (0..n)
            .map(|i| i as f64 / 15.0 + 0.009 * (i % 3) as f64)
            .collect();
        let newest_s = times[n - 1];
        let newest = place(newest_s);
        let points = times.iter().rev().map(|time_s| Point {
            time_s: time_s - newest_s,
            place: sub(place(*time_s), newest),
        });
        (points.collect(), newest_s)
    }

    fn error(motion: &Motion, ahead_s: f64, newest_s: f64, place: impl Fn(f64) -> [f64; 2]) -> f64 {
        let expected = sub(place(newest_s + ahead_s), place(newest_s));
        norm_squared(sub(motion.at(ahead_s as f32).map(f64::from), expected))
    }

    #[test]
    fn line_is_exact_on_a_line() {
        let place = |t: f64| [1000.0 + 30.0 * t, -7.0 * t];
        for n in 2..9 {
            let (points, newest_s) = points(n, place);
            let line = Motion::line(&points);
            assert!(error(&line, 1.0, newest_s, place) < 1e-8, "{n} samples");
            assert!((line.velocity()[0] - 30.0).abs() < 1e-5);
        }
        assert_eq!(Motion::line(&[]), Motion::NONE);
    }

    #[test]
    fn line_through_three_points_by_hand() {
        let at = |time_s: f64, x: f64| Point {
            time_s,
            place: [x, 0.0],
        };
        // Weights 1, 3/5, 1/5: mean time -5/9, mean place -4/3.
        let line = Line::fit(&[at(0.0, 0.0), at(-1.0, -3.0), at(-2.0, -3.0)]).expect("points");
        assert!((line.velocity[0] - 75.0 / 38.0).abs() < 1e-12);
        assert!((line.at(0.0)[0] + 9.0 / 38.0).abs() < 1e-12);
    }

    #[test]
    fn noise_gain_is_the_sum_of_what_each_place_adds() {
        let (mut points, _) = points(7, |t| [3.0 * t, 0.0]);
        let line = Line::fit(&points).expect("points");
        for ahead_s in [0.0, 0.3, 2.0] {
            let mut gain = 0.0;
            for i in 0..points.len() {
                points[i].place[1] = 1.0;
                let moved = Line::fit(&points).expect("points").at(ahead_s)[1];
                points[i].place[1] = 0.0;
                gain += moved * moved;
            }
            assert!((line.noise_gain(ahead_s) - gain).abs() < 1e-9, "{gain}");
        }
    }

    #[test]
    fn turn_is_exact_on_circles_from_three_points_on() {
        for rate in [-4.0_f64, -0.5, 1e-3, 0.7, 3.0] {
            let place = |t: f64| [500.0 + 60.0 * sin(rate * t), 60.0 * cos(rate * t)];
            for n in 3..12 {
                let (points, newest_s) = points(n, place);
                let turn = Motion::turn(&points, 9.0);
                let error = error(&turn, 1.0, newest_s, place);
                assert!(error < 1e-6, "{rate} {n}: {error:?}");
            }
        }
    }

    #[test]
    fn turn_of_a_jittering_line_is_nearly_a_line() {
        let (points, _) = points(8, |t| {
            let jitter = 0.3 * cos(core::f64::consts::PI * 15.0 * t);
            [50.0 * t, jitter]
        });
        let rate = Motion::turn(&points, 9.0).turn_rate_rad_s();
        assert!(rate.abs() < 0.2, "{rate}");
    }

    #[test]
    fn nothing_turns_at_rest() {
        let (points, _) = points(8, |_| [1.0, 2.0]);
        let rest = Motion::turn(&points, 9.0);
        assert_eq!((rest.at(2.0), rest.turn_rate_rad_s()), ([0.0; 2], 0.0));
    }

    #[test]
    fn parabola_is_exact_on_one() {
        let place = |t: f64| [3.0 * t * t - 2.0 * t, 5.0 * t + 1.0];
        let (points, newest_s) = points(6, place);
        let [origin, velocity, acceleration] = parabola(&points).expect("six points");
        assert!(norm_squared(origin) < 1e-18);
        let expected = [6.0 * newest_s - 2.0, 5.0];
        assert!(
            norm_squared(sub(velocity, expected)) < 1e-16,
            "{velocity:?}"
        );
        assert!(norm_squared(sub(acceleration, [6.0, 0.0])) < 1e-16);
    }

    #[test]
    fn walls_throw_a_line_back() {
        let motion = Motion::Walled {
            origin: [0.0; 2],
            velocity: [10.0, 4.0],
            walls: [[-5.0, -5.0], [6.0, 100.0]],
        };
        assert_eq!(motion.at(0.5), [5.0, 2.0]);
        assert_eq!(motion.at(1.0), [2.0, 4.0]);
        assert_eq!(motion.at(9.0)[0], -5.0, "not through the other wall");
    }
}
