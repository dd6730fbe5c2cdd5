//! Motions that a few numbers describe, fitted to an object's last places by least squares: rest, a straight line,
//! with walls or without, a parabola, and a constant turn (`turn`).
//!
//! Everything is relative to the newest place and its moment, in seconds and units, so that uneven frames and
//! far-away origins do not matter.

use libm::sinf;

use crate::forecast::line::Line;
use crate::forecast::parabola::parabola;
use crate::forecast::past::Point;
use crate::forecast::turn::turn;
use crate::vector::{add, scale};

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

fn single(vector: [f64; 2]) -> [f32; 2] {
    vector.map(|component| component as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::past::tests::points;
    use crate::vector::{norm_squared, sub};
    use libm::{cos, sin};

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
