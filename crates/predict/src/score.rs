//! How well each model has forecast a track: earlier forecasts are kept, compared with what came, and turned into
//! shares of the next forecast and into its covariance.
//!
//! # Shares
//!
//! Each model has, for every number of steps ahead, a running mean of its error. The line is the reference; another
//! model's share is that of its error ratio to the power -[`SHARPNESS`]: a model as good as the line gets somewhat
//! less than the line, one a fifth worse hardly a tenth of it, one half as wrong nearly all. Three things keep a
//! share honest:
//!
//! * Far horizons are scored late and their errors overlap, so a ratio is drawn towards that of the step before it,
//!   and the first step's towards a handicap: a newcomer must prove itself, and what it proves at one step speaks
//!   for the next, less and less with every further one.
//! * To be chosen by a small lead means to be chosen by luck half of the time, so every model but the line carries
//!   a [`MARGIN`].
//! * A mean remembers seconds, a bounce or a start happens in one frame, and the line is the first to recover
//!   because it forgets in five samples. A model that lately misses by more than the line does loses its share at
//!   once, whatever its mean.
//!
//! # Covariance
//!
//! The running mean of the squared errors of the mixture itself, in axes along and across the motion, drawn towards
//! that of the step before grown by the passing time; before any error is known, an estimate that the caller gives.
//! It covers what the camera will measure, observation noise included. A rare event, like the one stop in a long
//! run, weighs no more in it than it occurred: motion that changes abruptly leaves the ellipse more often than its
//! 5 %.

use libm::{exp, log, sqrt};

use crate::MAX_FORECAST;
use crate::covariance::{Covariance, rotated, trace};
use crate::history::Sample;
use crate::motion::{add, complex_mul, conjugate, norm_squared, scale, sub};

/// Forecasts that are mixed: line, turn, learned.
pub(crate) const MODELS: usize = 3;
/// The mixture is scored beside them.
const MIXTURE: usize = MODELS;
/// Forecasts kept: one for each step, and one to spare for frames that come early.
const KEPT: usize = MAX_FORECAST + 1;
/// Forecasts made closer together than this, in steps, are not kept, so that the kept ones reach [`MAX_FORECAST`]
/// steps back.
const LEAST_SPACING_STEPS: f64 = 0.75;
/// Memory of the running means, in samples.
const MEMORY: f64 = 100.0;
/// Memory of the latest errors, in samples.
const RECENT_MEMORY: f64 = 2.0;
/// Power of the error ratio in a model's share.
const SHARPNESS: f64 = 8.0;
/// Added to the logarithm of every model's ratio.
const MARGIN: f64 = 0.1;
/// Logarithm of the error ratio that an unproved model is taken to have.
const HANDICAP: f64 = 0.25;
/// Part of the way from its ratio back to the handicap that a model loses from each step to the next: what was
/// proved at one step says little about the tenth after it.
const FADING: f64 = 0.07;
/// Samples that the handicap, or the ratio of the step before, is worth: the first step's and the growth with each
/// further one.
const PRIOR_SAMPLES: [f64; 2] = [3.0, 0.5];
/// Largest logarithm of a ratio that one step's means may claim.
const MAX_LOG_RATIO: f64 = 6.0;
/// Samples that the covariance expected beforehand is worth.
const COVARIANCE_PRIOR_SAMPLES: f64 = 4.0;

/// Places forecast by every model, step by step.
pub(crate) type Paths = [[[f64; 2]; MODELS]; MAX_FORECAST];

/// One forecast as it was made.
#[derive(Debug, Clone, Copy)]
struct Issued {
    time_ns: u64,
    origin: [f64; 2],
    direction: [f64; 2],
    /// Relative to `origin`; single precision halves what a track weighs.
    steps: [[[f32; 2]; MODELS + 1]; MAX_FORECAST],
}

/// Running means for one number of steps ahead.
#[derive(Debug, Clone, Copy)]
struct Marks {
    n: f64,
    /// Mean distance between forecast and measurement, in units.
    mean_error: [f64; MODELS],
    /// Second moment of the mixture's error along and across the motion.
    covariance: Covariance,
}

/// The score book of one track.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scores {
    issued: [Issued; KEPT],
    n_issued: usize,
    marks: [Marks; MAX_FORECAST],
    /// Running mean of the latest errors one step ahead, in units.
    recent_error: [f64; MODELS],
}

impl Scores {
    pub(crate) const START: Self = Self {
        issued: [Issued {
            time_ns: 0,
            origin: [0.0; 2],
            direction: [1.0, 0.0],
            steps: [[[0.0; 2]; MODELS + 1]; MAX_FORECAST],
        }; KEPT],
        n_issued: 0,
        marks: [Marks {
            n: 0.0,
            mean_error: [0.0; MODELS],
            covariance: [[0.0; 2]; 2],
        }; MAX_FORECAST],
        recent_error: [0.0; MODELS],
    };

    /// Forgets the forecasts that wait for comparison, not the marks.
    pub(crate) fn withdraw(&mut self) {
        self.n_issued = 0;
    }

    /// Keeps a forecast made at `newest` for later comparison.
    pub(crate) fn issue(
        &mut self,
        newest: &Sample,
        direction: [f64; 2],
        paths: &Paths,
        mixture: &[[f64; 2]; MAX_FORECAST],
        step_s: f64,
    ) {
        if let Some(last) = self.issued[..self.n_issued].last()
            && seconds_between(last.time_ns, newest.time_ns) < LEAST_SPACING_STEPS * step_s
        {
            return;
        }
        if self.n_issued == KEPT {
            self.issued.copy_within(1.., 0);
            self.n_issued -= 1;
        }
        let issued = &mut self.issued[self.n_issued];
        self.n_issued += 1;
        issued.time_ns = newest.time_ns;
        issued.origin = newest.position;
        issued.direction = direction;
        for (step, (places, mixed)) in issued.steps.iter_mut().zip(paths.iter().zip(mixture)) {
            let relative = |place: &[f64; 2]| sub(*place, newest.position).map(|c| c as f32);
            for (kept, place) in step.iter_mut().zip(places) {
                *kept = relative(place);
            }
            step[MIXTURE] = relative(mixed);
        }
    }

    /// Compares the kept forecasts with what came.
    pub(crate) fn compare(&mut self, sample: &Sample, step_s: f64) {
        for issued in &self.issued[..self.n_issued] {
            let age_steps = seconds_between(issued.time_ns, sample.time_ns) / step_s;
            // The nearest step gets the mark; a forecast between two steps is interpolated.
            let nearest = (age_steps + 0.5) as usize;
            if nearest == 0 || nearest > MAX_FORECAST {
                continue;
            }
            let came = sub(sample.position, issued.origin);
            let error = |model: usize| sub(came, issued.at(age_steps, model));
            let errors = [0, 1, 2].map(|model| sqrt(norm_squared(error(model))));
            if nearest == 1 {
                for (recent, error) in self.recent_error.iter_mut().zip(errors) {
                    *recent += (error - *recent) / RECENT_MEMORY;
                }
            }
            self.marks[nearest - 1].add(
                errors,
                complex_mul(error(MIXTURE), conjugate(issued.direction)),
            );
        }
    }

    /// Share of every model in the forecast of each step; the shares of a step add to 1. `least_error` is the error
    /// a step below which models are equally good.
    pub(crate) fn shares(&self, least_error: f64) -> [[f64; MODELS]; MAX_FORECAST] {
        let mut shares = [[1.0, 0.0, 0.0]; MAX_FORECAST];
        let mut log_ratio = [0.0, HANDICAP, HANDICAP];
        // Relative to the usual error, so that only misses that stand out of it count.
        let usual_error = self.marks[0].mean_error[0] + least_error;
        let surprise = self.recent_error.map(|recent| {
            log((recent + usual_error) / (self.recent_error[0] + usual_error)).max(0.0)
        });
        for (i, (shares, marks)) in shares.iter_mut().zip(&self.marks).enumerate() {
            let prior = PRIOR_SAMPLES[0] + PRIOR_SAMPLES[1] * i as f64;
            let mut sum = 1.0;
            for model in 1..MODELS {
                log_ratio[model] += FADING * (HANDICAP - log_ratio[model]);
                if marks.n > 0.0 {
                    let ratio = (marks.mean_error[model] + least_error)
                        / (marks.mean_error[0] + least_error);
                    let measured = log(ratio).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO);
                    log_ratio[model] =
                        (marks.n * measured + prior * log_ratio[model]) / (marks.n + prior);
                }
                shares[model] = exp(-SHARPNESS * (log_ratio[model] + MARGIN + surprise[model]));
                sum += shares[model];
            }
            *shares = shares.map(|share| share / sum);
        }
        shares
    }

    /// Covariance of each step's error, for an object that moves along `direction`. `before_errors` gives the one
    /// expected as long as no error is known, for index 0, the first step, and on.
    pub(crate) fn covariances(
        &self,
        direction: [f64; 2],
        before_errors: impl Fn(usize) -> Covariance,
    ) -> [Covariance; MAX_FORECAST] {
        let mut covariances = [[[0.0; 2]; 2]; MAX_FORECAST];
        let mut learned: Option<Covariance> = None;
        for (i, (covariance, marks)) in covariances.iter_mut().zip(&self.marks).enumerate() {
            let mut expected = before_errors(i);
            if let Some(before) = learned {
                // An error of the velocity grows with time.
                let growth = (i as f64 + 1.0) / i as f64;
                let grown = before.map(|row| scale(row, growth * growth));
                if trace(&grown) > trace(&expected) {
                    expected = grown;
                }
            }
            let n = marks.n;
            if n > 0.0 {
                let measured = rotated(&marks.covariance, direction);
                let total = n + COVARIANCE_PRIOR_SAMPLES;
                for (row, measured) in expected.iter_mut().zip(measured) {
                    *row = add(
                        scale(*row, COVARIANCE_PRIOR_SAMPLES / total),
                        scale(measured, n / total),
                    );
                }
            }
            if n > 0.0 || learned.is_some() {
                learned = Some(expected);
            }
            *covariance = expected;
        }
        covariances
    }
}

impl Issued {
    /// Place relative to the origin `steps` after the forecast was made, at most half a step past the last.
    fn at(&self, steps: f64, model: usize) -> [f64; 2] {
        let upper = (steps as usize).min(MAX_FORECAST - 1);
        let to = self.steps[upper][model].map(f64::from);
        let from = match upper {
            0 => [0.0; 2],
            _ => self.steps[upper - 1][model].map(f64::from),
        };
        add(from, scale(sub(to, from), steps - upper as f64))
    }
}

impl Marks {
    fn add(&mut self, errors: [f64; MODELS], mixture: [f64; 2]) {
        self.n = (self.n + 1.0).min(MEMORY);
        for (mean, error) in self.mean_error.iter_mut().zip(errors) {
            *mean += (error - *mean) / self.n;
        }
        for (row, along) in self.covariance.iter_mut().zip(mixture) {
            for (mean, across) in row.iter_mut().zip(mixture) {
                *mean += (along * across - *mean) / self.n;
            }
        }
    }
}

fn seconds_between(earlier_ns: u64, later_ns: u64) -> f64 {
    later_ns.saturating_sub(earlier_ns) as f64 / crate::NS_PER_S
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f64 = 0.1;

    fn sample(step: u64, x: f64) -> Sample {
        Sample {
            time_ns: step * 100_000_000,
            position: [x, 0.0],
        }
    }

    /// A score book after `n` forecasts in which the models missed by so much at every step, along the motion.
    fn scored(n: u64, errors: [f64; MODELS]) -> Scores {
        let mut scores = Scores::START;
        for step in 0..n {
            let sample = sample(step, 100.0);
            scores.compare(&sample, STEP_S);
            let places = errors.map(|error| [100.0 + error, 0.0]);
            let mixture = [places[0]; MAX_FORECAST];
            scores.issue(
                &sample,
                [1.0, 0.0],
                &[places; MAX_FORECAST],
                &mixture,
                STEP_S,
            );
        }
        scores
    }

    #[test]
    fn the_line_leads_until_another_has_proved_itself() {
        let nothing_known = Scores::START.shares(1e-6);
        assert!(nothing_known.iter().all(|shares| shares[0] > 0.75));
        let shares = scored(60, [2.0, 1.0, 3.0]).shares(1e-6);
        for (step, shares) in shares.iter().enumerate() {
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(shares[1] > 0.9, "step {step}: {shares:?}");
        }
    }

    #[test]
    fn what_is_proved_at_one_step_speaks_for_the_next() {
        // After four samples only the first three steps were ever compared.
        let shares = scored(4, [2.0, 0.0, 9.0]).shares(1e-6);
        assert!(shares[MAX_FORECAST - 1][1] > 0.99, "{shares:?}");
    }

    #[test]
    fn covariance_is_that_of_the_errors() {
        let scores = scored(400, [2.0, 5.0, 5.0]);
        let none = |_: usize| [[0.0; 2]; 2];
        for covariance in scores.covariances([0.0, 1.0], none) {
            // Errors of 2 along the motion, which is y; the growth expected from step to step adds a little.
            assert!((3.8..4.5).contains(&covariance[1][1]), "{covariance:?}");
            assert!(covariance[0][0].abs() < 1e-12 && covariance[0][1].abs() < 1e-12);
        }
    }

    #[test]
    fn forecasts_are_interpolated_between_steps() {
        let mut scores = Scores::START;
        let start = sample(0, 0.0);
        let mut paths = [[[0.0; 2]; MODELS]; MAX_FORECAST];
        for (i, places) in paths.iter_mut().enumerate() {
            *places = [[10.0 * (i as f64 + 1.0), 0.0]; MODELS];
        }
        let mixture = paths.map(|places| places[0]);
        scores.issue(&start, [1.0, 0.0], &paths, &mixture, STEP_S);
        let between = Sample {
            time_ns: 240_000_000,
            position: [24.0, 0.0],
        };
        scores.compare(&between, STEP_S);
        assert_eq!(scores.marks[1].n, 1.0);
        assert!(scores.marks[1].mean_error[0] < 1e-5);
    }
}
