//! Error ellipses of a forecast, from the past errors of the mixture at each horizon.
//!
//! The shape comes from second moments along and across the motion. Before there are enough errors,
//! it comes from the previous horizon, grown with time. The size is corrected twice. The network
//! predicts a scale from the current motion. Then, because errors are seldom normal, the size
//! follows the outcome: a miss enlarges it by a step, a hit shrinks it by a nineteenth of that, so
//! that in the long run 95 % of the measurements are inside the 95 % ellipse (Gibbs and Candès,
//! "Adaptive conformal inference under distribution shift").
//!
//! The size is limited by the distance that the object could be wrong at the highest speed it has
//! shown. The ellipse covers the measurement, noise included. It cannot anticipate rare events
//! without warning, such as the first wall in the way of an object.

use libm::expf;

use crate::covariance::{Covariance, rotated};
use crate::forecast::comparison::{Comparison, between};
use crate::forecast::horizon::Horizons;
use crate::layout::HORIZONS;

/// 95 % quantile of the chi-squared distribution with two degrees of freedom.
const WITHIN_95: f32 = 5.991;
/// Target share of measurements outside the ellipse.
const OUTSIDE: f32 = 0.05;
/// Memory of the moments in comparisons.
const MEMORY: f32 = 60.0;
/// Weight of the prior moments in comparisons.
const PRIOR: f32 = 3.0;
/// Conformal step of the log scale at the first and the last horizon. At the last one, a single
/// event causes many misses in a row.
const CONFORMAL_STEP: [f32; 2] = [0.15, 0.2];
/// Range of the conformal log scale. Where a nearer horizon determines the size, this one only ever
/// shrinks. It must not shrink far, or it would be missing when the nearer one shrinks.
const CONFORMAL_RANGE: [f32; 2] = [-1.0, 2.0];
/// Maximum of the total log scale.
const MAX_LOG_SCALE: f32 = 3.0;
/// Minimum growth of a variance from one horizon to the next.
const MIN_GROWTH: f32 = 1.02;
/// Maximum error of a forecast, in distances covered at the object's highest speed. It may turn
/// back, so this is 2.
const MAX_ERROR_TRAVEL: f32 = 2.0;
/// Limits of errors and variances, in units and squared units, so that sums of squares stay finite.
const MAX_ERROR: f32 = 1e14;
const MAX_VARIANCE: f32 = 1e30;
/// Minimum variance in squared units, so that an ellipse has an inside.
const MIN_VARIANCE: f32 = 1e-12;

/// Errors of the mixture at one horizon.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moments {
    n: f32,
    /// Second moments: along, both, across the motion.
    second: [f32; 3],
    /// Log scale of the conformal correction.
    conformal: f32,
}

impl Moments {
    pub(crate) const NONE: Self = Self {
        n: 0.0,
        second: [0.0; 3],
        conformal: 0.0,
    };

    pub(crate) fn add(&mut self, horizon: usize, comparison: &Comparison<'_>) {
        let [x, y] = [0, 1].map(|axis| {
            let error = comparison.measured[axis] - comparison.mixed[axis];
            error.clamp(-MAX_ERROR, MAX_ERROR)
        });
        if x.is_nan() || y.is_nan() {
            return;
        }
        let [c, s] = comparison.issued.direction;
        let (along, across) = (c * x + s * y, c * y - s * x);
        let distance = distance([along, across], comparison.issued.ellipses[horizon]);
        let missed = if distance > WITHIN_95 { 1.0 } else { 0.0 };
        self.conformal += between(CONFORMAL_STEP, horizon) * (missed - OUTSIDE);
        self.conformal = self.conformal.clamp(CONFORMAL_RANGE[0], CONFORMAL_RANGE[1]);
        self.n = (self.n + 1.0).min(MEMORY);
        let second = [along * along, along * across, across * across];
        for (mean, value) in self.second.iter_mut().zip(second) {
            *mean += (value - *mean) / self.n;
        }
    }
}

/// Covariances by horizon: along, both, across the motion. `log_scales` are the log scales of the
/// network; `expected` gives the variance per axis until errors are known.
pub(crate) fn ellipses(
    moments: &[Moments; HORIZONS],
    horizons: &Horizons,
    log_scales: &[f32; HORIZONS],
    expected: impl Fn(f64) -> f64,
) -> [[f32; 3]; HORIZONS] {
    let mut ellipses = [[0.0; 3]; HORIZONS];
    let mut before: Option<[f32; 3]> = None;
    let mut conformal = 0.0;
    for (i, (ellipse, moments)) in ellipses.iter_mut().zip(moments).enumerate() {
        let shape = match before {
            Some(before) => {
                // An error of the velocity grows with time.
                let growth = (horizons.times_s[i] / horizons.times_s[i - 1]) as f32;
                before.map(|value| value * growth * growth)
            }
            None => {
                let variance = expected(horizons.times_s[i]).min(f64::from(MAX_VARIANCE)) as f32;
                [variance, 0.0, variance]
            }
        };
        let mut shape = shape.map(|value| value.clamp(-MAX_VARIANCE, MAX_VARIANCE));
        if moments.n > 0.0 {
            for (value, second) in shape.iter_mut().zip(moments.second) {
                *value = (PRIOR * *value + moments.n * second) / (PRIOR + moments.n);
            }
            conformal = moments.conformal;
        }
        if moments.n > 0.0 || before.is_some() {
            before = Some(shape);
        }
        let scale = expf(2.0 * (log_scales[i] + conformal).clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE));
        let [along, both, across] = shape.map(|value| value * scale);
        *ellipse = [along + MIN_VARIANCE, both, across + MIN_VARIANCE];
    }
    ellipses
}

/// The ellipses as published and compared with measurements. None exceeds the error possible at
/// `max_speed`, in units per second, where 0 means unknown. Each horizon is corrected separately,
/// but a variance never falls from one horizon to the next.
pub(crate) fn limited_ellipses(
    mut ellipses: [[f32; 3]; HORIZONS],
    horizons: &Horizons,
    max_speed: f32,
) -> [[f32; 3]; HORIZONS] {
    let mut min_variances = [0.0; 2];
    for (ellipse, time_s) in ellipses.iter_mut().zip(horizons.times_s) {
        let max_error = MAX_ERROR_TRAVEL * max_speed * time_s as f32;
        let max_variance = max_error * max_error / WITHIN_95;
        let largest = ellipse[0].max(ellipse[2]);
        if max_variance > 0.0 && largest > max_variance {
            *ellipse = ellipse.map(|value| value * (max_variance / largest));
        }
        let [along, _, across] = ellipse;
        *along = along.max(min_variances[0]);
        *across = across.max(min_variances[1]);
        min_variances = [MIN_GROWTH * *along, MIN_GROWTH * *across];
    }
    ellipses
}

/// Squared Mahalanobis distance of an error, given along and across.
fn distance(error: [f32; 2], ellipse: [f32; 3]) -> f32 {
    let [along, across] = error.map(f64::from);
    let [a, b, d] = ellipse.map(f64::from);
    let squared = d * along * along - 2.0 * b * along * across + a * across * across;
    // For a thin ellipse, rounding may leave a determinant of zero.
    (squared / (a * d - b * b).max(f64::MIN_POSITIVE)) as f32
}

/// Rotates a covariance given along, both, across `direction` (a unit vector) to the x and y axes.
pub(crate) fn on_axes([along, both, across]: [f32; 3], direction: [f64; 2]) -> Covariance {
    let [along, both, across] = [along, both, across].map(f64::from);
    rotated(&[[along, both], [both, across]], direction)
}
