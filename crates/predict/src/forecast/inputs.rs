//! The inputs of the network. They have no unit and refer to a frame that moves with the object, so
//! that what the network has learned holds in pixels and metres, at every position, in every
//! direction, and for left and right turns alike.

use libm::{expf, fabs, log, log2, logf, sqrt};

use crate::forecast::horizon::Horizons;
use crate::forecast::line::Line;
use crate::forecast::motion::Motion;
use crate::forecast::parabola::parabola;
use crate::forecast::past::Past;
use crate::forecast::scores::ScoreSummary;
use crate::layout::{ANCHOR_AT, EXPERTS, HORIZONS, INPUTS, MOTION, WINDOW};
use crate::vector::{add, complex_mul, conjugate, direction, norm, norm_squared, scale, sub};

/// Maximum score as an input, and its scale.
const MAX_SCORE: f32 = 6.0;
const SCORE_SCALE: f32 = 1.0 / 3.0;
/// Number of comparisons after which more make no difference.
const MAX_COMPARISONS: f32 = 10.0;
/// Avoids divisions by zero lengths and speeds.
const TINY: f64 = 1e-12;

/// Features of the motion itself.
pub(crate) struct MotionFeatures {
    /// Direction of motion, a unit vector.
    pub(crate) direction: [f64; 2],
    residuals: [f32; 2 * WINDOW],
    values: [f32; MOTION],
}

impl MotionFeatures {
    pub(crate) fn of(past: &Past, horizons: &Horizons) -> Self {
        let mut features = Self {
            direction: [1.0, 0.0],
            residuals: [0.0; 2 * WINDOW],
            values: [0.0; MOTION],
        };
        let window = past.newest(WINDOW);
        let (Some(line), Some(step_s)) = (Line::fit(window), past.median_step_s()) else {
            return features;
        };
        features.direction = direction(line.velocity);
        let speed = |n: usize| {
            let line = Line::fit(past.newest(n));
            line.map_or(0.0, |line| norm(line.velocity))
        };
        let (recent, step_length, long) = (speed(4), norm(line.velocity) * step_s, speed(16));
        let (turn_12, noise) = turn_per_step(past, 12, step_s);
        let (turn_6, _) = turn_per_step(past, 6, step_s);
        let mirror = if turn_12 < 0.0 { -1.0 } else { 1.0 };

        let residual = |time_s: f64, position: [f64; 2]| sub(position, line.at(time_s));
        let squares: f64 = (window.iter())
            .map(|point| norm_squared(residual(point.time_s, point.position)))
            .sum();
        let spread = sqrt(squares / window.len() as f64);
        if window.len() > 2 && spread > 1e-6 * step_length {
            for (pair, point) in features.residuals.chunks_exact_mut(2).zip(window) {
                let residual = scale(residual(point.time_s, point.position), 1.0 / spread);
                let [along, across] = complex_mul(residual, conjugate(features.direction));
                pair.copy_from_slice(&[along as f32, (mirror * across) as f32]);
            }
        }
        let newest_step =
            past.newest(2).last().map_or(1.0, |point| -point.time_s) / horizons.step_s;
        let range_steps = horizons.times_s[HORIZONS - 1] / horizons.step_s;
        features.values = [
            0.5 * log(past.len() as f64 + 1.0) - 1.0,
            ratio(step_length, noise, -4.0, 6.0) / 3.0,
            ratio(recent + 1e-3 * long, long + 1e-3 * recent, -3.0, 3.0),
            (6.0 * fabs(turn_12)).min(2.0),
            (4.0 * fabs(turn_6)).min(2.0),
            6.0 * mirror * (turn_6 - turn_12).clamp(-0.3, 0.3),
            ratio(spread, noise, -3.0, 5.0) / 3.0,
            ratio(spread, step_length, -6.0, 3.0) / 3.0 + 1.0,
            0.5 * log2(newest_step.clamp(0.25, 16.0)),
            log2(range_steps) - 3.0,
        ]
        .map(|value| value as f32);
        features
    }

    /// The inputs of the network.
    pub(crate) fn inputs(
        &self,
        summary: &ScoreSummary,
        horizons: &Horizons,
        motions: &[Motion; EXPERTS],
    ) -> [f32; INPUTS] {
        let score = |score: &f32| score.min(MAX_SCORE) * SCORE_SCALE;
        let running = (ANCHOR_AT.iter()).flat_map(|horizon| {
            summary.scores[*horizon]
                .iter()
                .map(|[running, ..]| score(running))
        });
        let recent = summary.scores[0].iter().map(|[_, recent, _]| score(recent));
        let comparisons = ANCHOR_AT.iter().flat_map(|horizon| {
            [
                summary.n[*horizon].min(MAX_COMPARISONS) / MAX_COMPARISONS,
                disagreement(summary, horizons, motions, *horizon),
            ]
        });
        let surprise = summary.surprise.clamp(-MAX_SCORE, MAX_SCORE) * SCORE_SCALE;
        let mut inputs = [0.0; INPUTS];
        let all = running
            .chain(recent)
            .chain(self.residuals)
            .chain(self.values)
            .chain(comparisons)
            .chain([surprise]);
        for (input, value) in inputs.iter_mut().zip(all) {
            *input = if value.is_finite() { value } else { 0.0 };
        }
        inputs
    }
}

/// Turn in radians per step of the parabola through the newest `n` samples, and the noise about it.
/// Coarser than a fitted turn, but defined for every motion, including rest.
fn turn_per_step(past: &Past, n: usize, step_s: f64) -> (f64, f64) {
    let points = past.newest(n);
    let Some([origin, velocity, acceleration]) = parabola(points) else {
        return (0.0, 0.0);
    };
    let mut squares = 0.0;
    for point in points {
        let t = point.time_s;
        let fitted = add(scale(velocity, t), scale(acceleration, 0.5 * t * t));
        squares += norm_squared(sub(point.position, add(origin, fitted)));
    }
    let freedom = (2 * points.len()).saturating_sub(6).max(1) as f64;
    let [_, across] = complex_mul(acceleration, conjugate(velocity));
    let rate = across / (norm_squared(velocity) + TINY);
    (rate * step_s, sqrt(squares / freedom))
}

/// Log of the experts' disagreement at a horizon, weighted towards the better ones, relative to the
/// best one's typical error.
fn disagreement(
    summary: &ScoreSummary,
    horizons: &Horizons,
    motions: &[Motion; EXPERTS],
    horizon: usize,
) -> f32 {
    let (mut weights, mut mean, mut square) = (0.0, [0.0; 2], 0.0);
    for (motion, [score, ..]) in motions.iter().zip(&summary.scores[horizon]) {
        let weight = expf(-score);
        let [x, y] = motion.at(horizons.times_s[horizon] as f32);
        weights += weight;
        mean[0] += weight * x;
        mean[1] += weight * y;
        square += weight * (x * x + y * y);
    }
    let mean = mean.map(|sum| sum / weights);
    let variance = (square / weights - mean[0] * mean[0] - mean[1] * mean[1]).max(0.0);
    let typical = summary.best[horizon] * summary.best[horizon];
    let floor = summary.min_error * summary.min_error;
    0.25 * logf((variance + floor) / typical).clamp(-8.0, 8.0)
}

/// Log of a ratio, clamped.
fn ratio(a: f64, b: f64, min: f64, max: f64) -> f64 {
    log((a + TINY) / (b + TINY)).clamp(min, max)
}
