//! The motion models: rest, a straight line with or without bounds, a parabola, and a constant
//! turn.
//!
//! Positions and times are relative to the newest sample, in units and seconds, so that an uneven
//! frame rate and a distant origin do not matter.

use libm::sinf;

use crate::forecast::line::Line;
use crate::forecast::parabola::parabola;
use crate::forecast::past::Point;
use crate::forecast::turn::turn;
use crate::vector::{add, scale};

/// Future positions relative to the newest position. Single precision is enough, about a millionth
/// of the distance, and halves the size of a track.
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
    /// Constant acceleration.
    Parabola {
        origin: [f32; 2],
        velocity: [f32; 2],
        acceleration: [f32; 2],
    },
    /// A straight line that is reflected at the bounds.
    Bounce {
        origin: [f32; 2],
        velocity: [f32; 2],
        /// Minimum and maximum coordinates.
        bounds: [[f32; 2]; 2],
    },
}

impl Motion {
    pub(crate) const NONE: Self = Self::Rest { origin: [0.0; 2] };

    /// Position `ahead_s` after the newest sample.
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
                    // 1 - cos from the half angle keeps its digits.
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
            Self::Bounce {
                origin,
                velocity,
                bounds,
            } => {
                let mut position = along(origin, velocity, ahead_s);
                for (axis, position) in position.iter_mut().enumerate() {
                    let (low, high) = (bounds[0][axis], bounds[1][axis]);
                    if *position > high {
                        *position = (2.0 * high - *position).max(low);
                    } else if *position < low {
                        *position = (2.0 * low - *position).min(high);
                    }
                }
                position
            }
        }
    }

    /// Velocity at the newest sample.
    pub(crate) fn velocity(&self) -> [f64; 2] {
        match self {
            Self::Rest { .. } => [0.0; 2],
            Self::Line { velocity, .. }
            | Self::Bounce { velocity, .. }
            | Self::Parabola { velocity, .. }
            | Self::Turn { velocity, .. } => velocity.map(f64::from),
        }
    }

    /// Turn rate of the velocity.
    pub(crate) fn turn_rate_rad_s(&self) -> f64 {
        match self {
            Self::Turn { rate_rad_s, .. } => f64::from(*rate_rad_s),
            Self::Rest { .. } | Self::Line { .. } | Self::Bounce { .. } | Self::Parabola { .. } => {
                0.0
            }
        }
    }

    /// The mean of the points.
    pub(crate) fn rest(points: &[Point]) -> Self {
        let n = points.len() as f64;
        let mean = points.iter().fold([0.0; 2], |sum, point| {
            add(sum, scale(point.position, 1.0 / n))
        });
        Self::Rest {
            origin: single(mean),
        }
    }

    /// A line through the points. Rest at the newest one for fewer than two.
    pub(crate) fn line(points: &[Point]) -> Self {
        match Line::fit(points) {
            Some(line) => Self::Line {
                origin: single(line.origin),
                velocity: single(line.velocity),
            },
            None => Self::NONE,
        }
    }

    /// A line through the points that is reflected at the bounds.
    pub(crate) fn bounce(points: &[Point], bounds: [[f64; 2]; 2]) -> Self {
        match Line::fit(points) {
            Some(line) => Self::Bounce {
                origin: single(line.origin),
                velocity: single(line.velocity),
                bounds: bounds.map(single),
            },
            None => Self::NONE,
        }
    }

    /// A parabola through the points. A line for fewer than three.
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

    /// A turn through the points with a limited rate. A line for fewer than three points, or if
    /// they do not move.
    pub(crate) fn turn(points: &[Point], max_rad_s: f64) -> Self {
        match turn(points, max_rad_s) {
            Some((origin, velocity, rate)) => Self::Turn {
                origin: single(origin),
                velocity: single(velocity),
                rate_rad_s: rate as f32,
            },
            None => Self::line(points),
        }
    }
}

fn single(vector: [f64; 2]) -> [f32; 2] {
    vector.map(|component| component as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::past::tests::points;
    use crate::vector::{norm_squared, sub};
    use libm::{cos, sin};

    fn error(
        motion: &Motion,
        ahead_s: f64,
        newest_s: f64,
        position: impl Fn(f64) -> [f64; 2],
    ) -> f64 {
        let expected = sub(position(newest_s + ahead_s), position(newest_s));
        norm_squared(sub(motion.at(ahead_s as f32).map(f64::from), expected))
    }

    #[test]
    fn line_is_exact_on_a_line() {
        let position = |t: f64| [1000.0 + 30.0 * t, -7.0 * t];
        for n in 2..9 {
            let (points, newest_s) = points(n, position);
            let line = Motion::line(&points);
            assert!(error(&line, 1.0, newest_s, position) < 1e-8, "{n} samples");
            assert!((line.velocity()[0] - 30.0).abs() < 1e-5);
        }
        assert_eq!(Motion::line(&[]), Motion::NONE);
    }

    #[test]
    fn turn_is_exact_on_circles_from_three_points_on() {
        for rate in [-4.0_f64, -0.5, 1e-3, 0.7, 3.0] {
            let position = |t: f64| [500.0 + 60.0 * sin(rate * t), 60.0 * cos(rate * t)];
            for n in 3..12 {
                let (points, newest_s) = points(n, position);
                let turn = Motion::turn(&points, 9.0);
                let error = error(&turn, 1.0, newest_s, position);
                assert!(error < 1e-6, "{rate} {n}: {error:?}");
            }
        }
    }

    #[test]
    fn turn_of_a_noisy_line_is_almost_a_line() {
        let (points, _) = points(8, |t| {
            let jitter = 0.3 * cos(core::f64::consts::PI * 15.0 * t);
            [50.0 * t, jitter]
        });
        let rate = Motion::turn(&points, 9.0).turn_rate_rad_s();
        assert!(rate.abs() < 0.2, "{rate}");
    }

    #[test]
    fn an_object_at_rest_does_not_turn() {
        let (points, _) = points(8, |_| [1.0, 2.0]);
        let rest = Motion::turn(&points, 9.0);
        assert_eq!((rest.at(2.0), rest.turn_rate_rad_s()), ([0.0; 2], 0.0));
    }

    #[test]
    fn bounds_reflect_a_line() {
        let motion = Motion::Bounce {
            origin: [0.0; 2],
            velocity: [10.0, 4.0],
            bounds: [[-5.0, -5.0], [6.0, 100.0]],
        };
        assert_eq!(motion.at(0.5), [5.0, 2.0]);
        assert_eq!(motion.at(1.0), [2.0, 4.0]);
        assert_eq!(motion.at(9.0)[0], -5.0, "not through the other wall");
    }
}
