//! The samples of a track relative to the newest one.
//!
//! # Weights
//!
//! Things change their minds: the older a place, the less it tells of what comes. So for lines and turns a place's weight falls
//! evenly with its age, down to a fifth for the oldest. On a motion that changes slowly this is as steady as an even window of two
//! thirds of the length, and follows sooner.

use crate::history::{History, MAX_SAMPLES};
use crate::vector::sub;

/// Fewest samples that tell a turn from a line.
pub(crate) const MIN_TURN_SAMPLES: usize = 3;
/// Steps whose median is the usual one: gaps are seldom.
const USUAL_STEPS: usize = 8;
/// A fit to n samples looks back n - 1 usual steps times this. So after a gap it holds what has been seen since, as soon as that is
/// enough: what happened in a gap is not known, and a place before it, far back in time, would tell more of a velocity than all since.
const STRETCH: f64 = 1.6;

/// By how much less the oldest place counts than one of the newest moment.
const FALL: f64 = 0.8;

/// A place of the past relative to the newest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// Seconds after the newest place, not positive.
    pub(crate) time_s: f64,
    pub(crate) place: [f64; 2],
}

/// The newest samples relative to the newest, newest first.
pub(crate) struct Past {
    points: [Point; MAX_SAMPLES],
    len: usize,
}

impl Past {
    pub(crate) fn of(history: &History) -> Self {
        let mut past = Self {
            points: [Point {
                time_s: 0.0,
                place: [0.0; 2],
            }; MAX_SAMPLES],
            len: 0,
        };
        let samples = history.samples();
        if let Some(newest) = samples.last() {
            for (point, sample) in past.points.iter_mut().zip(samples.iter().rev()) {
                *point = Point {
                    time_s: -newest.seconds_since(sample),
                    place: sub(sample.position, newest.position),
                };
                past.len += 1;
            }
        }
        past
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Usual time between two samples; `None` for fewer than two.
    pub(crate) fn usual_step_s(&self) -> Option<f64> {
        let n_steps = self.len.saturating_sub(1).min(USUAL_STEPS);
        let mut steps_s = [0.0; USUAL_STEPS];
        for (step_s, pair) in steps_s.iter_mut().zip(self.points[..self.len].windows(2)) {
            *step_s = pair[0].time_s - pair[1].time_s;
        }
        let steps_s = &mut steps_s[..n_steps];
        steps_s.sort_unstable_by(f64::total_cmp);
        steps_s.get(n_steps.saturating_sub(1) / 2).copied()
    }

    /// The newest `n` or those there are.
    pub(crate) fn newest(&self, n: usize) -> &[Point] {
        &self.points[..self.len.min(n)]
    }

    /// The samples of the time that `n` of them take when none is missing, at most `n`, and at least the newest `least`, as far
    /// as there are so many.
    pub(crate) fn recent(&self, n: usize, least: usize, usual_step_s: f64) -> &[Point] {
        let newest = self.newest(n);
        let oldest_s = -STRETCH * usual_step_s * (n - 1) as f64;
        let n_recent = newest.partition_point(|point| point.time_s >= oldest_s);
        self.newest(n_recent.max(least).min(n))
    }
}

/// Weight of a place among others, the oldest of which is of the moment `oldest_s`, before the newest.
pub(crate) fn weight(point: &Point, oldest_s: f64) -> f64 {
    1.0 - FALL * point.time_s / oldest_s
}

#[cfg(test)]
pub(crate) mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    /// Places of a path at uneven moments, newest first, and the newest moment.
    pub(crate) fn points(n: usize, place: impl Fn(f64) -> [f64; 2]) -> (Vec<Point>, f64) {
        let times: Vec<f64> = (0..n)
            .map(|i| i as f64 / 15.0 + 0.009 * (i % 3) as f64)
            .collect();
        let newest_s = times[n - 1];
        let newest = place(newest_s);
        let points = times.iter().rev().map(|time_s| Point {
            time_s: time_s - newest_s,
            place: sub(place(*time_s), newest),
        });
        (points.collect(), newest_s)
    }
}
