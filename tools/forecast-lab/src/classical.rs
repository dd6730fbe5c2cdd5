//! Classical predictors as a baseline.
//!
//! Filters use frames and a unit of length in which the typical speed of the scene is
//! `TYPICAL_STEP` per frame, so that one tuning serves pixels and metres.

use nalgebra::{SMatrix, SVector};

/// Predicts the positions of one object.
pub trait Predictor {
    /// Adds a sample. Times are in seconds and increase.
    fn observe(&mut self, time_s: f64, position: [f64; 2]);
    /// Position `ahead_s` after the newest sample, and its covariance if the predictor has one.
    fn at(&self, ahead_s: f64) -> ([f64; 2], Option<[[f64; 2]; 2]>);
}

/// What the filters know about a scene.
#[derive(Debug, Clone, Copy)]
pub struct Scale {
    /// Nominal time between two samples in seconds.
    pub step_s: f64,
    /// Typical distance between two samples, in units.
    pub step_length: f64,
    /// Standard deviation of a sample, in units.
    pub sigma: f64,
}

/// Distance per frame in the filters' unit.
const TYPICAL_STEP: f64 = 5.0;

impl Scale {
    fn units(&self) -> f64 {
        TYPICAL_STEP / self.step_length.max(1e-12)
    }

    /// Variance of a sample in the filters' unit, not below what a camera can measure.
    fn variance(&self) -> f64 {
        (self.sigma * self.units()).max(0.02).powi(2)
    }
}

/// A least-squares polynomial through the newest samples.
pub struct Polynomial {
    degree: usize,
    window: usize,
    samples: Vec<(f64, [f64; 2])>,
}

impl Polynomial {
    /// The newest position.
    #[must_use]
    pub fn hold() -> Self {
        Self::new(0, 1)
    }

    /// The velocity between the two newest positions.
    #[must_use]
    pub fn cv() -> Self {
        Self::new(1, 2)
    }

    /// A line through the five newest positions.
    #[must_use]
    pub fn line5() -> Self {
        Self::new(1, 5)
    }

    /// A parabola through the eight newest positions.
    #[must_use]
    pub fn parabola8() -> Self {
        Self::new(2, 8)
    }

    fn new(degree: usize, window: usize) -> Self {
        Self {
            degree,
            window,
            samples: Vec::new(),
        }
    }
}

impl Predictor for Polynomial {
    fn observe(&mut self, time_s: f64, position: [f64; 2]) {
        if self.samples.len() == self.window {
            self.samples.remove(0);
        }
        self.samples.push((time_s, position));
    }

    fn at(&self, ahead_s: f64) -> ([f64; 2], Option<[[f64; 2]; 2]>) {
        let Some((newest_s, newest)) = self.samples.last().copied() else {
            return ([f64::NAN; 2], None);
        };
        let degree = self.degree.min(self.samples.len() - 1);
        let span = (newest_s - self.samples[0].0).max(1e-12);
        let powers = |time_s: f64| {
            let t = time_s / span;
            SVector::<f64, 3>::from_fn(|i, _| if i <= degree { t.powi(i as i32) } else { 0.0 })
        };
        let mut normal = SMatrix::<f64, 3, 3>::zeros();
        let mut right = SMatrix::<f64, 3, 2>::zeros();
        for (time_s, position) in &self.samples {
            let row = powers(time_s - newest_s);
            normal += row * row.transpose();
            for axis in 0..2 {
                right
                    .column_mut(axis)
                    .axpy(position[axis] - newest[axis], &row, 1.0);
            }
        }
        for i in degree + 1..3 {
            normal[(i, i)] = 1.0;
        }
        let Some(cholesky) = normal.cholesky() else {
            return (newest, None);
        };
        let fit = cholesky.solve(&right).transpose() * powers(ahead_s);
        ([newest[0] + fit[0], newest[1] + fit[1]], None)
    }
}

type State = SVector<f64, 7>;
type Square = SMatrix<f64, 7, 7>;

/// A motion model of a filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// Constant velocity.
    Velocity,
    /// Constant turn rate.
    Turn,
    /// Constant acceleration.
    Acceleration,
}

/// One or several interacting Kalman filters over (x, y, vx, vy, ax, ay, turn rate) (Blom and
/// Bar-Shalom's IMM).
pub struct Filters {
    modes: Vec<(Mode, f64)>,
    /// Process noise of the turn rate: variance per frame.
    turn_noise: f64,
    /// Probability of staying in a mode for a frame.
    stay: f64,
    scale: Scale,
    states: Vec<(State, Square)>,
    shares: Vec<f64>,
    last_s: Option<f64>,
}

impl Filters {
    /// A Kalman filter with constant velocity.
    #[must_use]
    pub fn kalman_cv(scale: Scale) -> Self {
        Self::new(vec![(Mode::Velocity, KALMAN_NOISE)], 0.0, 1.0, scale)
    }

    /// Interacting filters with constant velocity, turn rate and acceleration.
    #[must_use]
    pub fn imm(scale: Scale) -> Self {
        let modes = vec![
            (Mode::Velocity, IMM_NOISE[0]),
            (Mode::Turn, IMM_NOISE[1]),
            (Mode::Acceleration, IMM_NOISE[2]),
        ];
        Self::new(modes, IMM_TURN_NOISE, IMM_STAY, scale)
    }

    fn new(modes: Vec<(Mode, f64)>, turn_noise: f64, stay: f64, scale: Scale) -> Self {
        let n = modes.len();
        Self {
            modes,
            turn_noise,
            stay,
            scale,
            states: Vec::new(),
            shares: vec![1.0 / n as f64; n],
            last_s: None,
        }
    }

    fn start(&mut self, position: [f64; 2]) {
        let r = self.scale.variance();
        let mut state = State::zeros();
        (state[0], state[1]) = (position[0], position[1]);
        self.states = self
            .modes
            .iter()
            .map(|(mode, _)| {
                let mut variances = State::zeros();
                (variances[0], variances[1]) = (r, r);
                (variances[2], variances[3]) = (25.0, 25.0);
                match mode {
                    Mode::Velocity => {}
                    Mode::Turn => variances[6] = 0.01,
                    Mode::Acceleration => (variances[4], variances[5]) = (0.25, 0.25),
                }
                (state, Square::from_diagonal(&variances))
            })
            .collect();
    }

    /// Mixes the states of all filters by the transition probabilities.
    fn mix(&mut self) {
        let n = self.modes.len();
        if n == 1 {
            return;
        }
        let change = (1.0 - self.stay) / (n - 1) as f64;
        let before = self.states.clone();
        let shares = self.shares.clone();
        for to in 0..n {
            let weight = |from: usize| if from == to { self.stay } else { change } * shares[from];
            let total: f64 = (0..n).map(weight).sum();
            let mut state = State::zeros();
            for (from, (x, _)) in before.iter().enumerate() {
                state += x * (weight(from) / total);
            }
            let mut covariance = Square::zeros();
            for (from, (x, p)) in before.iter().enumerate() {
                let deviation = x - state;
                covariance += (p + deviation * deviation.transpose()) * (weight(from) / total);
            }
            let clear: &[usize] = match self.modes[to].0 {
                Mode::Velocity => &[4, 5, 6],
                Mode::Turn => &[4, 5],
                Mode::Acceleration => &[6],
            };
            for i in clear {
                state[*i] = 0.0;
                covariance.row_mut(*i).fill(0.0);
                covariance.column_mut(*i).fill(0.0);
            }
            match self.modes[to].0 {
                Mode::Turn => covariance[(6, 6)] = covariance[(6, 6)].max(1e-5),
                Mode::Acceleration => {
                    for i in [4, 5] {
                        covariance[(i, i)] = covariance[(i, i)].max(1e-6);
                    }
                }
                Mode::Velocity => {}
            }
            self.states[to] = (state, covariance);
            self.shares[to] = total;
        }
    }

    fn predict(
        &self,
        mode: usize,
        state: &State,
        covariance: &Square,
        frames: f64,
    ) -> (State, Square) {
        let (kind, noise) = self.modes[mode];
        let (next, jacobian) = step(kind, state, frames);
        let mut q = Square::zeros();
        let t = frames;
        for a in 0..2 {
            if kind == Mode::Acceleration {
                let entries = [
                    (0, 0, t.powi(5) / 20.0),
                    (0, 2, t.powi(4) / 8.0),
                    (0, 4, t.powi(3) / 6.0),
                    (2, 2, t.powi(3) / 3.0),
                    (2, 4, t.powi(2) / 2.0),
                    (4, 4, t),
                ];
                for (i, j, value) in entries {
                    q[(i + a, j + a)] = noise * value;
                    q[(j + a, i + a)] = noise * value;
                }
            } else {
                q[(a, a)] = noise * t.powi(3) / 3.0;
                q[(a, 2 + a)] = noise * t.powi(2) / 2.0;
                q[(2 + a, a)] = q[(a, 2 + a)];
                q[(2 + a, 2 + a)] = noise * t;
            }
        }
        if kind == Mode::Turn {
            q[(6, 6)] = self.turn_noise * t;
        }
        (next, jacobian * covariance * jacobian.transpose() + q)
    }
}

/// Process noise of the acceleration (of its derivative in the last mode) and of the turn rate per
/// frame, and the probability of staying in a mode.
const KALMAN_NOISE: f64 = 0.3;
const IMM_NOISE: [f64; 3] = [1e-4, 1e-2, 1e-4];
const IMM_TURN_NOISE: f64 = 1e-4;
const IMM_STAY: f64 = 0.97;

impl Predictor for Filters {
    fn observe(&mut self, time_s: f64, position: [f64; 2]) {
        let position = position.map(|c| c * self.scale.units());
        let Some(last_s) = self.last_s.replace(time_s) else {
            self.start(position);
            return;
        };
        let frames = (time_s - last_s) / self.scale.step_s;
        self.mix();
        let r = self.scale.variance();
        let mut total = 0.0;
        for mode in 0..self.modes.len() {
            let (state, covariance) = self.states[mode];
            let (mut state, mut covariance) = self.predict(mode, &state, &covariance, frames);
            let columns = covariance.fixed_columns::<2>(0).into_owned();
            let innovation = SVector::<f64, 2>::new(position[0] - state[0], position[1] - state[1]);
            let s = covariance.fixed_view::<2, 2>(0, 0).into_owned()
                + SMatrix::<f64, 2, 2>::identity() * r;
            if let Some(inverse) = s.try_inverse() {
                let gain = columns * inverse;
                state += gain * innovation;
                covariance -= gain * columns.transpose();
                covariance = (covariance + covariance.transpose()) * 0.5;
                let distance = (innovation.transpose() * inverse * innovation)[0];
                self.shares[mode] *=
                    (-0.5 * distance.min(200.0)).exp() / s.determinant().max(1e-300).sqrt();
            }
            state[6] = state[6].clamp(-0.7, 0.7);
            self.states[mode] = (state, covariance);
            total += self.shares[mode];
        }
        let n = self.modes.len() as f64;
        for share in &mut self.shares {
            *share = if total > 1e-300 {
                (*share / total).max(1e-6)
            } else {
                1.0 / n
            };
        }
        let total: f64 = self.shares.iter().sum();
        for share in &mut self.shares {
            *share /= total;
        }
    }

    fn at(&self, ahead_s: f64) -> ([f64; 2], Option<[[f64; 2]; 2]>) {
        let frames = ahead_s / self.scale.step_s;
        let units = self.scale.units();
        let mut mean = [0.0; 2];
        let mut moments = [[0.0; 2]; 2];
        for (mode, ((state, covariance), share)) in self.states.iter().zip(&self.shares).enumerate()
        {
            let (state, covariance) = self.predict(mode, state, covariance, frames);
            for i in 0..2 {
                mean[i] += share * state[i];
                for j in 0..2 {
                    moments[i][j] += share * (covariance[(i, j)] + state[i] * state[j]);
                }
            }
        }
        let r = self.scale.variance();
        let covariance = [0, 1].map(|i| {
            [0, 1].map(|j| {
                let own = if i == j { r } else { 0.0 };
                (moments[i][j] - mean[i] * mean[j] + own) / (units * units)
            })
        });
        (mean.map(|c| c / units), Some(covariance))
    }
}

/// State after a number of frames, and its Jacobian.
fn step(mode: Mode, x: &State, t: f64) -> (State, Square) {
    let mut next = *x;
    let mut jacobian = Square::identity();
    match mode {
        Mode::Velocity => {
            for a in 0..2 {
                next[a] += t * x[2 + a];
                jacobian[(a, 2 + a)] = t;
            }
        }
        Mode::Acceleration => {
            for a in 0..2 {
                next[a] += t * x[2 + a] + 0.5 * t * t * x[4 + a];
                next[2 + a] += t * x[4 + a];
                jacobian[(a, 2 + a)] = t;
                jacobian[(a, 4 + a)] = 0.5 * t * t;
                jacobian[(2 + a, 4 + a)] = t;
            }
        }
        Mode::Turn => {
            let (vx, vy, w) = (x[2], x[3], x[6]);
            let angle = w * t;
            let (sine, cosine) = angle.sin_cos();
            // Displacement along and across for unit velocity, and their derivatives by the turn
            // rate.
            let (s, c, ds, dc) = if angle.abs() < 1e-4 {
                (t, 0.5 * t * angle, -t * t * angle / 3.0, 0.5 * t * t)
            } else {
                let (s, c) = (sine / w, (1.0 - cosine) / w);
                (s, c, (t * cosine - s) / w, (t * sine - c) / w)
            };
            next[0] += s * vx - c * vy;
            next[1] += c * vx + s * vy;
            next[2] = cosine * vx - sine * vy;
            next[3] = sine * vx + cosine * vy;
            let entries = [
                (0, 2, s),
                (0, 3, -c),
                (0, 6, ds * vx - dc * vy),
                (1, 2, c),
                (1, 3, s),
                (1, 6, dc * vx + ds * vy),
                (2, 2, cosine),
                (2, 3, -sine),
                (2, 6, -t * (sine * vx + cosine * vy)),
                (3, 2, sine),
                (3, 3, cosine),
                (3, 6, t * (cosine * vx - sine * vy)),
            ];
            for (i, j, value) in entries {
                jacobian[(i, j)] = value;
            }
        }
    }
    (next, jacobian)
}
