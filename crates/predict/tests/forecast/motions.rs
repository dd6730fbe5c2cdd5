//! Motions with exact truth and reproducible noise, in pixels at 15 frames a second.

/// Nominal time between two frames.
pub(crate) const STEP_S: f64 = 1.0 / 15.0;

/// Numbers that look random and are the same on every machine (SplitMix64).
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Evenly distributed in [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.uniform()
    }

    /// Normally distributed, variance 1: twelve uniform numbers.
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Kinds of motion.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Motion {
    Rest,
    Straight,
    Circle,
    StopAndGo,
    Bounce,
    Slalom,
    Patrol,
}

impl Motion {
    pub(crate) const ALL: [Self; 7] = [
        Self::Rest,
        Self::Straight,
        Self::Circle,
        Self::StopAndGo,
        Self::Bounce,
        Self::Slalom,
        Self::Patrol,
    ];

    /// Places of one run, one a frame.
    pub(crate) fn path(self, seed: u64, n: usize) -> Vec<[f64; 2]> {
        const SUBSTEPS: usize = 8;
        let mut noise = Noise::new(seed.wrapping_mul(977) ^ self as u64);
        let cruise = noise.between(20.0, 110.0);
        let turn = noise.between(0.4, 2.0) * if noise.uniform() < 0.5 { -1.0 } else { 1.0 };
        let period_s = noise.between(1.5, 4.0);
        let leg_s = noise.between(1.0, 2.5);
        let mut place = [noise.between(50.0, 590.0), noise.between(50.0, 430.0)];
        let mut heading = noise.between(-3.1, 3.1);
        let mut bounce = [1.0_f64; 2];
        let mut speed = cruise;
        let (mut going, mut change_s) = (true, noise.between(0.5, 3.0));
        let mut path = Vec::with_capacity(n);
        let dt = STEP_S / SUBSTEPS as f64;
        for i in 0..n * SUBSTEPS {
            if i % SUBSTEPS == 0 {
                path.push(place);
            }
            let t = i as f64 * dt;
            match self {
                Self::Rest => speed = 0.0,
                Self::Straight => {}
                Self::Circle => heading += turn * dt,
                Self::StopAndGo => {
                    if t > change_s {
                        going = !going;
                        change_s = t + noise.between(0.8, 2.5);
                        heading += if going { noise.between(-0.8, 0.8) } else { 0.0 };
                    }
                    let wanted = if going { cruise } else { 0.0 };
                    speed += (wanted - speed).clamp(-150.0 * dt, 150.0 * dt);
                }
                Self::Bounce => {
                    for (axis, most) in [640.0, 480.0].into_iter().enumerate() {
                        if place[axis] < 0.0 {
                            bounce[axis] = bounce[axis].abs() * heading_sign(heading, axis);
                        } else if place[axis] > most {
                            bounce[axis] = -bounce[axis].abs() * heading_sign(heading, axis);
                        }
                    }
                }
                Self::Slalom => {
                    let phase = core::f64::consts::TAU / period_s;
                    heading += 0.8 * phase * (phase * t).cos() * dt;
                }
                Self::Patrol => {
                    let in_leg_s = t % (leg_s + 0.4);
                    let turning = in_leg_s > leg_s;
                    speed = if turning { 0.0 } else { cruise };
                    if turning {
                        heading += turn.signum() * core::f64::consts::FRAC_PI_2 / 0.4 * dt;
                    }
                }
            }
            place[0] += bounce[0] * speed * heading.cos() * dt;
            place[1] += bounce[1] * speed * heading.sin() * dt;
        }
        path
    }
}

/// Sign of the heading's component, so that a wall sends the object inwards.
fn heading_sign(heading: f64, axis: usize) -> f64 {
    [heading.cos(), heading.sin()][axis].signum()
}
