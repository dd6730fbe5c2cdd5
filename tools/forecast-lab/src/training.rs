//! Training of the start weights. The network learns from thousands of generated tracks what every
//! track would otherwise have to learn by itself.
//!
//! Every frame of a track is a training sample: the inputs of the network, the forecast of each
//! expert at every horizon, the true position there, and a measurement of it. Two losses are added:
//!
//! * The error of the mixture in units of the best expert's mean error, in hindsight over the whole
//!   track, so that slow and fast, clean and noisy tracks count alike. Beyond a few units the loss
//!   is logarithmic.
//! * The quantile (pinball) loss of the ellipse's size, for a fixed share of measurements outside.
//!
//! The samples depend on the network, because the ellipses are made of the mixture's own errors.
//! Training therefore has rounds, each with samples made by the network of the previous round. Adam
//! follows the gradient. Weight decay costs a little on generated motions and gains on real ones.

use std::f32::consts::PI;

use predict::Settings;
use predict::training::{
    ANCHORS, EXPERTS, HIDDEN, HORIZONS, INPUTS, Network, OUTPUTS, ROW, SCORES, STORED_PER_UNIT,
    TrainingSample, TrainingTrack, WEIGHTS, back_to_logits, back_to_sharpness, gate,
};

use crate::examples::{Example, example};
use crate::random::Random;

/// The amount of training.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    /// Number of generated tracks.
    pub tracks: u64,
    /// Number of rounds.
    pub rounds: usize,
    /// Number of epochs per round.
    pub epochs: usize,
}

/// The plan that the stored weights were trained with.
pub const PLAN: Plan = Plan {
    tracks: 8000,
    rounds: 2,
    epochs: 6,
};

/// Frames per track.
const FRAMES: usize = 120;
/// Index of the first training sample of a track, and of the first one that counts for the best
/// expert in hindsight.
const FIRST_SAMPLE: usize = 2;
const FIRST_COUNTED: usize = 8;
/// Early samples of a track and after a gap count more. They are few, but every track begins with
/// them.
const EARLY: usize = 10;
const EARLY_AFTER_GAP: usize = 3;
const EARLY_WEIGHT: f32 = 3.0;
/// A longer step, in nominal steps, is a gap.
const GAP_STEPS: f64 = 1.5;
/// Added to the unit of the error: fractions of the mean step and of the noise, and pixels.
const UNIT_FLOOR: [f64; 3] = [0.004, 0.03, 1e-3];
/// Errors beyond this many units have a logarithmic loss.
const LINEAR_RANGE: f32 = 4.0;
/// Target share inside the ellipse. Slightly high, because real motion changes more often than
/// generated motion.
const TARGET_COVERAGE: f32 = 0.952;
/// 95 % quantile of the chi-squared distribution with two degrees of freedom.
const WITHIN_95: f32 = 5.991;
/// Weight of the ellipse loss.
const ELLIPSE_WEIGHT: f32 = 0.6;
/// Weight decay.
const WEIGHT_DECAY: f32 = 8e-4;
/// Initial log sharpness of the scores.
const FIRST_SHARPNESS: f32 = -0.7;
const BATCH: usize = 512;
/// Learning rate of Adam in the first round and in later ones, and what remains at the end.
const RATES: [f32; 2] = [3e-3, 1e-3];
const LAST_RATE: f32 = 1e-5;
const ADAM: [f32; 2] = [0.9, 0.999];

/// A training sample with its targets.
struct LabelledSample {
    input: TrainingSample,
    /// Targets by horizon, relative to the newest position.
    truth: [Option<[f32; 2]>; HORIZONS],
    measured: [Option<[f32; 2]>; HORIZONS],
    /// Unit of the error.
    unit: [f32; HORIZONS],
    weight: f32,
}

/// Sums of the losses.
#[derive(Debug, Clone, Copy, Default)]
pub struct Loss {
    /// Loss of the mixture.
    pub mixture: f64,
    /// Loss of the ellipse.
    pub ellipse: f64,
    /// Sum of the weights of all targets.
    pub n: f64,
}

/// Trains the start weights. `report` receives the epoch and its losses.
pub fn train(plan: Plan, mut report: impl FnMut(usize, Loss)) -> Network {
    let mut random = Random::new(7);
    let mut network = Network {
        weights: [0.0; WEIGHTS],
    };
    for weight in &mut network.weights[..HIDDEN * (INPUTS + 1)] {
        *weight = (random.normal() / (INPUTS as f64).sqrt()) as f32;
    }
    for anchor in 0..ANCHORS {
        for score in 0..SCORES {
            *network.output_bias(anchor * ROW + EXPERTS + score) = FIRST_SHARPNESS;
        }
    }
    let mut adam = Adam::new();
    for round in 0..plan.rounds {
        let samples: Vec<LabelledSample> = (1..=plan.tracks)
            .flat_map(|seed| labelled_samples(seed, &network))
            .collect();
        let mut order: Vec<usize> = (0..samples.len()).collect();
        let n_steps = plan.epochs * (samples.len() / BATCH);
        let mut step = 0;
        for epoch in 0..plan.epochs {
            for i in (1..order.len()).rev() {
                order.swap(i, random.below(i + 1));
            }
            let mut sum = Loss::default();
            for batch in order.chunks_exact(BATCH) {
                let mut gradient = Network {
                    weights: [0.0; WEIGHTS],
                };
                let mut loss = Loss::default();
                for index in batch {
                    samples[*index].add_gradient(&network, &mut gradient, &mut loss);
                }
                step += 1;
                let falling = 0.5 * (1.0 + (PI * step as f32 / n_steps as f32).cos());
                let rate = RATES[round.min(1)] * falling + LAST_RATE;
                adam.step(&mut network, &gradient, loss.n.max(1.0) as f32, rate);
                sum.mixture += loss.mixture;
                sum.ellipse += loss.ellipse;
                sum.n += loss.n;
            }
            report(round * plan.epochs + epoch, sum);
        }
    }
    network
}

/// Encodes the weights for storage.
#[must_use]
pub fn stored(network: &Network) -> Vec<u8> {
    let steps = network.weights.iter().map(|weight| {
        let steps = (weight * STORED_PER_UNIT).round();
        steps.clamp(f32::from(i16::MIN), f32::from(i16::MAX)) as i16
    });
    steps.flat_map(i16::to_le_bytes).collect()
}

/// The training samples of one generated track.
fn labelled_samples(seed: u64, network: &Network) -> Vec<LabelledSample> {
    let example = example(seed, FRAMES);
    let settings = Settings {
        frame_period_s: example.step_s,
        ..Settings::default()
    };
    let mut track = TrainingTrack::new(&settings, network.clone());
    let mut random = Random::new(seed ^ 0xaaaa);
    let mut samples = Vec::with_capacity(FRAMES);
    let (mut last_s, mut since_gap) = (0.0, 0);
    for (i, (time_s, position)) in example.samples.iter().enumerate() {
        since_gap = if time_s - last_s > GAP_STEPS * example.step_s {
            0
        } else {
            since_gap + 1
        };
        last_s = *time_s;
        let heading = example.headings.as_ref().map(|headings| headings[i]);
        track.observe(((time_s + 1.0) * 1e9) as u64, *position, heading);
        if i < FIRST_SAMPLE {
            continue;
        }
        let input = track.sample();
        let truth = input.times_s.map(|ahead_s| {
            let later = example.path.at(time_s + ahead_s)?;
            Some([0, 1].map(|axis| (later[axis] - position[axis]) as f32))
        });
        let measured = truth.map(|truth| {
            truth.map(|truth| truth.map(|c| c + (example.sigma * random.normal()) as f32))
        });
        samples.push(LabelledSample {
            input,
            truth,
            measured,
            unit: [1.0; HORIZONS],
            weight: if i < EARLY || since_gap < EARLY_AFTER_GAP {
                EARLY_WEIGHT
            } else {
                1.0
            },
        });
    }
    set_units(&mut samples, &example);
    samples
}

/// Sets the unit of a track's errors at each horizon: the mean error of the best expert in
/// hindsight, plus a floor.
fn set_units(samples: &mut [LabelledSample], example: &Example) {
    let steps = example.samples.windows(2).map(|pair| {
        let [from, to] = [pair[0].1, pair[1].1];
        (to[0] - from[0]).hypot(to[1] - from[1])
    });
    let mean_step = steps.sum::<f64>() / (example.samples.len().max(2) - 1) as f64;
    let floor = UNIT_FLOOR[0] * mean_step + UNIT_FLOOR[1] * example.sigma + UNIT_FLOOR[2];
    for horizon in 0..HORIZONS {
        let mut sums = [0.0_f32; EXPERTS];
        let mut n = 0.0_f32;
        for sample in samples.iter().skip(FIRST_COUNTED - FIRST_SAMPLE) {
            let Some(truth) = sample.truth[horizon] else {
                continue;
            };
            n += 1.0;
            for (sum, position) in sums.iter_mut().zip(&sample.input.positions[horizon]) {
                *sum += (position[0] - truth[0]).hypot(position[1] - truth[1]);
            }
        }
        let best = sums.iter().fold(f32::INFINITY, |a, b| a.min(*b)) / n.max(1.0);
        for sample in samples.iter_mut() {
            sample.unit[horizon] = best + floor as f32;
        }
    }
}

impl LabelledSample {
    /// Adds the losses and their gradient.
    fn add_gradient(&self, network: &Network, gradient: &mut Network, loss: &mut Loss) {
        let TrainingSample {
            evidence,
            positions,
            ..
        } = &self.input;
        let shares = gate(network, evidence);
        let mut by_outputs = [0.0; OUTPUTS];
        for horizon in 0..HORIZONS {
            let (Some(truth), Some(measured)) = (self.truth[horizon], self.measured[horizon])
            else {
                continue;
            };
            let positions = &positions[horizon];
            let shares_now = &shares.shares[horizon];
            let mut mixed = [0.0_f32; 2];
            for (share, position) in shares_now.iter().zip(positions) {
                mixed[0] += share * position[0];
                mixed[1] += share * position[1];
            }
            let by_position = self.position_loss(horizon, mixed, truth, loss);
            let mut by_logits = [0.0; EXPERTS];
            for ((by, share), position) in by_logits.iter_mut().zip(shares_now).zip(positions) {
                let [x, y] = [0, 1].map(|axis| position[axis] - mixed[axis]);
                *by = share * (by_position[0] * x + by_position[1] * y);
            }
            let by_log_scale =
                self.ellipse_loss(horizon, mixed, measured, shares.log_scale[horizon], loss);
            back_to_logits(&shares.activations, horizon, &by_logits, &mut by_outputs);
            back_to_sharpness(
                evidence,
                &shares.activations,
                horizon,
                &by_logits,
                by_log_scale,
                &mut by_outputs,
            );
        }
        network.add_gradient(&evidence.inputs, &shares.activations, &by_outputs, gradient);
    }

    /// Adds the loss of the mixture's position. Returns its derivatives.
    fn position_loss(
        &self,
        horizon: usize,
        mixed: [f32; 2],
        truth: [f32; 2],
        loss: &mut Loss,
    ) -> [f32; 2] {
        let error = [0, 1].map(|axis| mixed[axis] - truth[axis]);
        let unit = self.unit[horizon];
        let size = error[0].hypot(error[1]).max(1e-9) / unit;
        let (value, slope) = if size < LINEAR_RANGE {
            (size, 1.0)
        } else {
            let beyond = size - LINEAR_RANGE + 1.0;
            (LINEAR_RANGE + beyond.ln(), 1.0 / beyond)
        };
        loss.mixture += f64::from(self.weight * value);
        loss.n += f64::from(self.weight);
        error.map(|error| self.weight * slope * error / (size * unit * unit))
    }

    /// Adds the loss of the ellipse's log scale. Returns its derivative.
    fn ellipse_loss(
        &self,
        horizon: usize,
        mixed: [f32; 2],
        measured: [f32; 2],
        log_scale: f32,
        loss: &mut Loss,
    ) -> f32 {
        let [x, y] = [0, 1].map(|axis| measured[axis] - mixed[axis]);
        let [c, s] = self.input.direction;
        let (along, across) = (c * x + s * y, c * y - s * x);
        let [a, b, d] = self.input.ellipses[horizon];
        let distance = (d * along * along - 2.0 * b * along * across + a * across * across)
            / (a * d - b * b).max(1e-30);
        let target = 0.5 * (distance.max(1e-8) / WITHIN_95).ln();
        let slope = if log_scale < target {
            -TARGET_COVERAGE
        } else {
            1.0 - TARGET_COVERAGE
        };
        loss.ellipse += f64::from(slope * (log_scale - target));
        ELLIPSE_WEIGHT * slope
    }
}

/// Adam (Kingma and Ba) with weight decay.
struct Adam {
    mean: Vec<f32>,
    square: Vec<f32>,
    n: i32,
}

impl Adam {
    fn new() -> Self {
        Self {
            mean: vec![0.0; WEIGHTS],
            square: vec![0.0; WEIGHTS],
            n: 0,
        }
    }

    fn step(&mut self, network: &mut Network, gradient: &Network, n: f32, rate: f32) {
        self.n += 1;
        let [mean_left, square_left] = ADAM.map(|keep| 1.0 - keep.powi(self.n));
        for (i, weight) in network.weights.iter_mut().enumerate() {
            let decay = if Network::is_decayed(i) {
                WEIGHT_DECAY
            } else {
                0.0
            };
            let slope = gradient.weights[i] / n + decay * *weight;
            self.mean[i] += (1.0 - ADAM[0]) * (slope - self.mean[i]);
            self.square[i] += (1.0 - ADAM[1]) * (slope * slope - self.square[i]);
            let (mean, square) = (self.mean[i] / mean_left, self.square[i] / square_left);
            *weight -= rate * mean / (square.sqrt() + 1e-8);
        }
    }
}
