//! Motions with exact truth: the kinds in the stored table, and the wider family that the start
//! weights are trained on. Lengths are in pixels, times in seconds.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use crate::random::Random;

/// Integration steps per frame.
const SUBSTEPS: usize = 8;
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

struct Body {
    position: [f64; 2],
    heading: f64,
}

impl Body {
    fn advance(&mut self, distance: f64) {
        self.position[0] += distance * self.heading.cos();
        self.position[1] += distance * self.heading.sin();
    }

    /// Reflects the heading at the walls of the floor.
    fn bounce(&mut self) {
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
    fn integrate(n: usize, step_s: f64, mut next: impl FnMut(f64, f64) -> [f64; 2]) -> Self {
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

/// A random process for a speed or a turn rate.
enum Process {
    Nothing,
    Constant(f64),
    /// Mean-reverting noise (Ornstein and Uhlenbeck).
    Wandering {
        value: f64,
        memory_s: f64,
    },
    /// Steps with a limited slope.
    Stepping {
        value: f64,
        target: f64,
        change_s: f64,
        slope: f64,
    },
    Swinging {
        phase: f64,
        rate: f64,
    },
    Fading {
        value: f64,
        time_s: f64,
    },
    White,
}

impl Process {
    fn of(choice: usize, random: &mut Random) -> Self {
        match choice {
            0 => Self::Nothing,
            1 => Self::Constant(random.normal()),
            2 => Self::Wandering {
                value: random.normal(),
                memory_s: random.ratio(0.15, 3.0),
            },
            3 => {
                let value = random.normal();
                Self::Stepping {
                    value,
                    target: value,
                    change_s: random.exponential(1.5),
                    slope: random.ratio(2.0, 40.0),
                }
            }
            4 => Self::Swinging {
                phase: random.between(0.0, TAU),
                rate: TAU * random.between(0.1, 0.9),
            },
            5 => Self::Fading {
                value: 1.5 * random.normal(),
                time_s: random.between(0.5, 5.0),
            },
            _ => Self::White,
        }
    }

    fn next(&mut self, t: f64, dt: f64, random: &mut Random) -> f64 {
        match self {
            Self::Nothing => 0.0,
            Self::Constant(value) => *value,
            Self::Wandering { value, memory_s } => {
                let keep = (-dt / *memory_s).exp();
                *value = keep * *value + (1.0 - keep * keep).sqrt() * random.normal();
                *value
            }
            Self::Stepping {
                value,
                target,
                change_s,
                slope,
            } => {
                if t > *change_s {
                    *target = if random.chance(0.65) {
                        random.normal()
                    } else {
                        0.0
                    };
                    *change_s = t + random.exponential(1.5);
                }
                *value += (*target - *value).clamp(-*slope * dt, *slope * dt);
                *value
            }
            Self::Swinging { phase, rate } => 1.3 * (*rate * t + *phase).sin(),
            Self::Fading { value, time_s } => *value / (1.0 + t / *time_s),
            Self::White => 0.5 * random.normal() / dt.sqrt(),
        }
    }
}

/// A random index with the given weights.
fn drawn(weights: &[f64], random: &mut Random) -> usize {
    let mut left = random.uniform() * weights.iter().sum::<f64>();
    for (i, weight) in weights.iter().enumerate() {
        left -= weight;
        if left < 0.0 {
            return i;
        }
    }
    weights.len() - 1
}

/// A generated track for training: the truth, and the measurements of a camera.
#[derive(Debug, Clone)]
pub struct Example {
    /// The truth.
    pub path: Path,
    /// Nominal time between two frames.
    pub step_s: f64,
    /// Time and position of every measurement.
    pub samples: Vec<(f64, [f64; 2])>,
    /// Heading at every measurement, if the object has a marker.
    pub headings: Option<Vec<f64>>,
    /// Standard deviation of the noise.
    pub sigma: f64,
}

/// Draws a motion from the wide family. Speed and turn rate follow random processes, with stops,
/// sudden turns, walls, noise of several kinds and gaps.
#[must_use]
pub fn example(seed: u64, n: usize) -> Example {
    let random = &mut Random::new(seed ^ 0x5eed);
    let rate =
        [15.0, 30.0, 60.0, 10.0, 5.0, 2.5][drawn(&[0.33, 0.17, 0.04, 0.08, 0.08, 0.30], random)];
    let step_s: f64 = 1.0 / rate;
    // An object crosses the picture of a slow camera within a few dozen frames.
    let n = if rate < 8.0 { n / 3 } else { n };
    // Slow cameras observe slow motion.
    let slow = if rate < 8.0 {
        random.between(1.0, 3.0)
    } else {
        1.0
    };
    let typical = random.ratio(6.0, 160.0);
    let mut turning = {
        let choice = drawn(&[0.25, 0.2, 0.12, 0.2, 0.1, 0.05, 0.08], random);
        Process::of(choice, random)
    };
    let turn_scale = random.ratio(0.08, 3.0) / slow;
    let mut pushing = {
        let choice = drawn(&[0.5, 0.06, 0.12, 0.22, 0.1], random);
        Process::of(choice, random)
    };
    let push_scale = random.ratio(0.1, 1.2) / slow;
    let stops = random.chance(0.35);
    let (run_s, stop_s) = (random.ratio(0.8, 4.0) * slow, random.ratio(0.4, 2.5) * slow);
    let brake = random.ratio(0.8, 6.0) / slow;
    let parked = random.chance(0.06);
    let jumps_per_s = if random.chance(0.2) {
        random.between(0.1, 0.6) / slow
    } else {
        0.0
    };
    let walls = random.chance(0.15);
    let shake = if random.chance(0.05) {
        random.ratio(2.0, 30.0)
    } else {
        0.0
    };
    // Pedestrians: the velocity drifts about the intended one.
    let drift_speed = if random.chance(0.25) {
        typical * random.ratio(0.03, 0.4)
    } else {
        0.0
    };
    let drift_memory_s = random.ratio(0.4, 4.0);
    let mut drift = [random.normal(), random.normal()];
    let mut body = Body {
        position: [random.between(60.0, 580.0), random.between(60.0, 420.0)],
        heading: random.between(-PI, PI),
    };
    let (mut pace, mut going, mut moving) = (1.0_f64, 1.0_f64, true);
    let mut change_s = random.exponential(run_s);
    let mut headings = Vec::new();
    let mut fine = 0;
    let path = Path::integrate(n, step_s, |t, dt| {
        if fine % SUBSTEPS == 0 {
            headings.push(body.heading);
        }
        fine += 1;
        let turn = turn_scale * turning.next(t, dt, random);
        pace = (pace + push_scale * pushing.next(t, dt, random) * dt).clamp(0.0, 2.2);
        if stops && t > change_s {
            moving = !moving;
            change_s = t + if moving {
                random.exponential(run_s)
            } else {
                random.between(0.5, 1.5) * stop_s
            };
        }
        let target_speed = if moving || !stops { 1.0 } else { 0.0 };
        going += (target_speed - going).clamp(-brake * dt, brake * dt);
        body.heading += turn * dt;
        if random.chance(jumps_per_s * dt) {
            body.heading += random.between(-PI, PI);
        }
        if !parked {
            body.advance(typical * pace * going * dt);
            for axis in &mut body.position {
                *axis += shake * random.normal() * dt.sqrt();
            }
            if drift_speed > 0.0 {
                let keep = (-dt / drift_memory_s).exp();
                for (axis, drift) in body.position.iter_mut().zip(&mut drift) {
                    *drift = keep * *drift + (1.0 - keep * keep).sqrt() * random.normal();
                    *axis += drift_speed * *drift * dt;
                }
            }
            if walls {
                body.bounce();
            }
        }
        body.position
    });
    let sigma = if random.chance(0.12) {
        0.0
    } else {
        random.ratio(0.03, 1.6)
    };
    // Part of the noise of a real camera is correlated from frame to frame.
    let correlation = if random.chance(0.3) {
        random.between(0.3, 0.97)
    } else {
        0.0
    };
    let share = if correlation > 0.0 {
        random.between(0.3, 1.0)
    } else {
        0.0
    };
    let sway = if rate < 40.0 && random.chance(0.15) {
        [
            typical * random.between(0.01, 0.06),
            TAU * random.between(0.7, 2.2),
            random.between(0.0, TAU),
        ]
    } else {
        [0.0; 3]
    };
    let rounded = random.chance(0.08);
    // Outliers: sometimes another object within a few frames' distance is taken for this one.
    let outlier_rate = if random.chance(0.2) { 0.015 } else { 0.0 };
    let mut offset = [random.normal(), random.normal()];
    let gaps = random.chance(0.35);
    let losses = if random.chance(0.15) { 0.1 } else { 0.0 };
    let uneven = random.chance(0.2);
    let mut samples = Vec::with_capacity(n);
    let mut read_headings = Vec::with_capacity(n);
    let mut hidden = 0;
    for (frame, heading) in headings.iter().enumerate() {
        let mut time_s = frame as f64 * step_s;
        if uneven && frame > 0 && frame + 1 < n {
            time_s += step_s * random.between(-0.2, 0.2);
        }
        let fresh = [random.normal(), random.normal()];
        offset = [0, 1].map(|axis| {
            correlation * offset[axis] + (1.0 - correlation * correlation).sqrt() * random.normal()
        });
        if gaps && hidden == 0 && frame > 6 && random.chance(0.03) {
            hidden = 1 + random.below(10);
        }
        if hidden > 0 {
            hidden -= 1;
            continue;
        }
        if frame > 3 && random.chance(losses) {
            continue;
        }
        let Some(position) = path.at(time_s) else {
            continue;
        };
        let swing = [
            0.5 * (sway[1] * time_s * 2.0 + sway[2]).sin(),
            (sway[1] * time_s + sway[2]).sin(),
        ];
        let (s, c) = heading.sin_cos();
        let sway = [
            sway[0] * (c * swing[0] - s * swing[1]),
            sway[0] * (s * swing[0] + c * swing[1]),
        ];
        let mut position = [0, 1].map(|axis| {
            position[axis]
                + sway[axis]
                + sigma * (share.sqrt() * offset[axis] + (1.0 - share).sqrt() * fresh[axis])
        });
        if random.chance(outlier_rate) {
            let reach = 4.0 * typical * step_s + 4.0 * sigma;
            position = position.map(|c| c + random.between(-reach, reach));
        }
        if rounded {
            position = position.map(f64::round);
        }
        samples.push((time_s, position));
        read_headings.push(heading + 0.004 * random.normal());
    }
    let headings = random.chance(0.3).then_some(read_headings);
    Example {
        path,
        step_s,
        samples,
        headings,
        sigma,
    }
}
