//! Positions where an object may be in a frame, and how likely an observation is under them.
//!
//! The published forecast is a single position, the best on average. It follows a turn only after
//! some frames. Association is another question: an observation may well belong to an object that
//! has just turned or bounced off a wall. Each of these is a hypothesis with its own position, and
//! an observation counts by the one that fits best. With the forecast alone, objects that meet just
//! after one of them has turned switch identities six times as often.

use libm::log;

use crate::bounds::{expanded, reflected};
use crate::covariance::{Covariance, trace};
use crate::history::Sample;
use crate::tracker::frame_context::FrameContext;
use crate::vector::{add, norm, norm_squared, scale, sub};

/// Maximum number of hypotheses: the forecast, the newest step, and a reflection.
const MAX_HYPOTHESES: usize = 3;
/// Cost of the assumption that an object has just turned, relative to the forecast.
const TURN_COST: f64 = 1.0;
/// Range of variances, such that their logarithms are finite whatever the settings.
const VARIANCES: [f64; 2] = [1e-30, 1e30];
/// Minimum standard deviation of a position, in [`gate_base`](crate::Settings::gate_base).
const MIN_SPREAD_GATES: f64 = 0.02;

/// All positions where one object may be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hypotheses {
    /// The first `len` are valid. The first one is the forecast.
    list: [Hypothesis; MAX_HYPOTHESES],
    len: usize,
    /// Position at the newest sample.
    last: [f64; 2],
}

/// A position where an object may be.
#[derive(Debug, Clone, Copy)]
struct Hypothesis {
    position: [f64; 2],
    variance: f64,
    /// Cost before anything is observed.
    cost: f64,
}

impl Hypotheses {
    /// An empty value.
    pub(crate) const NONE: Self = Self {
        list: [Hypothesis {
            position: [0.0; 2],
            variance: 1.0,
            cost: 0.0,
        }; MAX_HYPOTHESES],
        len: 0,
        last: [0.0; 2],
    };

    /// Hypotheses of an object with this `forecast`. `last` is its position at the newest of
    /// `samples`, with the covariance `noise`.
    pub(crate) fn new(
        (expected, covariance): ([f64; 2], Covariance),
        last: [f64; 2],
        noise: &Covariance,
        samples: &[Sample],
        frame: FrameContext<'_>,
    ) -> Self {
        let mut hypotheses = Self { last, ..Self::NONE };
        // The object's own position is within the bounds, even on a floor where nothing else has
        // been observed.
        let frame = FrameContext {
            bounds: expanded(&frame.bounds, last),
            ..frame
        };
        hypotheses.add(expected, 0.5 * trace(&covariance), 0.0, frame);
        let noise = 0.5 * trace(noise);
        if let [.., before, newest] = samples {
            let ahead_ns = frame.time_ns.saturating_sub(newest.time_ns);
            let (offset, variance) = extrapolated([before, newest], ahead_ns, noise);
            hypotheses.add(add(last, offset), variance, TURN_COST, frame);
        }
        // The newest step may have ended at a wall. The one before shows the velocity with which
        // the object came there.
        if let [.., older, before, newest] = samples {
            let ahead_ns = frame.time_ns.saturating_sub(newest.time_ns);
            let (offset, variance) = extrapolated([older, before], ahead_ns, noise);
            let beyond = add(last, offset);
            let back = reflected(beyond, &frame.bounds);
            if back != beyond {
                hypotheses.add(back, variance, TURN_COST, frame);
            }
        }
        hypotheses
    }

    fn add(&mut self, position: [f64; 2], variance: f64, cost: f64, frame: FrameContext<'_>) {
        let min_spread = MIN_SPREAD_GATES * frame.settings.gate_base;
        let [low, high] = frame.bounds;
        self.list[self.len] = Hypothesis {
            // Nothing is expected where nothing has ever been observed.
            position: [0, 1].map(|axis: usize| position[axis].max(low[axis]).min(high[axis])),
            variance: (variance + min_spread * min_spread).clamp(VARIANCES[0], VARIANCES[1]),
            cost,
        };
        self.len += 1;
    }

    /// Position of the forecast.
    pub(crate) fn forecast(&self) -> [f64; 2] {
        self.list[0].position
    }

    /// Distance of a position from the newest sample.
    pub(crate) fn distance_from_last(&self, position: [f64; 2]) -> f64 {
        norm(sub(position, self.last))
    }

    /// Negative log-likelihood of an observation of this object at a position, up to a constant.
    pub(crate) fn neg_log_likelihood(&self, position: [f64; 2]) -> f64 {
        self.list[..self.len]
            .iter()
            .map(|hypothesis| {
                let distance_squared = norm_squared(sub(position, hypothesis.position));
                hypothesis.cost + neg_log_likelihood(distance_squared, hypothesis.variance)
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// The same at a distance from the forecast, without the other hypotheses.
    pub(crate) fn neg_log_likelihood_at(&self, distance: f64) -> f64 {
        neg_log_likelihood(distance * distance, self.list[0].variance)
    }
}

/// Negative log-likelihood of a Cauchy distribution in the plane. A hypothesis is mostly right
/// within its variance, but after a push or an occlusion all of them may be wrong by any amount.
/// With heavy tails, one good and one very bad match are likelier together than two moderate ones.
fn neg_log_likelihood(distance_squared: f64, variance: f64) -> f64 {
    log(variance) + 1.5 * log(1.0 + distance_squared / variance)
}

/// Extrapolates the step between two samples to `ahead_ns` after the second one. Returns the offset
/// from it, and the variance per axis of a measurement there.
fn extrapolated([from, to]: [&Sample; 2], ahead_ns: u64, noise: f64) -> ([f64; 2], f64) {
    let steps = ahead_ns as f64 / (to.time_ns - from.time_ns) as f64;
    let gain = (1.0 + steps) * (1.0 + steps) + steps * steps;
    let offset = scale(sub(to.position, from.position), steps);
    (offset, noise * (1.0 + gain))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounds::Bounds;
    use crate::observation::Settings;

    const STEP_NS: u64 = 100_000_000;
    const WALLS: Bounds = [[0.0, 0.0], [100.0, 100.0]];
    const NOISE: Covariance = [[0.1, 0.0], [0.0, 0.1]];

    /// Hypotheses of an object that was at these positions in successive frames and is expected at
    /// `forecast`.
    fn hypotheses<const N: usize>(positions: [[f64; 2]; N], forecast: [f64; 2]) -> Hypotheses {
        let mut time_ns = 0;
        let samples = positions.map(|position| {
            time_ns += STEP_NS;
            Sample { time_ns, position }
        });
        let frame = FrameContext {
            time_ns: time_ns + STEP_NS,
            since_last_s: 0.1,
            bounds: WALLS,
            settings: &Settings::default(),
        };
        Hypotheses::new((forecast, NOISE), positions[N - 1], &NOISE, &samples, frame)
    }

    fn likely(hypotheses: &Hypotheses, position: [f64; 2]) -> bool {
        hypotheses.neg_log_likelihood(position) < hypotheses.neg_log_likelihood_at(2.0)
    }

    #[test]
    fn a_turned_object_continues_its_newest_step() {
        let turned = hypotheses([[40.0, 50.0], [50.0, 50.0], [50.0, 60.0]], [57.0, 65.0]);
        assert!(likely(&turned, [57.0, 65.0]));
        assert!(likely(&turned, [50.0, 70.0]));
        assert!(!likely(&turned, [60.0, 60.0]));
    }

    #[test]
    fn a_wall_reflects() {
        let before = hypotheses([[75.0, 50.0], [85.0, 50.0], [95.0, 50.0]], [105.0, 50.0]);
        assert_eq!(before.forecast(), [100.0, 50.0]);
        assert!(likely(&before, [95.0, 50.0]));
        let stopped_at_it = hypotheses([[86.0, 40.0], [96.0, 45.0], [100.0, 50.0]], [105.0, 55.0]);
        assert!(likely(&stopped_at_it, [90.0, 55.0]));
    }

    #[test]
    fn one_sample_gives_only_the_forecast() {
        let new = hypotheses([[50.0, 50.0]], [50.0, 50.0]);
        assert!(likely(&new, [50.0, 50.0]));
        assert_eq!(
            new.neg_log_likelihood([50.0, 53.0]),
            new.neg_log_likelihood_at(3.0)
        );
    }

    #[test]
    fn the_forecast_is_likelier_than_a_turn() {
        let straight = hypotheses([[40.0, 50.0], [50.0, 50.0]], [50.0, 50.0]);
        assert!(
            straight.neg_log_likelihood([50.0, 50.0]) < straight.neg_log_likelihood([60.0, 50.0])
        );
    }
}
