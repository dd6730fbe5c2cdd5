//! How well every expert has forecast a track: earlier forecasts are kept and compared with what came.
//!
//! # Marks
//!
//! For every horizon each expert has a running mean of its error (the distance, not its square: real tracks have
//! outliers). Its mark is the logarithm of that mean over the best expert's. Far horizons are compared late and seldom, so a mark
//! is drawn towards that of the horizon before. A second mark is of the last few forecasts and the samples that came next: a running mean
//! remembers seconds, while a start or a bounce happens in one frame. A third tells how far an expert's fit passes the newest place,
//! over the usual error: at the moment of a bounce all that was good is wrong, and only this says so in the same frame.
//!
//! # Comparisons
//!
//! A forecast is compared once at every horizon, by the first sample that is due or not half a frame early, at that sample's own
//! moment: experts are functions of time, so uneven frames need no interpolation. Of forecasts older than
//! [`RECENT_STEPS`] only every [`THINNING`]th is kept; errors far ahead overlap, and the others would say the same again.

use libm::{logf, sqrtf};

use crate::forecast::comparison::{Comparison, Issued, between, length};
use crate::forecast::ellipse::Moments;
use crate::forecast::horizon::Horizons;
use crate::forecast::motion::Motion;
use crate::forecast::past::MIN_TURN_SAMPLES;
use crate::history::Sample;
use crate::layout::{ByExpert, EXPERTS, HORIZONS, MARKS};
use crate::vector::{norm, sub};

/// Forecasts made this many steps ago or later are all kept, of older ones every [`THINNING`]th.
const RECENT_STEPS: f64 = 8.5;
const THINNING: u64 = 4;
/// Forecasts kept. As close together as they may be, eleven are recent and eight older, and there is the new one.
const KEPT: usize = 20;
/// Forecasts made closer together than this, in steps, are not kept, but for the first few of a track.
const LEAST_SPACING_STEPS: f64 = 0.75;
/// A sample is due for a horizon from half a frame before it, and until so much of its time after it or one step.
const MOST_DELAY: f64 = 0.25;
/// Memory of the running means at the first and the last horizon, in comparisons.
const MEMORY: [f32; 2] = [10.0, 33.0];
/// Memory of the last comparisons.
const RECENT_MEMORY: f32 = 2.5;
/// Usual errors from which on it is out of the ordinary how far a fit passes the newest place. With a finer measure, ordinary noise
/// speaks against long fits, which are the best for people.
const UNUSUAL: f32 = 3.0;
/// Comparisons that nothing known, or the mark of the horizon before, is worth: at the first horizon and after it.
const PRIOR: [f32; 2] = [0.3, 3.0];
/// Samples from which a forecast is compared for the first time, and further on: two tell whether a thing moves, but what is
/// made of them far ahead says nothing of an expert.
const MIN_SAMPLES: [usize; 2] = [2, 4];
/// Growth of the best expert's error from a horizon to the next as long as it is not known.
const GROWTH: f32 = 1.6;
/// Error below which experts are equally good, as a part of the way of a step, and of the widest gate.
const EQUAL: [f32; 2] = [3e-5, 1e-8];
/// Memory of the way of a step, in samples.
const WAY_MEMORY: f32 = 10.0;

/// A forecast that waits for comparison.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    issued: Issued,
    next_horizon: usize,
    /// Whether it was compared at all, and with the sample that came next.
    compared: bool,
    judged: bool,
    serial: u64,
}

/// Running sums of one horizon.
#[derive(Debug, Clone, Copy)]
struct Mark {
    n: f32,
    errors: [f32; EXPERTS],
}

/// The book of one track.
#[derive(Debug, Clone)]
pub(crate) struct Marks {
    waiting: [Waiting; KEPT],
    n_waiting: usize,
    n_issued: u64,
    marks: [Mark; HORIZONS],
    recent: [f32; EXPERTS],
    /// Of the mixture.
    pub(crate) moments: [Moments; HORIZONS],
    /// The best expert's usual error by horizon.
    best: [f32; HORIZONS],
    /// Mean way of a step and how many made it.
    way: f32,
    n_ways: f32,
    /// Longest way of a step.
    pub(crate) fastest: f32,
}

/// The marks as they stand.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Summary {
    pub(crate) marks: ByExpert<[f32; MARKS]>,
    /// Comparisons that count, by horizon.
    pub(crate) n: [f32; HORIZONS],
    /// The best expert's usual error by horizon, not below the least.
    pub(crate) best: [f32; HORIZONS],
    /// Logarithm of how wrong the best expert was the last few times, over its usual error one step ahead: all of them are wrong
    /// at once where an object begins to do something else.
    pub(crate) surprise: f32,
    /// Least error that means anything.
    pub(crate) least_error: f32,
}

impl Marks {
    pub(crate) const START: Self = Self {
        waiting: [Waiting::NONE; KEPT],
        n_waiting: 0,
        n_issued: 0,
        marks: [Mark::NONE; HORIZONS],
        recent: [0.0; EXPERTS],
        moments: [Moments::NONE; HORIZONS],
        best: [0.0; HORIZONS],
        way: 0.0,
        n_ways: 0.0,
        fastest: 0.0,
    };

    /// Forgets the forecasts that wait for comparison, not the marks.
    pub(crate) fn withdraw(&mut self) {
        self.n_waiting = 0;
    }

    /// Keeps a forecast for later comparison.
    pub(crate) fn issue(&mut self, issued: Issued, horizons: &Horizons) {
        let waiting = &self.waiting[..self.n_waiting];
        let early = issued.n_samples < MIN_SAMPLES[1];
        if !early
            && waiting.last().is_some_and(|last| {
                issued.newest.seconds_since(&last.issued.newest)
                    < LEAST_SPACING_STEPS * horizons.step_s
            })
        {
            return;
        }
        if self.n_waiting == KEPT {
            self.waiting.copy_within(1.., 0);
            self.n_waiting -= 1;
        }
        self.waiting[self.n_waiting] = Waiting {
            issued,
            next_horizon: 0,
            compared: false,
            judged: false,
            serial: self.n_issued,
        };
        self.n_waiting += 1;
        self.n_issued += 1;
    }

    /// Compares the kept forecasts with the newest sample, the one `before` it given too, and hands each comparison to
    /// `teach`.
    pub(crate) fn compare(
        &mut self,
        newest: &Sample,
        before: Option<&Sample>,
        horizons: &Horizons,
        mut teach: impl FnMut(&Comparison<'_>),
    ) {
        let step_s = horizons.step_s;
        self.judge_newest(newest, step_s);
        if let Some(before) = before {
            let steps = newest.seconds_since(before) / step_s;
            if steps > 0.0 {
                let way = (norm(sub(newest.position, before.position)) / steps) as f32;
                self.n_ways = (self.n_ways + 1.0).min(WAY_MEMORY);
                self.way += (way - self.way) / self.n_ways;
                self.fastest = self.fastest.max(way);
            }
        }
        for slot in 0..self.n_waiting {
            let age_s = newest.seconds_since(&self.waiting[slot].issued.newest);
            loop {
                let horizon = self.waiting[slot].next_horizon;
                if horizon == HORIZONS || age_s < horizons.times_s[horizon] - 0.5 * horizons.frame_s
                {
                    break;
                }
                self.waiting[slot].next_horizon += 1;
                let due_s = horizons.times_s[horizon];
                let Waiting {
                    issued, compared, ..
                } = &mut self.waiting[slot];
                if age_s > due_s + step_s.max(MOST_DELAY * due_s)
                    || issued.n_samples < MIN_SAMPLES[usize::from(*compared)]
                {
                    continue;
                }
                let first = !core::mem::replace(compared, true);
                let comparison = Comparison::of(issued, horizon, age_s, newest, self.best[horizon]);
                let errors = comparison.errors();
                if first && issued.n_samples == MIN_TURN_SAMPLES {
                    // Fewer samples tell no turn from a line, and those marks would hide what these have told.
                    self.marks[horizon] = Mark::NONE;
                }
                self.marks[horizon].add(horizon, &errors);
                self.moments[horizon].add(horizon, &comparison);
                teach(&comparison);
            }
        }
        self.thin_out(newest, step_s);
    }

    /// Compares the newest forecast kept with the sample that came next, however late that is: after a gap this is all there is
    /// that tells what happened meanwhile.
    fn judge_newest(&mut self, newest: &Sample, step_s: f64) {
        let Some(Waiting { issued, judged, .. }) = self.waiting[..self.n_waiting].last_mut() else {
            return;
        };
        if core::mem::replace(judged, true) || issued.n_samples < MIN_SAMPLES[0] {
            return;
        }
        if issued.n_samples == MIN_TURN_SAMPLES {
            self.recent = [0.0; EXPERTS];
        }
        let age_s = newest.seconds_since(&issued.newest);
        // An error grows with time, and must not outweigh the next ones for that.
        let steps = (age_s / step_s).max(1.0) as f32;
        let came = sub(newest.position, issued.newest.position).map(|c| c as f32);
        for (recent, motion) in self.recent.iter_mut().zip(&issued.motions) {
            let [x, y] = motion.at(age_s as f32);
            let error = length([x - came[0], y - came[1]]) / steps;
            *recent += (error * error - *recent) / RECENT_MEMORY;
        }
    }

    /// Drops forecasts that were compared at all horizons, and most old ones.
    fn thin_out(&mut self, newest: &Sample, step_s: f64) {
        let mut kept = 0;
        for slot in 0..self.n_waiting {
            let waiting = &self.waiting[slot];
            let old = newest.seconds_since(&waiting.issued.newest) > RECENT_STEPS * step_s;
            let thinned = old && !waiting.serial.is_multiple_of(THINNING);
            if waiting.next_horizon < HORIZONS && !thinned {
                if kept < slot {
                    self.waiting[kept] = self.waiting[slot];
                }
                kept += 1;
            }
        }
        self.n_waiting = kept;
    }

    /// The marks of these motions, for an object that moves at most `reach` from one frame to the next, in units.
    pub(crate) fn summary(&mut self, motions: &[Motion; EXPERTS], reach: f64) -> Summary {
        let floor = EQUAL[0] * self.way + EQUAL[1] * reach as f32;
        let mut summary = Summary {
            marks: [[[0.0; MARKS]; EXPERTS]; HORIZONS],
            n: [0.0; HORIZONS],
            best: [0.0; HORIZONS],
            surprise: 0.0,
            least_error: floor,
        };
        let mut running = [[0.0; MARKS]; EXPERTS];
        let least = least_of(&self.recent);
        for ([_, mark, _], recent) in running.iter_mut().zip(&self.recent) {
            *mark = logf((recent + floor * floor) / (least + floor * floor));
        }
        let mut best = 0.0;
        for (horizon, mark) in self.marks.iter().enumerate() {
            best *= GROWTH;
            if mark.n > 0.0 {
                let part = mark.n / (mark.n + PRIOR[usize::from(horizon > 0)]);
                let least = least_of(&mark.errors) / mark.n;
                for ([running, ..], errors) in running.iter_mut().zip(&mark.errors) {
                    let ratio = (errors / mark.n + floor) / (least + floor);
                    *running += part * (2.0 * logf(ratio) - *running);
                }
                best = if horizon == 0 {
                    least
                } else {
                    best + part * (least - best)
                };
            }
            summary.marks[horizon] = running;
            summary.n[horizon] = mark.n;
            summary.best[horizon] = best + floor;
        }
        if self.marks[0].n > 0.0 {
            let unusual = UNUSUAL * summary.best[0];
            let misfits = motions.map(|motion| {
                let [x, y] = motion.at(0.0).map(|c| c / unusual);
                logf(1.0 + x * x + y * y)
            });
            for row in &mut summary.marks {
                for ([.., mark], misfit) in row.iter_mut().zip(misfits) {
                    *mark = misfit;
                }
            }
        }
        summary.surprise = logf((sqrtf(least) + floor) / summary.best[0]);
        self.best = summary.best;
        summary
    }
}

impl Waiting {
    const NONE: Self = Self {
        issued: Issued::NONE,
        next_horizon: 0,
        compared: false,
        judged: false,
        serial: 0,
    };
}

impl Mark {
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

fn least_of(values: &[f32; EXPERTS]) -> f32 {
    values.iter().fold(f32::INFINITY, |a, b| a.min(*b))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: u64 = 100_000_000;

    /// A book after `n` samples at rest, in which expert e was always wrong by e units along x.
    fn book(n: u64) -> Marks {
        let horizons = Horizons::new(0.1);
        let mut marks = Marks::START;
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
            marks.compare(&newest, before.as_ref(), &horizons, |comparison| {
                assert_eq!(comparison.mixed, [2.0, 0.0]);
                assert_eq!(comparison.came, [0.0; 2]);
            });
            marks.summary(&motions, 1.0);
            let issued = Issued {
                newest,
                n_samples: 9,
                motions,
                shares,
                ellipses: [[1.0, 0.0, 1.0]; HORIZONS],
                ..Issued::NONE
            };
            marks.issue(issued, &horizons);
            before = Some(newest);
        }
        marks
    }

    #[test]
    fn the_best_has_no_mark_and_the_others_the_logarithm_of_their_ratio() {
        let summary = book(200).summary(&[Motion::NONE; EXPERTS], 1.0);
        for row in &summary.marks {
            assert_eq!(row[0], [0.0; MARKS]);
            let difference = row[6][0] - row[3][0];
            assert!((difference - 2.0 * 2.0_f32.ln()).abs() < 0.05, "{row:?}");
        }
    }

    #[test]
    fn far_horizons_are_compared_as_soon_as_they_can_be_and_speak_like_the_near_before() {
        let summary = book(4).summary(&[Motion::NONE; EXPERTS], 1.0);
        let compared = summary.n.iter().filter(|n| **n > 0.0).count();
        assert!((2..6).contains(&compared), "{:?}", summary.n);
        assert!(summary.marks[HORIZONS - 1][5][0] > 5.0);
    }

    /// How often every horizon is compared on something at rest.
    fn comparisons(
        step_ns: u64,
        n: u64,
        mut teach: impl FnMut(&Sample, &Comparison<'_>),
    ) -> [u32; HORIZONS] {
        let horizons = Horizons::new(step_ns as f64 / 1e9);
        let mut seen = [0; HORIZONS];
        let mut marks = Marks::START;
        for i in 0..n {
            let newest = Sample {
                time_ns: i * step_ns,
                position: [0.0; 2],
            };
            marks.compare(&newest, None, &horizons, |comparison| {
                seen[comparison.horizon] += 1;
                teach(&newest, comparison);
            });
            let issued = Issued {
                newest,
                n_samples: 9,
                ellipses: [[1.0, 0.0, 1.0]; HORIZONS],
                ..Issued::NONE
            };
            marks.issue(issued, &horizons);
        }
        seen
    }

    #[test]
    fn every_forecast_kept_long_enough_is_compared_at_every_horizon_once() {
        let times_s = Horizons::new(0.1).times_s;
        let seen = comparisons(STEP_NS, 100, |newest, comparison| {
            let due_s = times_s[comparison.horizon];
            let age_s = newest.seconds_since(&comparison.issued.newest);
            assert!((age_s - due_s).abs() < 0.051, "{age_s} for {due_s}");
        });
        assert_eq!(seen[0], 99);
        assert_eq!(
            seen[HORIZONS - 1],
            20,
            "every fourth, from 2 s on: {seen:?}"
        );
    }

    #[test]
    fn every_horizon_is_compared_at_every_rate() {
        for rate_hz in [
            3, 5, 8, 12, 15, 20, 24, 25, 30, 50, 60, 75, 90, 100, 120, 200,
        ] {
            let seen = comparisons(1_000_000_000 / rate_hz, 20 * rate_hz, |_, _| {});
            assert!(seen.iter().all(|n| *n > 10), "{rate_hz} Hz: {seen:?}");
        }
    }

    #[test]
    fn after_a_gap_nothing_is_compared_that_was_due_within_it() {
        let mut marks = book(3);
        let horizons = Horizons::new(0.1);
        let late = Sample {
            time_ns: 10_000_000_000,
            position: [0.0; 2],
        };
        marks.compare(&late, None, &horizons, |comparison| {
            panic!("compared at {}", comparison.horizon)
        });
        assert_eq!(marks.n_waiting, 0);
    }
}
