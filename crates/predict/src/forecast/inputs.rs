//! What the network is told of a track: numbers without units, in a frame that moves with the object, so that what it
//! knows holds in pixels and metres, everywhere on the floor and in every direction, and for left turns as for right ones.

use libm::{expf, fabs, log, log2, logf, sqrt};

use crate::forecast::horizon::Horizons;
use crate::forecast::line::Line;
use crate::forecast::motion::Motion;
use crate::forecast::parabola::parabola;
use crate::forecast::past::Past;
use crate::forecast::scores::Summary;
use crate::layout::{ANCHOR_AT, EXPERTS, HORIZONS, INPUTS, MOTION, WINDOW};
use crate::vector::{add, complex_mul, conjugate, direction, norm, norm_squared, scale, sub};

/// Largest mark told, and its size as an input.
const MOST_MARK: f32 = 6.0;
const MARK_SCALE: f32 = 1.0 / 3.0;
/// Comparisons after which more of them are no news.
const MANY: f32 = 10.0;
/// What counts as nothing beside lengths and speeds.
const NOTHING: f64 = 1e-12;

/// What can be told of the motion itself.
pub(crate) struct Motions {
    /// Direction of motion, a unit vector.
    pub(crate) direction: [f64; 2],
    residuals: [f32; 2 * WINDOW],
    numbers: [f32; MOTION],
}

impl Motions {
    pub(crate) fn of(past: &Past, horizons: &Horizons) -> Self {
        let mut motions = Self {
            direction: [1.0, 0.0],
            residuals: [0.0; 2 * WINDOW],
            numbers: [0.0; MOTION],
        };
        let window = past.newest(WINDOW);
        let (Some(line), Some(step_s)) = (Line::fit(window), past.usual_step_s()) else {
            return motions;
        };
        motions.direction = direction(line.velocity);
        let speed = |n: usize| {
            let line = Line::fit(past.newest(n));
            line.map_or(0.0, |line| norm(line.velocity))
        };
        let (recent, way, long) = (speed(4), norm(line.velocity) * step_s, speed(16));
        let (bend_12, noise) = bend(past, 12, step_s);
        let (bend_6, _) = bend(past, 6, step_s);
        let mirror = if bend_12 < 0.0 { -1.0 } else { 1.0 };

        let residual = |time_s: f64, place: [f64; 2]| sub(place, line.at(time_s));
        let squares: f64 = (window.iter())
            .map(|point| norm_squared(residual(point.time_s, point.place)))
            .sum();
        let spread = sqrt(squares / window.len() as f64);
        if window.len() > 2 && spread > 1e-6 * way {
            for (told, point) in motions.residuals.chunks_exact_mut(2).zip(window) {
                let residual = scale(residual(point.time_s, point.place), 1.0 / spread);
                let [along, across] = complex_mul(residual, conjugate(motions.direction));
                told.copy_from_slice(&[along as f32, (mirror * across) as f32]);
            }
        }
        let newest_step =
            past.newest(2).last().map_or(1.0, |point| -point.time_s) / horizons.step_s;
        let farthest = horizons.times_s[HORIZONS - 1] / horizons.step_s;
        motions.numbers = [
            0.5 * log(past.len() as f64 + 1.0) - 1.0,
            ratio(way, noise, -4.0, 6.0) / 3.0,
            ratio(recent + 1e-3 * long, long + 1e-3 * recent, -3.0, 3.0),
            (6.0 * fabs(bend_12)).min(2.0),
            (4.0 * fabs(bend_6)).min(2.0),
            6.0 * mirror * (bend_6 - bend_12).clamp(-0.3, 0.3),
            ratio(spread, noise, -3.0, 5.0) / 3.0,
            ratio(spread, way, -6.0, 3.0) / 3.0 + 1.0,
            0.5 * log2(newest_step.clamp(0.25, 16.0)),
            log2(farthest) - 3.0,
        ]
        .map(|number| number as f32);
        motions
    }

    /// The network's inputs.
    pub(crate) fn inputs(
        &self,
        summary: &Summary,
        horizons: &Horizons,
        motions: &[Motion; EXPERTS],
    ) -> [f32; INPUTS] {
        let mark = |mark: &f32| mark.min(MOST_MARK) * MARK_SCALE;
        let running = (ANCHOR_AT.iter()).flat_map(|horizon| {
            summary.marks[*horizon]
                .iter()
                .map(|[running, ..]| mark(running))
        });
        let recent = summary.marks[0].iter().map(|[_, recent, _]| mark(recent));
        let comparisons = ANCHOR_AT.iter().flat_map(|horizon| {
            [
                summary.n[*horizon].min(MANY) / MANY,
                disagreement(summary, horizons, motions, *horizon),
            ]
        });
        let surprise = summary.surprise.clamp(-MOST_MARK, MOST_MARK) * MARK_SCALE;
        let mut inputs = [0.0; INPUTS];
        let all = running
            .chain(recent)
            .chain(self.residuals)
            .chain(self.numbers)
            .chain(comparisons)
            .chain([surprise]);
        for (input, value) in inputs.iter_mut().zip(all) {
            *input = if value.is_finite() { value } else { 0.0 };
        }
        inputs
    }
}

/// Turn in radians a step by the parabola through the last `n` samples, and their noise about it. Coarser than a fit of a turn, and
/// defined for everything, parked things too.
fn bend(past: &Past, n: usize, step_s: f64) -> (f64, f64) {
    let points = past.newest(n);
    let Some([origin, velocity, acceleration]) = parabola(points) else {
        return (0.0, 0.0);
    };
    let mut squares = 0.0;
    for point in points {
        let t = point.time_s;
        let moved = add(scale(velocity, t), scale(acceleration, 0.5 * t * t));
        squares += norm_squared(sub(point.place, add(origin, moved)));
    }
    let freedom = (2 * points.len()).saturating_sub(6).max(1) as f64;
    let [_, across] = complex_mul(acceleration, conjugate(velocity));
    let rate = across / (norm_squared(velocity) + NOTHING);
    (rate * step_s, sqrt(squares / freedom))
}

/// Logarithm of how far the experts are from each other at a horizon, the better ones before all, over the best one's usual
/// error.
fn disagreement(
    summary: &Summary,
    horizons: &Horizons,
    motions: &[Motion; EXPERTS],
    horizon: usize,
) -> f32 {
    let (mut weights, mut mean, mut square) = (0.0, [0.0; 2], 0.0);
    for (motion, [mark, ..]) in motions.iter().zip(&summary.marks[horizon]) {
        let weight = expf(-mark);
        let [x, y] = motion.at(horizons.times_s[horizon] as f32);
        weights += weight;
        mean[0] += weight * x;
        mean[1] += weight * y;
        square += weight * (x * x + y * y);
    }
    let mean = mean.map(|sum| sum / weights);
    let variance = (square / weights - mean[0] * mean[0] - mean[1] * mean[1]).max(0.0);
    let usual = summary.best[horizon] * summary.best[horizon];
    let least = summary.least_error * summary.least_error;
    0.25 * logf((variance + least) / usual).clamp(-8.0, 8.0)
}

/// Logarithm of a ratio within bounds.
fn ratio(a: f64, b: f64, least: f64, most: f64) -> f64 {
    log((a + NOTHING) / (b + NOTHING)).clamp(least, most)
}
