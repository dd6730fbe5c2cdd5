//! How wrong a forecast may be: the ellipse of the mixture's own past errors, by horizon.
//!
//! Second moments along and across the motion say its shape, and in the beginning those of the horizon before, grown with
//! the passing time. Its size is corrected twice. The network says, from the motion at the moment and from what it learned of
//! generated ones, how much larger or smaller it should be. And since errors are seldom normal, the size follows what happens:
//! larger by a step with every miss, smaller by a nineteenth of it with every hit, so that in the long run 95 % of what comes
//! lies within the 95 % ellipse (Gibbs and Candès, "Adaptive conformal inference under distribution shift").
//!
//! However large that makes it, it ends where an object cannot be that has never gone faster than so far. It covers what a camera will
//! measure, noise included. What is rare and gives no sign before it happens, like the first wall in
//! an object's way, no ellipse can hold in advance.

use libm::expf;

use crate::covariance::{Covariance, rotated};
use crate::forecast::comparison::{Comparison, between};
use crate::forecast::horizon::Horizons;
use crate::layout::HORIZONS;

/// 95 % quantile of chi-squared with two degrees of freedom.
const WITHIN_95: f32 = 5.991;
/// Part of what comes that may lie outside.
const OUTSIDE: f32 = 0.05;
/// Memory of the moments in comparisons.
const MEMORY: f32 = 60.0;
/// Comparisons that the moments expected beforehand are worth.
const PRIOR: f32 = 3.0;
/// Step of the size's logarithm at the first and at the last horizon, where one event makes many misses in a row.
const FOLLOW: [f32; 2] = [0.15, 0.2];
/// Bounds of the logarithm followed. A horizon that is held up by a nearer one only ever becomes smaller: not much, since it will be
/// missing when the nearer one shrinks.
const FOLLOWED: [f32; 2] = [-1.0, 2.0];
/// Bound of all corrections together.
const MOST_SCALE: f32 = 3.0;
/// Least growth of a variance from one horizon to the next.
const LEAST_GROWTH: f32 = 1.02;
/// Farthest that a forecast is wrong, in ways at the fastest that the object ever went: it may turn back.
const MOST_WRONG: f32 = 2.0;
/// Bounds of errors and variances, in units and squared units, so that no sum of squares is infinite.
const MOST_ERROR: f32 = 1e14;
const MOST_VARIANCE: f32 = 1e30;
/// Least variance, in squared units: an ellipse has an inside.
const LEAST_VARIANCE: f32 = 1e-12;

/// Errors of the mixture at one horizon.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moments {
    n: f32,
    /// Along, both, across the motion.
    second: [f32; 3],
    /// Logarithm of the size's correction.
    followed: f32,
}

impl Moments {
    pub(crate) const NONE: Self = Self {
        n: 0.0,
        second: [0.0; 3],
        followed: 0.0,
    };

    pub(crate) fn add(&mut self, horizon: usize, comparison: &Comparison<'_>) {
        let [x, y] = [0, 1].map(|axis| {
            let error = comparison.came[axis] - comparison.mixed[axis];
            error.clamp(-MOST_ERROR, MOST_ERROR)
        });
        if x.is_nan() || y.is_nan() {
            return;
        }
        let [c, s] = comparison.issued.direction;
        let (along, across) = (c * x + s * y, c * y - s * x);
        let distance = distance([along, across], comparison.issued.ellipses[horizon]);
        let missed = if distance > WITHIN_95 { 1.0 } else { 0.0 };
        self.followed += between(FOLLOW, horizon) * (missed - OUTSIDE);
        self.followed = self.followed.clamp(FOLLOWED[0], FOLLOWED[1]);
        self.n = (self.n + 1.0).min(MEMORY);
        let second = [along * along, along * across, across * across];
        for (mean, value) in self.second.iter_mut().zip(second) {
            *mean += (value - *mean) / self.n;
        }
    }
}

/// Covariances by horizon along, both, across the motion. `said` are the logarithms of the sizes that the network asks
/// for, `expected` gives the variance on each axis as long as no error is known.
pub(crate) fn ellipses(
    moments: &[Moments; HORIZONS],
    horizons: &Horizons,
    said: &[f32; HORIZONS],
    expected: impl Fn(f64) -> f64,
) -> [[f32; 3]; HORIZONS] {
    let mut ellipses = [[0.0; 3]; HORIZONS];
    let mut before: Option<[f32; 3]> = None;
    let mut followed = 0.0;
    for (i, (ellipse, moments)) in ellipses.iter_mut().zip(moments).enumerate() {
        let shape = match before {
            Some(before) => {
                // An error of the velocity grows with time.
                let growth = (horizons.times_s[i] / horizons.times_s[i - 1]) as f32;
                before.map(|value| value * growth * growth)
            }
            None => {
                let variance = expected(horizons.times_s[i]).min(f64::from(MOST_VARIANCE)) as f32;
                [variance, 0.0, variance]
            }
        };
        let mut shape = shape.map(|value| value.clamp(-MOST_VARIANCE, MOST_VARIANCE));
        if moments.n > 0.0 {
            for (value, second) in shape.iter_mut().zip(moments.second) {
                *value = (PRIOR * *value + moments.n * second) / (PRIOR + moments.n);
            }
            followed = moments.followed;
        }
        if moments.n > 0.0 || before.is_some() {
            before = Some(shape);
        }
        let scale = expf(2.0 * (said[i] + followed).clamp(-MOST_SCALE, MOST_SCALE));
        let [along, both, across] = shape.map(|value| value * scale);
        *ellipse = [along + LEAST_VARIANCE, both, across + LEAST_VARIANCE];
    }
    ellipses
}

/// The ellipses as they are published, and compared with what comes. None reaches farther than an object can be wrong that has never
/// gone faster than `fastest`, in units a second; 0 if nothing is known of that. And sizes follow what happened at each horizon by
/// itself, but of what is farther away one knows a little less.
pub(crate) fn published(
    mut ellipses: [[f32; 3]; HORIZONS],
    horizons: &Horizons,
    fastest: f32,
) -> [[f32; 3]; HORIZONS] {
    let mut least = [0.0; 2];
    for (ellipse, time_s) in ellipses.iter_mut().zip(horizons.times_s) {
        let farthest = MOST_WRONG * fastest * time_s as f32;
        let most = farthest * farthest / WITHIN_95;
        let largest = ellipse[0].max(ellipse[2]);
        if most > 0.0 && largest > most {
            *ellipse = ellipse.map(|value| value * (most / largest));
        }
        let [along, _, across] = ellipse;
        *along = along.max(least[0]);
        *across = across.max(least[1]);
        least = [LEAST_GROWTH * *along, LEAST_GROWTH * *across];
    }
    ellipses
}

/// Squared distance of an error, along and across, from the middle of an ellipse, in standard deviations.
fn distance(error: [f32; 2], ellipse: [f32; 3]) -> f32 {
    let [along, across] = error.map(f64::from);
    let [a, b, d] = ellipse.map(f64::from);
    let squared = d * along * along - 2.0 * b * along * across + a * across * across;
    // Rounding may leave nothing of a thin ellipse.
    (squared / (a * d - b * b).max(f64::MIN_POSITIVE)) as f32
}

/// A covariance along, both, across `direction` (a unit vector), along x and y.
pub(crate) fn on_axes([along, both, across]: [f32; 3], direction: [f64; 2]) -> Covariance {
    let [along, both, across] = [along, both, across].map(f64::from);
    rotated(&[[along, both], [both, across]], direction)
}
