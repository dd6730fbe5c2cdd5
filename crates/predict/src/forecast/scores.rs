//! How well every expert has forecast a track. Earlier forecasts are kept and compared with later
//! measurements.
//!
//! # Scores
//!
//! The running score: for every horizon, each expert has a running mean of its error (the distance,
//! not its square, since real tracks have outliers). The score is the log of that mean relative to
//! the best expert's. Far horizons are compared late and rarely, so their scores are drawn towards
//! those of the horizon before.
//!
//! The recent score covers the last few forecasts, compared with the next sample. A running mean
//! has a memory of seconds, while a start or a bounce happens within a frame.
//!
//! The fit score is the distance between an expert's fit and the newest position, relative to the
//! typical error. At a bounce all good experts are suddenly wrong, and only this score shows it in
//! the same frame.
//!
//! # Comparisons
//!
//! A forecast is compared once per horizon, with the first sample that is due, at most half a frame
//! early, and at the time of that sample. Experts are functions of time, so uneven frames need no
//! interpolation. Of the forecasts older than [`RECENT_STEPS`] only every [`THINNING`]th is kept:
//! errors far ahead overlap, and the others would add little.

use libm::{logf, sqrtf};

use crate::forecast::comparison::{Comparison, Issued, between, error_length};
use crate::forecast::ellipse::Moments;
use crate::forecast::horizon::Horizons;
use crate::forecast::motion::Motion;
use crate::forecast::past::MIN_TURN_SAMPLES;
use crate::history::Sample;
use crate::layout::{ByExpert, EXPERTS, HORIZONS, SCORES};
use crate::vector::{norm, sub};

/// All forecasts of this many newest steps are kept. Of older ones only every [`THINNING`]th is.
const RECENT_STEPS: f64 = 8.5;
const THINNING: u64 = 4;
/// Capacity for pending forecasts. At the minimum spacing, eleven are recent, eight are older, and
/// one is new.
const MAX_PENDING: usize = 20;
/// Minimum spacing of kept forecasts in steps, except for the first few of a track.
const MIN_SPACING_STEPS: f64 = 0.75;
/// A sample is due for a horizon from half a frame before it, and until this fraction of its time
/// after it, or one step if that is longer.
const MAX_DELAY_RATIO: f64 = 0.25;
/// Memory of the running means at the first and the last horizon, in comparisons.
const MEMORY: [f32; 2] = [10.0, 33.0];
/// Memory of the recent score in comparisons.
const RECENT_MEMORY: f32 = 2.5;
/// The fit score starts at this many typical errors. If it were more sensitive, ordinary noise
/// would count against long fits, which are the best for pedestrians.
const FIT_TOLERANCE: f32 = 3.0;
/// Weight of the prior in comparisons: of an even score at the first horizon, of the score of the
/// previous horizon after it.
const PRIOR: [f32; 2] = [0.3, 3.0];
/// Minimum number of samples behind a forecast for its first comparison and for later ones. Two
/// samples show whether an object moves, but forecasts far ahead that are made from them say
/// nothing about an expert.
const MIN_SAMPLES: [usize; 2] = [2, 4];
/// Assumed growth of the best expert's error from one horizon to the next.
const GROWTH: f32 = 1.6;
/// Error below which experts count as equally good, as a fraction of the mean step and of the
/// maximum step.
const ERROR_FLOOR: [f32; 2] = [3e-5, 1e-8];
/// Memory of the mean step in samples.
const STEP_MEMORY: f32 = 10.0;

/// A forecast that waits for comparison.
#[derive(Debug, Clone, Copy)]
struct Pending {
    issued: Issued,
    next_horizon: usize,
    /// Whether it was compared at any horizon, and whether it was compared with the next sample.
    compared: bool,
    compared_next: bool,
    serial: u64,
}

/// Running sums of errors at one horizon.
#[derive(Debug, Clone, Copy)]
struct ErrorSums {
    n: f32,
    errors: [f32; EXPERTS],
}

/// The scores of one track.
#[derive(Debug, Clone)]
pub(crate) struct Scores {
    pending: [Pending; MAX_PENDING],
    n_pending: usize,
    n_issued: u64,
    error_sums: [ErrorSums; HORIZONS],
    recent: [f32; EXPERTS],
    /// Error moments of the mixture.
    pub(crate) moments: [Moments; HORIZONS],
    /// Typical error of the best expert by horizon.
    best: [f32; HORIZONS],
    /// Mean distance per step, and the number of steps in it.
    mean_step: f32,
    n_steps: f32,
    /// Maximum distance per step.
    pub(crate) max_step: f32,
}

/// The current scores.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScoreSummary {
    pub(crate) scores: ByExpert<[f32; SCORES]>,
    /// Number of comparisons by horizon.
    pub(crate) n: [f32; HORIZONS],
    /// Typical error of the best expert by horizon, not below the error floor.
    pub(crate) best: [f32; HORIZONS],
    /// Log of the best expert's recent error relative to its typical error one step ahead. When an
    /// object starts to move differently, all experts are wrong at once.
    pub(crate) surprise: f32,
    /// Error below which differences are meaningless.
    pub(crate) min_error: f32,
}

impl Scores {
    pub(crate) const START: Self = Self {
        pending: [Pending::NONE; MAX_PENDING],
        n_pending: 0,
        n_issued: 0,
        error_sums: [ErrorSums::NONE; HORIZONS],
        recent: [0.0; EXPERTS],
        moments: [Moments::NONE; HORIZONS],
        best: [0.0; HORIZONS],
        mean_step: 0.0,
        n_steps: 0.0,
        max_step: 0.0,
    };

    /// Drops the pending forecasts but keeps the scores.
    pub(crate) fn discard_pending(&mut self) {
        self.n_pending = 0;
    }

    /// Keeps a forecast for later comparison.
    pub(crate) fn issue(&mut self, issued: Issued, horizons: &Horizons) {
        let pending = &self.pending[..self.n_pending];
        let early = issued.n_samples < MIN_SAMPLES[1];
        if !early
            && pending.last().is_some_and(|last| {
                issued.newest.seconds_since(&last.issued.newest)
                    < MIN_SPACING_STEPS * horizons.step_s
            })
        {
            return;
        }
        if self.n_pending == MAX_PENDING {
            self.pending.copy_within(1.., 0);
            self.n_pending -= 1;
        }
        self.pending[self.n_pending] = Pending {
            issued,
            next_horizon: 0,
            compared: false,
            compared_next: false,
            serial: self.n_issued,
        };
        self.n_pending += 1;
        self.n_issued += 1;
    }

    /// Compares the pending forecasts with the newest sample, given the sample `before` it. Passes
    /// each comparison to `on_comparison`.
    pub(crate) fn compare(
        &mut self,
        newest: &Sample,
        before: Option<&Sample>,
        horizons: &Horizons,
        mut on_comparison: impl FnMut(&Comparison<'_>),
    ) {
        let step_s = horizons.step_s;
        self.compare_next(newest, step_s);
        if let Some(before) = before {
            let steps = newest.seconds_since(before) / step_s;
            if steps > 0.0 {
                let length = (norm(sub(newest.position, before.position)) / steps) as f32;
                self.n_steps = (self.n_steps + 1.0).min(STEP_MEMORY);
                self.mean_step += (length - self.mean_step) / self.n_steps;
                self.max_step = self.max_step.max(length);
            }
        }
        for slot in 0..self.n_pending {
            let age_s = newest.seconds_since(&self.pending[slot].issued.newest);
            loop {
                let horizon = self.pending[slot].next_horizon;
                if horizon == HORIZONS || age_s < horizons.times_s[horizon] - 0.5 * horizons.frame_s
                {
                    break;
                }
                self.pending[slot].next_horizon += 1;
                let due_s = horizons.times_s[horizon];
                let Pending {
                    issued, compared, ..
                } = &mut self.pending[slot];
                if age_s > due_s + step_s.max(MAX_DELAY_RATIO * due_s)
                    || issued.n_samples < MIN_SAMPLES[usize::from(*compared)]
                {
                    continue;
                }
                let first = !core::mem::replace(compared, true);
                let comparison = Comparison::of(issued, horizon, age_s, newest, self.best[horizon]);
                let errors = comparison.errors();
                if first && issued.n_samples == MIN_TURN_SAMPLES {
                    // Fewer samples do not tell a turn from a line. Their scores would hide these.
                    self.error_sums[horizon] = ErrorSums::NONE;
                }
                self.error_sums[horizon].add(horizon, &errors);
                self.moments[horizon].add(horizon, &comparison);
                on_comparison(&comparison);
            }
        }
        self.thin_out(newest, step_s);
    }

    /// Compares the newest pending forecast with the next sample, however late. After a gap this is
    /// the only information on what happened meanwhile.
    fn compare_next(&mut self, newest: &Sample, step_s: f64) {
        let Some(Pending {
            issued,
            compared_next,
            ..
        }) = self.pending[..self.n_pending].last_mut()
        else {
            return;
        };
        if core::mem::replace(compared_next, true) || issued.n_samples < MIN_SAMPLES[0] {
            return;
        }
        if issued.n_samples == MIN_TURN_SAMPLES {
            self.recent = [0.0; EXPERTS];
        }
        let age_s = newest.seconds_since(&issued.newest);
        // Errors grow with time. A late comparison must not outweigh the next ones.
        let steps = (age_s / step_s).max(1.0) as f32;
        let measured = sub(newest.position, issued.newest.position).map(|c| c as f32);
        for (recent, motion) in self.recent.iter_mut().zip(&issued.motions) {
            let [x, y] = motion.at(age_s as f32);
            let error = error_length([x - measured[0], y - measured[1]]) / steps;
            *recent += (error * error - *recent) / RECENT_MEMORY;
        }
    }

    /// Drops forecasts that were compared at all horizons, and most of the old ones.
    fn thin_out(&mut self, newest: &Sample, step_s: f64) {
        let mut kept = 0;
        for slot in 0..self.n_pending {
            let pending = &self.pending[slot];
            let old = newest.seconds_since(&pending.issued.newest) > RECENT_STEPS * step_s;
            let thinned = old && !pending.serial.is_multiple_of(THINNING);
            if pending.next_horizon < HORIZONS && !thinned {
                if kept < slot {
                    self.pending[kept] = self.pending[slot];
                }
                kept += 1;
            }
        }
        self.n_pending = kept;
    }

    /// The current scores of these motions. `reach` is the maximum distance that the object moves
    /// in a frame, in units.
    pub(crate) fn summary(&mut self, motions: &[Motion; EXPERTS], reach: f64) -> ScoreSummary {
        let floor = ERROR_FLOOR[0] * self.mean_step + ERROR_FLOOR[1] * reach as f32;
        let mut summary = ScoreSummary {
            scores: [[[0.0; SCORES]; EXPERTS]; HORIZONS],
            n: [0.0; HORIZONS],
            best: [0.0; HORIZONS],
            surprise: 0.0,
            min_error: floor,
        };
        let mut running = [[0.0; SCORES]; EXPERTS];
        let min_recent = min_of(&self.recent);
        for ([_, score, _], recent) in running.iter_mut().zip(&self.recent) {
            *score = logf((recent + floor * floor) / (min_recent + floor * floor));
        }
        let mut best = 0.0;
        for (horizon, sums) in self.error_sums.iter().enumerate() {
            best *= GROWTH;
            if sums.n > 0.0 {
                let gain = sums.n / (sums.n + PRIOR[usize::from(horizon > 0)]);
                let min = min_of(&sums.errors) / sums.n;
                for ([running, ..], errors) in running.iter_mut().zip(&sums.errors) {
                    let ratio = (errors / sums.n + floor) / (min + floor);
                    *running += gain * (2.0 * logf(ratio) - *running);
                }
                best = if horizon == 0 {
                    min
                } else {
                    best + gain * (min - best)
                };
            }
            summary.scores[horizon] = running;
            summary.n[horizon] = sums.n;
            summary.best[horizon] = best + floor;
        }
        if self.error_sums[0].n > 0.0 {
            let tolerance = FIT_TOLERANCE * summary.best[0];
            let fit_scores = motions.map(|motion| {
                let [x, y] = motion.at(0.0).map(|c| c / tolerance);
                logf(1.0 + x * x + y * y)
            });
            for row in &mut summary.scores {
                for ([.., score], fit_score) in row.iter_mut().zip(fit_scores) {
                    *score = fit_score;
                }
            }
        }
        summary.surprise = logf((sqrtf(min_recent) + floor) / summary.best[0]);
        self.best = summary.best;
        summary
    }
}

impl Pending {
    const NONE: Self = Self {
        issued: Issued::NONE,
        next_horizon: 0,
        compared: false,
        compared_next: false,
        serial: 0,
    };
}

impl ErrorSums {
    const NONE: Self = Self {
        n: 0.0,
        errors: [0.0; EXPERTS],
    };

    fn add(&mut self, horizon: usize, errors: &[f32; EXPERTS]) {
        let keep = 1.0 - 1.0 / between(MEMORY, horizon);
        self.n = self.n * keep + 1.0;
        for (sum, error) in self.errors.iter_mut().zip(errors) {
            *sum = *sum * keep + error;
        }
    }
}

fn min_of(values: &[f32; EXPERTS]) -> f32 {
    values.iter().fold(f32::INFINITY, |a, b| a.min(*b))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: u64 = 100_000_000;

    /// Scores after `n` samples at rest, where expert e was always wrong by e units along x.
    fn book(n: u64) -> Scores {
        let horizons = Horizons::new(0.1);
        let mut scores = Scores::START;
        let motions = core::array::from_fn(|e| Motion::Rest {
            origin: [e as f32, 0.0],
        });
        let mut shares = [[0.0; EXPERTS]; HORIZONS];
        for row in &mut shares {
            row[2] = 1.0;
        }
        let mut before: Option<Sample> = None;
        for i in 0..n {
            let newest = Sample {
                time_ns: i * STEP_NS,
                position: [7.0, 8.0],
            };
            scores.compare(&newest, before.as_ref(), &horizons, |comparison| {
                assert_eq!(comparison.mixed, [2.0, 0.0]);
                assert_eq!(comparison.measured, [0.0; 2]);
            });
            scores.summary(&motions, 1.0);
            let issued = Issued {
                newest,
                n_samples: 9,
                motions,
                shares,
                ellipses: [[1.0, 0.0, 1.0]; HORIZONS],
                ..Issued::NONE
            };
            scores.issue(issued, &horizons);
            before = Some(newest);
        }
        scores
    }

    #[test]
    fn scores_are_log_ratios_to_the_best_expert() {
        let summary = book(200).summary(&[Motion::NONE; EXPERTS], 1.0);
        for row in &summary.scores {
            assert_eq!(row[0], [0.0; SCORES]);
            let difference = row[6][0] - row[3][0];
            assert!((difference - 2.0 * 2.0_f32.ln()).abs() < 0.05, "{row:?}");
        }
    }

    #[test]
    fn far_horizons_use_near_scores_until_compared() {
        let summary = book(4).summary(&[Motion::NONE; EXPERTS], 1.0);
        let compared = summary.n.iter().filter(|n| **n > 0.0).count();
        assert!((2..6).contains(&compared), "{:?}", summary.n);
        assert!(summary.scores[HORIZONS - 1][5][0] > 5.0);
    }

    /// Number of comparisons per horizon for an object at rest.
    fn comparisons(
        step_ns: u64,
        n: u64,
        mut on_comparison: impl FnMut(&Sample, &Comparison<'_>),
    ) -> [u32; HORIZONS] {
        let horizons = Horizons::new(step_ns as f64 / 1e9);
        let mut n_compared = [0; HORIZONS];
        let mut scores = Scores::START;
        for i in 0..n {
            let newest = Sample {
                time_ns: i * step_ns,
                position: [0.0; 2],
            };
            scores.compare(&newest, None, &horizons, |comparison| {
                n_compared[comparison.horizon] += 1;
                on_comparison(&newest, comparison);
            });
            let issued = Issued {
                newest,
                n_samples: 9,
                ellipses: [[1.0, 0.0, 1.0]; HORIZONS],
                ..Issued::NONE
            };
            scores.issue(issued, &horizons);
        }
        n_compared
    }

    #[test]
    fn every_kept_forecast_is_compared_once_per_horizon() {
        let times_s = Horizons::new(0.1).times_s;
        let n_compared = comparisons(STEP_NS, 100, |newest, comparison| {
            let due_s = times_s[comparison.horizon];
            let age_s = newest.seconds_since(&comparison.issued.newest);
            assert!((age_s - due_s).abs() < 0.051, "{age_s} for {due_s}");
        });
        assert_eq!(n_compared[0], 99);
        assert_eq!(
            n_compared[HORIZONS - 1],
            20,
            "every fourth, from 2 s on: {n_compared:?}"
        );
    }

    #[test]
    fn every_horizon_is_compared_at_every_rate() {
        for rate_hz in [
            3, 5, 8, 12, 15, 20, 24, 25, 30, 50, 60, 75, 90, 100, 120, 200,
        ] {
            let n_compared = comparisons(1_000_000_000 / rate_hz, 20 * rate_hz, |_, _| {});
            assert!(
                n_compared.iter().all(|n| *n > 10),
                "{rate_hz} Hz: {n_compared:?}"
            );
        }
    }

    #[test]
    fn forecasts_due_within_a_gap_are_not_compared() {
        let mut scores = book(3);
        let horizons = Horizons::new(0.1);
        let late = Sample {
            time_ns: 10_000_000_000,
            position: [0.0; 2],
        };
        scores.compare(&late, None, &horizons, |comparison| {
            panic!("compared at {}", comparison.horizon)
        });
        assert_eq!(scores.n_pending, 0);
    }
}
