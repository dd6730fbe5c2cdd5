//! The samples of a track relative to the newest one.
//!
//! # Weights
//!
//! Objects change their motion, so an old sample says less about the future than a new one. For
//! lines and turns, the weight of a sample falls linearly with its age, down to a fifth for the
//! oldest. On a motion that changes slowly, this is as steady as an even window of two thirds of
//! the length and follows changes sooner.

use crate::history::{History, MAX_SAMPLES};
use crate::vector::sub;

/// Minimum number of samples that tell a turn from a line.
pub(crate) const MIN_TURN_SAMPLES: usize = 3;
/// Number of steps whose median is the typical step. Gaps are rare.
const MEDIAN_STEPS: usize = 8;
/// A fit to n samples looks back n - 1 median steps times this. After a gap it therefore uses only
/// the samples since the gap, as soon as there are enough. The motion during a gap is unknown, and
/// a sample before it would dominate the velocity.
const WINDOW_STRETCH: f64 = 1.6;

/// How much less the oldest sample weighs than the newest.
const WEIGHT_DROP: f64 = 0.8;

/// A sample relative to the newest one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// Seconds after the newest sample, not positive.
    pub(crate) time_s: f64,
    pub(crate) position: [f64; 2],
}

/// Samples relative to the newest one, newest first.
pub(crate) struct Past {
    points: [Point; MAX_SAMPLES],
    len: usize,
}

impl Past {
    pub(crate) fn of(history: &History) -> Self {
        let mut past = Self {
            points: [Point {
                time_s: 0.0,
                position: [0.0; 2],
            }; MAX_SAMPLES],
            len: 0,
        };
        let samples = history.samples();
        if let Some(newest) = samples.last() {
            for (point, sample) in past.points.iter_mut().zip(samples.iter().rev()) {
                *point = Point {
                    time_s: -newest.seconds_since(sample),
                    position: sub(sample.position, newest.position),
                };
                past.len += 1;
            }
        }
        past
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Median time between two samples. `None` for fewer than two.
    pub(crate) fn median_step_s(&self) -> Option<f64> {
        let n_steps = self.len.saturating_sub(1).min(MEDIAN_STEPS);
        let mut steps_s = [0.0; MEDIAN_STEPS];
        for (step_s, pair) in steps_s.iter_mut().zip(self.points[..self.len].windows(2)) {
            *step_s = pair[0].time_s - pair[1].time_s;
        }
        let steps_s = &mut steps_s[..n_steps];
        steps_s.sort_unstable_by(f64::total_cmp);
        steps_s.get(n_steps.saturating_sub(1) / 2).copied()
    }

    /// The newest `n` samples, or all if there are fewer.
    pub(crate) fn newest(&self, n: usize) -> &[Point] {
        &self.points[..self.len.min(n)]
    }

    /// The samples within the time that `n` samples take without gaps: at most `n`, and at least
    /// `min_samples` if there are that many.
    pub(crate) fn recent(&self, n: usize, min_samples: usize, median_step_s: f64) -> &[Point] {
        let newest = self.newest(n);
        let oldest_s = -WINDOW_STRETCH * median_step_s * (n - 1) as f64;
        let n_recent = newest.partition_point(|point| point.time_s >= oldest_s);
        self.newest(n_recent.max(min_samples).min(n))
    }
}

/// Weight of a sample in a fit whose oldest sample has the time `oldest_s`.
pub(crate) fn weight(point: &Point, oldest_s: f64) -> f64 {
    1.0 - WEIGHT_DROP * point.time_s / oldest_s
}

#[cfg(test)]
pub(crate) mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    /// Uneven samples of a path, newest first, and the time of the newest.
    pub(crate) fn points(n: usize, position: impl Fn(f64) -> [f64; 2]) -> (Vec<Point>, f64) {
        let times: Vec<f64> = (0..n)
            .map(|i| i as f64 / 15.0 + 0.009 * (i % 3) as f64)
            .collect();
        let newest_s = times[n - 1];
        let newest = position(newest_s);
        let points = times.iter().rev().map(|time_s| Point {
            time_s: time_s - newest_s,
            position: sub(position(*time_s), newest),
        });
        (points.collect(), newest_s)
    }
}
