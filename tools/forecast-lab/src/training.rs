//! How the start weights are made: the network learns from thousands of generated tracks what every track would otherwise
//! have to find out by itself.
//!
//! Every frame of a track is a lesson: what the forecaster knew, where each expert saw the object at every horizon, where it
//! really was, and where a camera saw it. Two losses are added:
//!
//! * of the mixture's error in units of the best expert's in hindsight over the whole track, so that slow and fast, clean and
//!   noisy tracks count alike; beyond a few units it grows with the logarithm only;
//! * of the ellipse's size, as a quantile (pinball loss): so much should lie outside and no more.
//!
//! What a track knows of itself depends on the network that weighs on it (its ellipses are those of the mixture's own errors), so
//! the lessons are given in rounds, each with the network of the round before. Adam follows the gradient; what is said of
//! experts and the hidden units are held small, which costs a little on generated motions and gains on real ones.

use std::f32::consts::PI;

use predict::Settings;
use predict::training::{
    ANCHORS, EXPERTS, HIDDEN, HORIZONS, INPUTS, Lesson, MARKS, Network, OUTPUTS, Pupil, ROW,
    STORED_PER_UNIT, WEIGHTS, back_to_said, back_to_sharpness, weigh,
};

use crate::motions::{Example, example};
use crate::random::Random;

/// How much is learned.
#[derive(Debug, Clone, Copy)]
pub struct Plan {
    /// Generated tracks.
    pub tracks: u64,
    /// Rounds of lessons.
    pub rounds: usize,
    /// Times that each round's lessons are gone through.
    pub epochs: usize,
}

/// What the stored weights were made with.
pub const PLAN: Plan = Plan {
    tracks: 8000,
    rounds: 2,
    epochs: 6,
};

/// Frames of a track.
const FRAMES: usize = 120;
/// Samples before the first lesson, and before the first that counts for the best expert in hindsight.
const FIRST_LESSON: usize = 2;
const FIRST_COUNTED: usize = 8;
/// The lessons of the first so many samples count more, of a track and after a gap: there are few of them, and every track begins with
/// them.
const EARLY: usize = 10;
const EARLY_AFTER_GAP: usize = 3;
const EARLY_WEIGHT: f32 = 3.0;
/// Steps that make a gap.
const GAP_STEPS: f64 = 1.5;
/// Added to the unit of the error: parts of a step's way and of the noise, and pixels.
const UNIT_FLOOR: [f64; 3] = [0.004, 0.03, 1e-3];
/// Errors beyond so many units grow with the logarithm.
const FAR: f32 = 4.0;
/// Part that should lie within the ellipse: real motion changes its mind a little more often than a generated one.
const WITHIN: f32 = 0.952;
/// 95 % quantile of chi-squared with two degrees of freedom.
const WITHIN_95: f32 = 5.991;
/// Weight of the ellipse's loss.
const ELLIPSE_WEIGHT: f32 = 0.6;
/// Pull of the restrained weights towards zero.
const RESTRAINT: f32 = 8e-4;
/// Logarithm of the marks' sharpness to begin with.
const FIRST_SHARPNESS: f32 = -0.7;
const BATCH: usize = 512;
/// Adam's rate in the first round and after it, and what is left of it in the end.
const RATES: [f32; 2] = [3e-3, 1e-3];
const LAST_RATE: f32 = 1e-5;
const ADAM: [f32; 2] = [0.9, 0.999];

/// A lesson with its answers.
struct Task {
    lesson: Lesson,
    /// By horizon, relative to the newest place.
    truth: [Option<[f32; 2]>; HORIZONS],
    came: [Option<[f32; 2]>; HORIZONS],
    /// Unit of the error.
    unit: [f32; HORIZONS],
    weight: f32,
}

/// Sums of the losses over the answers that there are.
#[derive(Debug, Clone, Copy, Default)]
pub struct Loss {
    /// Of the mixture.
    pub mixture: f64,
    /// Of the ellipse.
    pub ellipse: f64,
    /// Answers.
    pub n: f64,
}

/// Makes the start weights. `report` hears the epoch and the mean losses.
pub fn train(plan: Plan, mut report: impl FnMut(usize, Loss)) -> Network {
    let mut random = Random::new(7);
    let mut network = Network {
        weights: [0.0; WEIGHTS],
    };
    for weight in &mut network.weights[..HIDDEN * (INPUTS + 1)] {
        *weight = (random.normal() / (INPUTS as f64).sqrt()) as f32;
    }
    for anchor in 0..ANCHORS {
        for mark in 0..MARKS {
            *network.output_bias(anchor * ROW + EXPERTS + mark) = FIRST_SHARPNESS;
        }
    }
    let mut adam = Adam::new();
    for round in 0..plan.rounds {
        let tasks: Vec<Task> = (1..=plan.tracks)
            .flat_map(|seed| tasks(seed, &network))
            .collect();
        let mut order: Vec<usize> = (0..tasks.len()).collect();
        let n_steps = plan.epochs * (tasks.len() / BATCH);
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
                for task in batch {
                    tasks[*task].learn(&network, &mut gradient, &mut loss);
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

/// The weights as they are stored.
#[must_use]
pub fn stored(network: &Network) -> Vec<u8> {
    let steps = network.weights.iter().map(|weight| {
        let steps = (weight * STORED_PER_UNIT).round();
        steps.clamp(f32::from(i16::MIN), f32::from(i16::MAX)) as i16
    });
    steps.flat_map(i16::to_le_bytes).collect()
}

/// The lessons of one generated track.
fn tasks(seed: u64, network: &Network) -> Vec<Task> {
    let example = example(seed, FRAMES);
    let settings = Settings {
        frame_period_s: example.step_s,
        ..Settings::default()
    };
    let mut pupil = Pupil::new(&settings, network.clone());
    let mut random = Random::new(seed ^ 0xaaaa);
    let mut tasks = Vec::with_capacity(FRAMES);
    let (mut before_s, mut since_gap) = (0.0, 0);
    for (i, (time_s, place)) in example.seen.iter().enumerate() {
        since_gap = if time_s - before_s > GAP_STEPS * example.step_s {
            0
        } else {
            since_gap + 1
        };
        before_s = *time_s;
        let heading = example.headings.as_ref().map(|headings| headings[i]);
        pupil.see(((time_s + 1.0) * 1e9) as u64, *place, heading);
        if i < FIRST_LESSON {
            continue;
        }
        let lesson = pupil.lesson();
        let truth = lesson.times_s.map(|ahead_s| {
            let then = example.path.at(time_s + ahead_s)?;
            Some([0, 1].map(|axis| (then[axis] - place[axis]) as f32))
        });
        let came = truth.map(|truth| {
            truth.map(|truth| truth.map(|c| c + (example.sigma * random.normal()) as f32))
        });
        tasks.push(Task {
            lesson,
            truth,
            came,
            unit: [1.0; HORIZONS],
            weight: if i < EARLY || since_gap < EARLY_AFTER_GAP {
                EARLY_WEIGHT
            } else {
                1.0
            },
        });
    }
    set_units(&mut tasks, &example);
    tasks
}

/// The unit of a track's errors at each horizon: the best expert's mean in hindsight, and a floor.
fn set_units(tasks: &mut [Task], example: &Example) {
    let ways = example.seen.windows(2).map(|pair| {
        let [from, to] = [pair[0].1, pair[1].1];
        (to[0] - from[0]).hypot(to[1] - from[1])
    });
    let way = ways.sum::<f64>() / (example.seen.len().max(2) - 1) as f64;
    let floor = UNIT_FLOOR[0] * way + UNIT_FLOOR[1] * example.sigma + UNIT_FLOOR[2];
    for horizon in 0..HORIZONS {
        let mut sums = [0.0_f32; EXPERTS];
        let mut n = 0.0_f32;
        for task in tasks.iter().skip(FIRST_COUNTED - FIRST_LESSON) {
            let Some(truth) = task.truth[horizon] else {
                continue;
            };
            n += 1.0;
            for (sum, place) in sums.iter_mut().zip(&task.lesson.places[horizon]) {
                *sum += (place[0] - truth[0]).hypot(place[1] - truth[1]);
            }
        }
        let best = sums.iter().fold(f32::INFINITY, |a, b| a.min(*b)) / n.max(1.0);
        for task in tasks.iter_mut() {
            task.unit[horizon] = best + floor as f32;
        }
    }
}

impl Task {
    /// Adds the losses and their gradient.
    fn learn(&self, network: &Network, gradient: &mut Network, loss: &mut Loss) {
        let Lesson {
            evidence, places, ..
        } = &self.lesson;
        let shares = weigh(network, evidence);
        let mut by_outputs = [0.0; OUTPUTS];
        for horizon in 0..HORIZONS {
            let (Some(truth), Some(came)) = (self.truth[horizon], self.came[horizon]) else {
                continue;
            };
            let places = &places[horizon];
            let shares_now = &shares.shares[horizon];
            let mut mixed = [0.0_f32; 2];
            for (share, place) in shares_now.iter().zip(places) {
                mixed[0] += share * place[0];
                mixed[1] += share * place[1];
            }
            let by_place = self.miss(horizon, mixed, truth, loss);
            let mut by_logits = [0.0; EXPERTS];
            for ((by, share), place) in by_logits.iter_mut().zip(shares_now).zip(places) {
                let [x, y] = [0, 1].map(|axis| place[axis] - mixed[axis]);
                *by = share * (by_place[0] * x + by_place[1] * y);
            }
            let by_spread = self.ellipse(horizon, mixed, came, shares.spread[horizon], loss);
            back_to_said(&shares.answer, horizon, &by_logits, &mut by_outputs);
            back_to_sharpness(
                evidence,
                &shares.answer,
                horizon,
                &by_logits,
                by_spread,
                &mut by_outputs,
            );
        }
        network.add_gradient(&evidence.inputs, &shares.answer, &by_outputs, gradient);
    }

    /// Loss of the mixture's place; its derivatives.
    fn miss(&self, horizon: usize, mixed: [f32; 2], truth: [f32; 2], loss: &mut Loss) -> [f32; 2] {
        let error = [0, 1].map(|axis| mixed[axis] - truth[axis]);
        let unit = self.unit[horizon];
        let size = error[0].hypot(error[1]).max(1e-9) / unit;
        let (value, slope) = if size < FAR {
            (size, 1.0)
        } else {
            let beyond = size - FAR + 1.0;
            (FAR + beyond.ln(), 1.0 / beyond)
        };
        loss.mixture += f64::from(self.weight * value);
        loss.n += f64::from(self.weight);
        error.map(|error| self.weight * slope * error / (size * unit * unit))
    }

    /// Loss of the ellipse's size, given the logarithm of its scale; its derivative by that.
    fn ellipse(
        &self,
        horizon: usize,
        mixed: [f32; 2],
        came: [f32; 2],
        spread: f32,
        loss: &mut Loss,
    ) -> f32 {
        let [x, y] = [0, 1].map(|axis| came[axis] - mixed[axis]);
        let [c, s] = self.lesson.direction;
        let (along, across) = (c * x + s * y, c * y - s * x);
        let [a, b, d] = self.lesson.ellipses[horizon];
        let distance = (d * along * along - 2.0 * b * along * across + a * across * across)
            / (a * d - b * b).max(1e-30);
        let wanted = 0.5 * (distance.max(1e-8) / WITHIN_95).ln();
        let slope = if spread < wanted {
            -WITHIN
        } else {
            1.0 - WITHIN
        };
        loss.ellipse += f64::from(slope * (spread - wanted));
        ELLIPSE_WEIGHT * slope
    }
}

/// Adam (Kingma and Ba), with the restraint of `RESTRAINT`.
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

    fn step(&mut self, network: &mut Network, gradient: &Network, n_answers: f32, rate: f32) {
        self.n += 1;
        let [mean_left, square_left] = ADAM.map(|keep| 1.0 - keep.powi(self.n));
        for (i, weight) in network.weights.iter_mut().enumerate() {
            let restraint = if Network::is_restrained(i) {
                RESTRAINT
            } else {
                0.0
            };
            let slope = gradient.weights[i] / n_answers + restraint * *weight;
            self.mean[i] += (1.0 - ADAM[0]) * (slope - self.mean[i]);
            self.square[i] += (1.0 - ADAM[1]) * (slope * slope - self.square[i]);
            let (mean, square) = (self.mean[i] / mean_left, self.square[i] / square_left);
            *weight -= rate * mean / (square.sqrt() + 1e-8);
        }
    }
}
