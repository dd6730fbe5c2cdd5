//! The wide family of generated tracks that the start weights are trained on. Lengths are in
//! pixels, times in seconds.

use std::f64::consts::{PI, TAU};

use crate::motions::{Body, Path, SUBSTEPS};
use crate::random::Random;

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

/// Draws a track of at most `n` frames from the wide family.
#[must_use]
pub fn example(seed: u64, n: usize) -> Example {
    let random = &mut Random::new(seed ^ 0x5eed);
    let rate =
        [15.0, 30.0, 60.0, 10.0, 5.0, 2.5][drawn(&[0.33, 0.17, 0.04, 0.08, 0.08, 0.30], random)];
    let step_s: f64 = 1.0 / rate;
    // An object crosses the picture of a slow camera within a few dozen frames.
    let n = if rate < 8.0 { n / 3 } else { n };
    let mut mover = Mover::draw(rate, random);
    let mut headings = Vec::new();
    let mut substep = 0;
    let path = Path::integrate(n, step_s, |t, dt| {
        if substep % SUBSTEPS == 0 {
            headings.push(mover.body.heading);
        }
        substep += 1;
        mover.step(t, dt, random);
        mover.body.position
    });
    let mut camera = Camera::draw(rate, mover.typical_speed, random);
    let mut samples = Vec::with_capacity(n);
    let mut read_headings = Vec::with_capacity(n);
    for (frame, heading) in headings.iter().enumerate() {
        let mut time_s = frame as f64 * step_s;
        if camera.uneven && frame > 0 && frame + 1 < n {
            time_s += step_s * random.between(-0.2, 0.2);
        }
        if let Some(position) = camera.measure(&path, *heading, frame, time_s, random) {
            samples.push((time_s, position));
            read_headings.push(heading + 0.004 * random.normal());
        }
    }
    let headings = random.chance(0.3).then_some(read_headings);
    Example {
        path,
        step_s,
        samples,
        headings,
        sigma: camera.sigma,
    }
}

/// An object whose speed and turn rate follow random processes, with stops, sudden turns and walls.
struct Mover {
    typical_speed: f64,
    turning: Process,
    turn_scale: f64,
    pushing: Process,
    push_scale: f64,
    stops: bool,
    run_s: f64,
    stop_s: f64,
    brake: f64,
    parked: bool,
    jumps_per_s: f64,
    walls: bool,
    shake: f64,
    /// Pedestrians: the velocity drifts about the intended one.
    drift_speed: f64,
    drift_memory_s: f64,
    drift: [f64; 2],
    body: Body,
    /// Intended speed over the typical one, and the part of it that braking leaves.
    pace: f64,
    throttle: f64,
    moving: bool,
    /// When it stops or starts again.
    change_s: f64,
}

impl Mover {
    fn draw(rate: f64, random: &mut Random) -> Self {
        // Slow cameras observe slow motion.
        let slow = if rate < 8.0 {
            random.between(1.0, 3.0)
        } else {
            1.0
        };
        let typical_speed = random.ratio(6.0, 160.0);
        let choice = drawn(&[0.25, 0.2, 0.12, 0.2, 0.1, 0.05, 0.08], random);
        let turning = Process::of(choice, random);
        let turn_scale = random.ratio(0.08, 3.0) / slow;
        let choice = drawn(&[0.5, 0.06, 0.12, 0.22, 0.1], random);
        let pushing = Process::of(choice, random);
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
        let drift_speed = if random.chance(0.25) {
            typical_speed * random.ratio(0.03, 0.4)
        } else {
            0.0
        };
        Self {
            typical_speed,
            turning,
            turn_scale,
            pushing,
            push_scale,
            stops,
            run_s,
            stop_s,
            brake,
            parked,
            jumps_per_s,
            walls,
            shake,
            drift_speed,
            drift_memory_s: random.ratio(0.4, 4.0),
            drift: [random.normal(), random.normal()],
            body: Body {
                position: [random.between(60.0, 580.0), random.between(60.0, 420.0)],
                heading: random.between(-PI, PI),
            },
            pace: 1.0,
            throttle: 1.0,
            moving: true,
            change_s: random.exponential(run_s),
        }
    }

    fn step(&mut self, t: f64, dt: f64, random: &mut Random) {
        let turn = self.turn_scale * self.turning.next(t, dt, random);
        let push = self.push_scale * self.pushing.next(t, dt, random);
        self.pace = (self.pace + push * dt).clamp(0.0, 2.2);
        if self.stops && t > self.change_s {
            self.moving = !self.moving;
            self.change_s = t + if self.moving {
                random.exponential(self.run_s)
            } else {
                random.between(0.5, 1.5) * self.stop_s
            };
        }
        let target = if self.moving || !self.stops { 1.0 } else { 0.0 };
        self.throttle += (target - self.throttle).clamp(-self.brake * dt, self.brake * dt);
        self.body.heading += turn * dt;
        if random.chance(self.jumps_per_s * dt) {
            self.body.heading += random.between(-PI, PI);
        }
        if self.parked {
            return;
        }
        self.body
            .advance(self.typical_speed * self.pace * self.throttle * dt);
        for axis in &mut self.body.position {
            *axis += self.shake * random.normal() * dt.sqrt();
        }
        if self.drift_speed > 0.0 {
            let keep = (-dt / self.drift_memory_s).exp();
            for (axis, drift) in self.body.position.iter_mut().zip(&mut self.drift) {
                *drift = keep * *drift + (1.0 - keep * keep).sqrt() * random.normal();
                *axis += self.drift_speed * *drift * dt;
            }
        }
        if self.walls {
            self.body.bounce();
        }
    }
}

/// A camera with noise of several kinds, gaps and outliers.
struct Camera {
    /// Standard deviation of the noise.
    sigma: f64,
    /// Part of the noise of a real camera is correlated from frame to frame: its correlation, its
    /// share of the variance, and its current value.
    correlation: f64,
    share: f64,
    offset: [f64; 2],
    /// The measured point of a walker sways: amplitude, angular frequency, phase.
    sway: [f64; 3],
    rounded: bool,
    /// Sometimes another object within a few frames' distance is taken for this one.
    outlier_rate: f64,
    outlier_reach: f64,
    gaps: bool,
    losses: f64,
    uneven: bool,
    /// Remaining frames of the current gap.
    hidden: usize,
}

impl Camera {
    fn draw(rate: f64, typical_speed: f64, random: &mut Random) -> Self {
        let sigma = if random.chance(0.12) {
            0.0
        } else {
            random.ratio(0.03, 1.6)
        };
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
                typical_speed * random.between(0.01, 0.06),
                TAU * random.between(0.7, 2.2),
                random.between(0.0, TAU),
            ]
        } else {
            [0.0; 3]
        };
        let step_s: f64 = 1.0 / rate;
        Self {
            sigma,
            correlation,
            share,
            sway,
            rounded: random.chance(0.08),
            outlier_rate: if random.chance(0.2) { 0.015 } else { 0.0 },
            outlier_reach: 4.0 * typical_speed * step_s + 4.0 * sigma,
            offset: [random.normal(), random.normal()],
            gaps: random.chance(0.35),
            losses: if random.chance(0.15) { 0.1 } else { 0.0 },
            uneven: random.chance(0.2),
            hidden: 0,
        }
    }

    /// The measured position in a frame, if there is one.
    fn measure(
        &mut self,
        path: &Path,
        heading: f64,
        frame: usize,
        time_s: f64,
        random: &mut Random,
    ) -> Option<[f64; 2]> {
        let (correlation, share) = (self.correlation, self.share);
        let fresh = [random.normal(), random.normal()];
        self.offset = [0, 1].map(|axis| {
            correlation * self.offset[axis]
                + (1.0 - correlation * correlation).sqrt() * random.normal()
        });
        if self.gaps && self.hidden == 0 && frame > 6 && random.chance(0.03) {
            self.hidden = 1 + random.below(10);
        }
        if self.hidden > 0 {
            self.hidden -= 1;
            return None;
        }
        if frame > 3 && random.chance(self.losses) {
            return None;
        }
        let position = path.at(time_s)?;
        let [amplitude, rate_rad_s, phase] = self.sway;
        let swing = [
            0.5 * (rate_rad_s * time_s * 2.0 + phase).sin(),
            (rate_rad_s * time_s + phase).sin(),
        ];
        let (s, c) = heading.sin_cos();
        let sway = [
            amplitude * (c * swing[0] - s * swing[1]),
            amplitude * (s * swing[0] + c * swing[1]),
        ];
        let mut position = [0, 1].map(|axis| {
            position[axis]
                + sway[axis]
                + self.sigma
                    * (share.sqrt() * self.offset[axis] + (1.0 - share).sqrt() * fresh[axis])
        });
        if random.chance(self.outlier_rate) {
            position =
                position.map(|c| c + random.between(-self.outlier_reach, self.outlier_reach));
        }
        if self.rounded {
            position = position.map(f64::round);
        }
        Some(position)
    }
}
