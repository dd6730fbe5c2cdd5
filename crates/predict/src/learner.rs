//! The learned forecast: a straight line, corrected at every step by a neural network that is trained on the track
//! itself.
//!
//! The network sees the velocities over the object's last steps and answers by how much, as a velocity, the next place
//! lies beside the line through the last five (section 3.1.2 has positions in and the next position out). All of it is
//! expressed in a frame that moves with the object: along and across its direction, in units of its running speed. What
//! was learned in one corner of the floor then holds in every other, and an untrained network is the line.
//!
//! * Inputs grow as the paper asks: one step of the past for every two steps known, up to six.
//! * Training: with each new sample, one pass of backpropagation over the last twelve steps.
//! * Several steps ahead: the corrected place becomes the newest sample, for line and network alike.
//!
//! Cost of a sample: [`TRAINED_STEPS`] trainings and [`MAX_FORECAST`] answers.

use libm::sqrt;

use crate::history::Sample;
use crate::motion::{Line, add, complex_mul, conjugate, norm_squared, scale, sub};
use crate::network::{INPUTS, Network};
use crate::{MAX_FORECAST, NS_PER_S};

/// Past steps the network sees.
const LAGS: usize = INPUTS / 2;
/// Samples that line and network need.
const WINDOW: usize = LAGS + 1;
/// Steps trained with each new sample.
const TRAINED_STEPS: usize = 12;
/// Memory of the running speed in samples.
const SPEED_MEMORY: f64 = 16.0;
/// Largest input and target, in running speeds.
const MAX_NORMALISED: f64 = 3.0;
/// Largest correction of a step, in running speeds.
const MAX_CORRECTION: f64 = 1.0;

/// A network and the speed its inputs are measured by.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Learner {
    network: Network,
    /// Running mean of the squared speed, in (units/s)².
    speed_squared: f64,
    n_speeds: f64,
}

impl Learner {
    pub(crate) const START: Self = Self {
        network: Network::START,
        speed_squared: 0.0,
        n_speeds: 0.0,
    };

    /// Trains on the newest steps. `least_step_s`: shorter steps are mostly noise and not trained.
    pub(crate) fn learn(&mut self, samples: &[Sample], least_step_s: f64) {
        if let [.., before, newest] = samples {
            let step_s = newest.seconds_since(before);
            if step_s >= least_step_s {
                let velocity = scale(sub(newest.position, before.position), 1.0 / step_s);
                self.n_speeds = (self.n_speeds + 1.0).min(SPEED_MEMORY);
                self.speed_squared += (norm_squared(velocity) - self.speed_squared) / self.n_speeds;
            }
        }
        let n_lags = n_lags(samples.len());
        let first = samples.len().saturating_sub(TRAINED_STEPS).max(2);
        for next in first..samples.len() {
            let (past, next) = (&samples[..next], &samples[next]);
            let step_s = next.seconds_since(&past[past.len() - 1]);
            if step_s < least_step_s {
                continue;
            }
            let line = Line::fit(past);
            let Some(frame) = MovingFrame::of(&line, self.speed_squared) else {
                continue;
            };
            let missed = sub(next.position, line.at(step_s));
            let target = frame.normalised(scale(missed, 1.0 / step_s));
            self.network.train(&frame.inputs(past, n_lags), target);
        }
    }

    /// Places after the newest sample, one each `step_s`; `None` without samples.
    pub(crate) fn path(&self, samples: &[Sample], step_s: f64) -> Option<[[f64; 2]; MAX_FORECAST]> {
        let n_lags = n_lags(samples.len());
        let step_ns = (step_s * NS_PER_S) as u64;
        let recent = &samples[samples.len().saturating_sub(WINDOW)..];
        let mut window = [*recent.last()?; WINDOW];
        let mut len = recent.len();
        window[..len].copy_from_slice(recent);

        let mut path = [[0.0; 2]; MAX_FORECAST];
        for place in &mut path {
            let past = &window[..len];
            let newest = past[len - 1];
            let line = Line::fit(past);
            *place = line.at(step_s);
            if let Some(frame) = MovingFrame::of(&line, self.speed_squared) {
                let correction = self.network.forward(&frame.inputs(past, n_lags));
                *place = add(*place, scale(frame.velocity(correction), step_s));
            }
            let reached = Sample {
                time_ns: newest.time_ns.saturating_add(step_ns),
                position: *place,
            };
            if len == WINDOW {
                window.copy_within(1.., 0);
            } else {
                len += 1;
            }
            window[len - 1] = reached;
        }
        Some(path)
    }
}

/// Past steps shown to the network when so many samples are known: few at first, so that there are several examples of
/// each.
fn n_lags(n_samples: usize) -> usize {
    (n_samples.saturating_sub(1) / 2).clamp(1, LAGS)
}

/// Axes along and across an object's motion, and its running speed as unit.
struct MovingFrame {
    /// Unit vector.
    direction: [f64; 2],
    speed: f64,
}

impl MovingFrame {
    /// `None` for an object that never moved.
    fn of(line: &Line, speed_squared: f64) -> Option<Self> {
        let speed = sqrt(speed_squared);
        (speed > 0.0).then(|| Self {
            direction: direction(line.velocity),
            speed,
        })
    }

    fn normalised(&self, velocity: [f64; 2]) -> [f32; 2] {
        complex_mul(velocity, conjugate(self.direction))
            .map(|v| (v / self.speed).clamp(-MAX_NORMALISED, MAX_NORMALISED) as f32)
    }

    /// Velocity, in units a second, that an answer of the network means.
    fn velocity(&self, answer: [f32; 2]) -> [f64; 2] {
        let answer = answer.map(f64::from);
        let size = sqrt(norm_squared(answer));
        let limit = self.speed * (MAX_CORRECTION / size).min(1.0);
        complex_mul(scale(answer, limit), self.direction)
    }

    /// Velocities over the last steps, newest first; zero where there are fewer.
    fn inputs(&self, past: &[Sample], n_lags: usize) -> [f32; INPUTS] {
        let mut inputs = [0.0; INPUTS];
        let steps = past.windows(2).rev().take(n_lags);
        for (input, step) in inputs.chunks_exact_mut(2).zip(steps) {
            let duration_s = step[1].seconds_since(&step[0]);
            let moved = sub(step[1].position, step[0].position);
            input.copy_from_slice(&self.normalised(scale(moved, 1.0 / duration_s)));
        }
        inputs
    }
}

/// Unit vector along `velocity`, +x for an object at rest.
pub(crate) fn direction(velocity: [f64; 2]) -> [f64; 2] {
    let speed = sqrt(norm_squared(velocity));
    if speed > 0.0 && speed.is_finite() {
        scale(velocity, 1.0 / speed)
    } else {
        [1.0, 0.0]
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    const STEP_S: f64 = 1.0 / 15.0;

    fn samples(n: usize, place: impl Fn(f64) -> [f64; 2]) -> Vec<Sample> {
        (0..n as u64)
            .map(|i| Sample {
                time_ns: i * 66_666_667,
                position: place(i as f64 * STEP_S),
            })
            .collect()
    }

    fn error_after(learner: &Learner, past: &[Sample], truth: &[Sample]) -> f64 {
        let path = learner.path(past, STEP_S).expect("samples");
        sqrt(norm_squared(sub(
            path[truth.len() - 1],
            truth[truth.len() - 1].position,
        )))
    }

    #[test]
    fn untrained_it_is_the_line() {
        let track = samples(25, |t| [40.0 * t, 5.0]);
        assert!(error_after(&Learner::START, &track[..10], &track[10..]) < 1e-4);
    }

    #[test]
    fn no_samples_no_path() {
        assert_eq!(Learner::START.path(&[], STEP_S), None);
    }

    /// A slalom bends to and fro: no single turn fits it, its own past does.
    #[test]
    fn learns_a_slalom_better_than_the_line() {
        let track = samples(700, |t| [60.0 * t, 25.0 * libm::sin(2.5 * t)]);
        let mut learner = Learner::START;
        let (mut learned, mut untrained) = (0.0, 0.0);
        for n in 2..track.len() - 5 {
            let past = &track[n.saturating_sub(32)..n];
            learner.learn(past, 0.0);
            if n > 600 {
                learned += error_after(&learner, past, &track[n..n + 5]);
                untrained += error_after(&Learner::START, past, &track[n..n + 5]);
            }
        }
        assert!(learned < 0.6 * untrained, "{learned} against {untrained}");
    }
}
