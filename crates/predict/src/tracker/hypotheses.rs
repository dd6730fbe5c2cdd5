//! Where an object may be in this frame, and how unlikely it is that something seen is this object.
//!
//! The forecast that is published is one place, the best on the whole; that an object has turned it believes only after some
//! frames. Which object a thing is, is another question: it may well be one that has just turned, or that a wall has thrown back.
//! So each of these is a hypothesis with a place of its own, and a thing counts by the one that it fits best. By the forecast
//! alone, objects that met in the frames after one of them had turned exchanged their numbers six times as often.

use libm::log;

use crate::bounds::{pushed_out, thrown_back};
use crate::covariance::{Covariance, trace};
use crate::history::Sample;
use crate::tracker::frame_context::Now;
use crate::vector::{add, norm, norm_squared, scale, sub};

/// The forecast, the newest step and a wall.
const MOST: usize = 3;
/// By how much unlikelier it is, at first sight, that an object has just turned than that the forecast is right.
const TURNED: f64 = 1.0;
/// Variances between which logarithms are finite, whatever the settings.
const VARIANCES: [f64; 2] = [1e-30, 1e30];
/// Least standard deviation of a place, in [`gate_base`](crate::Settings::gate_base).
const LEAST_SPREAD_GATES: f64 = 0.02;

/// All places where one object may be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hypotheses {
    /// The first `len` hold; the very first is the forecast.
    places: [Hypothesis; MOST],
    len: usize,
    /// Its place at the newest sample.
    last: [f64; 2],
}

/// An object is here.
#[derive(Debug, Clone, Copy)]
struct Hypothesis {
    place: [f64; 2],
    variance: f64,
    /// How unlikely it is before anything is seen.
    cost: f64,
}

impl Hypotheses {
    /// Of nothing.
    pub(crate) const NONE: Self = Self {
        places: [Hypothesis {
            place: [0.0; 2],
            variance: 1.0,
            cost: 0.0,
        }; MOST],
        len: 0,
        last: [0.0; 2],
    };

    /// Of an object with this `forecast`. `position` is its place at the newest of `samples`, `noise` the covariance of that.
    pub(crate) fn new(
        (place, covariance): ([f64; 2], Covariance),
        position: [f64; 2],
        noise: &Covariance,
        samples: &[Sample],
        now: Now<'_>,
    ) -> Self {
        let mut hypotheses = Self {
            last: position,
            ..Self::NONE
        };
        // Where the object itself was lies within, also on a floor that nothing else is known of.
        let now = Now {
            walls: pushed_out(&now.walls, position),
            ..now
        };
        hypotheses.add(place, 0.5 * trace(&covariance), 0.0, now);
        let noise = 0.5 * trace(noise);
        if let [.., before, newest] = samples {
            let ahead_ns = now.ns.saturating_sub(newest.time_ns);
            let (moved, variance) = continued([before, newest], ahead_ns, noise);
            hypotheses.add(add(position, moved), variance, TURNED, now);
        }
        // The newest step may have ended at the wall; the one before tells the velocity with which it came there.
        if let [.., older, before, newest] = samples {
            let ahead_ns = now.ns.saturating_sub(newest.time_ns);
            let (moved, variance) = continued([older, before], ahead_ns, noise);
            let beyond = add(position, moved);
            let back = thrown_back(beyond, &now.walls);
            if back != beyond {
                hypotheses.add(back, variance, TURNED, now);
            }
        }
        hypotheses
    }

    fn add(&mut self, place: [f64; 2], variance: f64, cost: f64, now: Now<'_>) {
        let least = LEAST_SPREAD_GATES * now.settings.gate_base;
        let [low, high] = now.walls;
        self.places[self.len] = Hypothesis {
            // Where nothing ever was, nothing will be seen.
            place: [0, 1].map(|axis: usize| place[axis].max(low[axis]).min(high[axis])),
            variance: (variance + least * least).clamp(VARIANCES[0], VARIANCES[1]),
            cost,
        };
        self.len += 1;
    }

    /// Where the forecast has it.
    pub(crate) fn forecast(&self) -> [f64; 2] {
        self.places[0].place
    }

    /// How far the object would have gone since its newest sample.
    pub(crate) fn way_to(&self, place: [f64; 2]) -> f64 {
        norm(sub(place, self.last))
    }

    /// Minus the logarithm of how likely the object is seen here, up to a constant.
    pub(crate) fn unlikelihood(&self, place: [f64; 2]) -> f64 {
        self.places[..self.len]
            .iter()
            .map(|hypothesis| {
                let distance_squared = norm_squared(sub(place, hypothesis.place));
                hypothesis.cost + unlikelihood(distance_squared, hypothesis.variance)
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// The same so far from the forecast, whatever else may be.
    pub(crate) fn unlikelihood_at(&self, distance: f64) -> f64 {
        unlikelihood(distance * distance, self.places[0].variance)
    }
}

/// Cauchy's distribution in the plane. A hypothesis is mostly right within its variance, but when none is, after a push or behind
/// another object, they may be wrong by any amount; so one that fits and one that is far off are likelier together than two that
/// fit badly.
fn unlikelihood(distance_squared: f64, variance: f64) -> f64 {
    log(variance) + 1.5 * log(1.0 + distance_squared / variance)
}

/// How far a step from one sample to the next leads within `ahead_ns`, and the variance of what is measured there, on each axis.
fn continued([from, to]: [&Sample; 2], ahead_ns: u64, noise: f64) -> ([f64; 2], f64) {
    let steps = ahead_ns as f64 / (to.time_ns - from.time_ns) as f64;
    let gain = (1.0 + steps) * (1.0 + steps) + steps * steps;
    let moved = scale(sub(to.position, from.position), steps);
    (moved, noise * (1.0 + gain))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounds::Walls;
    use crate::observation::Settings;

    const STEP_NS: u64 = 100_000_000;
    const WALLS: Walls = [[0.0, 0.0], [100.0, 100.0]];
    const NOISE: Covariance = [[0.1, 0.0], [0.0, 0.1]];

    /// Hypotheses of something that was at the places in one frame after the other and is expected at `forecast`.
    fn hypotheses<const N: usize>(places: [[f64; 2]; N], forecast: [f64; 2]) -> Hypotheses {
        let mut time_ns = 0;
        let samples = places.map(|position| {
            time_ns += STEP_NS;
            Sample { time_ns, position }
        });
        let now = Now {
            ns: time_ns + STEP_NS,
            walls: WALLS,
            settings: &Settings::default(),
        };
        Hypotheses::new((forecast, NOISE), places[N - 1], &NOISE, &samples, now)
    }

    fn likely(hypotheses: &Hypotheses, place: [f64; 2]) -> bool {
        hypotheses.unlikelihood(place) < hypotheses.unlikelihood_at(2.0)
    }

    #[test]
    fn what_has_just_turned_goes_on_as_in_its_newest_step() {
        let turned = hypotheses([[40.0, 50.0], [50.0, 50.0], [50.0, 60.0]], [57.0, 65.0]);
        assert!(likely(&turned, [57.0, 65.0]));
        assert!(likely(&turned, [50.0, 70.0]));
        assert!(!likely(&turned, [60.0, 60.0]));
    }

    #[test]
    fn a_wall_throws_back() {
        let before = hypotheses([[75.0, 50.0], [85.0, 50.0], [95.0, 50.0]], [105.0, 50.0]);
        assert_eq!(before.forecast(), [100.0, 50.0]);
        assert!(likely(&before, [95.0, 50.0]));
        let stopped_at_it = hypotheses([[86.0, 40.0], [96.0, 45.0], [100.0, 50.0]], [105.0, 55.0]);
        assert!(likely(&stopped_at_it, [90.0, 55.0]));
    }

    #[test]
    fn one_sample_tells_no_more_than_the_forecast() {
        let new = hypotheses([[50.0, 50.0]], [50.0, 50.0]);
        assert!(likely(&new, [50.0, 50.0]));
        assert_eq!(new.unlikelihood([50.0, 53.0]), new.unlikelihood_at(3.0));
    }

    #[test]
    fn the_forecast_is_likelier_than_a_turn() {
        let straight = hypotheses([[40.0, 50.0], [50.0, 50.0]], [50.0, 50.0]);
        assert!(straight.unlikelihood([50.0, 50.0]) < straight.unlikelihood([60.0, 50.0]));
    }
}
