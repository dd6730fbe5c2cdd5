//! Motions with exact truth: the kinds in the stored table, and the wider family that the start
//! weights are trained on. Lengths are in pixels, times in seconds.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::random::Random;

/// Integration steps per frame.
pub(crate) const SUBSTEPS: usize = 8;
/// Size of the floor for bouncing motions.
const FLOOR: [f64; 2] = [640.0, 480.0];

/// The kinds of motion in the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// At rest.
    Rest,
    /// A straight line.
    Straight,
    /// A circle.
    Circle,
    /// Steers like a car, with a new steering angle from time to time.
    Car,
    /// Stops and continues in a slightly different direction.
    StopAndGo,
    /// Oscillates about a line.
    Slalom,
    /// A straight line reflected at the walls of the floor.
    Bounce,
    /// The heading is a random walk.
    RandomWalk,
    /// Along a rectangle, turning on the spot at the corners.
    Patrol,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 9] = [
        Self::Rest,
        Self::Straight,
        Self::Circle,
        Self::Car,
        Self::StopAndGo,
        Self::Slalom,
        Self::Bounce,
        Self::RandomWalk,
        Self::Patrol,
    ];

    /// The true path of a run of `n` frames.
    #[must_use]
    pub fn path(self, seed: u64, n: usize, step_s: f64) -> Path {
        let mut random = Random::new(seed * 31 + self as u64);
        let cruise = random.between(20.0, 110.0);
        let sign = random.sign();
        let turn = sign * random.between(0.3, 2.0);
        let swing = random.between(0.4, 1.0);
        let phase_rad_s = TAU * random.between(0.2, 0.6);
        let phase = random.between(0.0, TAU);
        let wander = random.between(0.3, 1.0);
        let legs_s = [random.between(40.0, 140.0), random.between(30.0, 100.0)].map(|l| l / cruise);
        let corner_s = random.between(0.3, 0.6);
        let brake = random.between(80.0, 220.0);
        let mut body = Body {
            position: [random.between(100.0, 540.0), random.between(100.0, 380.0)],
            heading: random.between(-PI, PI),
        };
        let (mut speed, mut going) = (cruise, true);
        let mut change_s = random.between(0.5, 3.0);
        let (mut steering, mut steering_to) = (0.0_f64, 0.0);
        let (mut leg, mut leg_s) = (0, 0.0);
        Path::integrate(n, step_s, |t, dt| {
            match self {
                Self::Rest => speed = 0.0,
                Self::Straight | Self::Bounce => {}
                Self::Circle => body.heading += turn * dt,
                Self::Car => {
                    if t > change_s {
                        steering_to = if random.chance(0.7) {
                            random.between(-0.45, 0.45)
                        } else {
                            0.0
                        };
                        change_s = t + random.between(0.7, 2.5);
                    }
                    steering += (steering_to - steering).clamp(-1.5 * dt, 1.5 * dt);
                    body.heading += speed / 20.0 * steering.tan() * dt;
                }
                Self::StopAndGo => {
                    if t > change_s {
                        going = !going;
                        if going {
                            body.heading += 0.5 * random.normal();
                            change_s = t + random.between(1.0, 3.0);
                        } else {
                            change_s = t + random.between(0.8, 2.5);
                        }
                    }
                    let target_speed = if going { cruise } else { 0.0 };
                    speed += (target_speed - speed).clamp(-brake * dt, brake * dt);
                }
                Self::Slalom => {
                    body.heading += swing * phase_rad_s * (phase_rad_s * t + phase).cos() * dt;
                }
                Self::RandomWalk => body.heading += wander * random.normal() * dt.sqrt(),
                Self::Patrol => {
                    leg_s += dt;
                    let straight_s = legs_s[leg % 2];
                    if leg_s > straight_s + corner_s {
                        leg_s = 0.0;
                        leg += 1;
                    }
                    let turning = leg_s > straight_s;
                    speed = if turning { 0.0 } else { cruise };
                    if turning {
                        body.heading += sign * FRAC_PI_2 / corner_s * dt;
                    }
                }
            }
            body.advance(speed * dt);
            if self == Self::Bounce {
                body.bounce();
            }
            body.position
        })
    }
}

pub(crate) struct Body {
    pub(crate) position: [f64; 2],
    pub(crate) heading: f64,
}

impl Body {
    pub(crate) fn advance(&mut self, distance: f64) {
        self.position[0] += distance * self.heading.cos();
        self.position[1] += distance * self.heading.sin();
    }

    /// Reflects the heading at the walls of the floor.
    pub(crate) fn bounce(&mut self) {
        let [vx, vy] = [self.heading.cos(), self.heading.sin()];
        if (self.position[0] < 0.0 && vx < 0.0) || (self.position[0] > FLOOR[0] && vx > 0.0) {
            self.heading = PI - self.heading;
        }
        if (self.position[1] < 0.0 && vy < 0.0) || (self.position[1] > FLOOR[1] && vy > 0.0) {
            self.heading = -self.heading;
        }
    }
}

/// True positions, dense enough to interpolate.
#[derive(Debug, Clone)]
pub struct Path {
    fine: Vec<[f64; 2]>,
    substep_s: f64,
}

impl Path {
    pub(crate) fn integrate(
        n: usize,
        step_s: f64,
        mut next: impl FnMut(f64, f64) -> [f64; 2],
    ) -> Self {
        let substep_s = step_s / SUBSTEPS as f64;
        let fine = (0..n * SUBSTEPS)
            .map(|i| next(i as f64 * substep_s, substep_s))
            .collect();
        Self { fine, substep_s }
    }

    /// Position at a time. `None` after the end.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Option<[f64; 2]> {
        let at = time_s / self.substep_s;
        let index = (at + 1e-9) as usize;
        let part = (at - index as f64).max(0.0);
        let from = self.fine.get(index)?;
        let to = self.fine.get(index + 1).unwrap_or(from);
        Some([0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis])))
    }
}
