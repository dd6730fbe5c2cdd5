//! The table of generated motions: every predictor on every kind of motion, with noise, and
//! separately after gaps.

use crate::classical::Scale;
use crate::motions::{Kind, Path};
use crate::random::Random;
use crate::scores::{Board, Contestant, OVERCAM, PAPER, PREDICTORS, Sample, Scene};

/// Standard deviations of the noise in pixels.
pub const NOISES: [f64; 3] = [0.1, 0.3, 1.0];
/// Numbers of frames ahead.
pub const STEPS: [usize; 5] = [1, 5, 10, 15, 30];
/// Frames per second.
const RATE_HZ: f64 = 15.0;
const FRAMES: usize = 160;
/// Number of runs per kind, and the index of the first. None of them is used for training.
const RUNS: u64 = 12;
const FIRST_RUN: u64 = 5000;
/// Number of samples after a gap that are scored as after a gap.
const AFTER_GAP: usize = 3;

/// A row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Kind of motion.
    pub kind: Kind,
    /// Standard deviation of the noise.
    pub noise: f64,
    /// The baseline predictor that is best for this kind in hindsight, by the geometric mean of its
    /// errors.
    pub best: &'static str,
    /// Mean error relative to that predictor, for each of [`STEPS`].
    pub ratios: [f64; STEPS.len()],
    /// The same for forecasts from the first few samples after a gap of 1 to 10 frames.
    pub after_gaps: [f64; STEPS.len()],
    /// Share of measurements inside the 95 % ellipse, from the 16th sample on.
    pub coverage: [f64; STEPS.len()],
}

/// All rows of the table.
#[must_use]
pub fn rows() -> Vec<Row> {
    Kind::ALL.into_iter().flat_map(rows_of).collect()
}

/// Geometric mean.
pub fn geometric_mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), value| (sum + value.ln(), n + 1.0));
    (sum / n).exp()
}

fn rows_of(kind: Kind) -> Vec<Row> {
    // The paper's network takes longer than all others together.
    let which: Vec<usize> = (0..PREDICTORS.len()).filter(|p| *p != PAPER).collect();
    let scored: Vec<(f64, Board, Board)> = NOISES
        .into_iter()
        .map(|noise| {
            let (mut steady, mut gaps) = (Board::new(&STEPS), Board::new(&STEPS));
            for run in FIRST_RUN..FIRST_RUN + RUNS {
                let path = kind.path(run, FRAMES, 1.0 / RATE_HZ);
                let scene = scene(noise);
                let (samples, truth) = observed(&path, noise, run);
                steady.add(&samples, &truth, &scene, &which);
                after_gaps(&path, &samples, &scene, &which, &mut gaps);
            }
            (noise, steady, gaps)
        })
        .collect();
    let best_by = |board: fn(&(f64, Board, Board)) -> &Board| {
        let total = |predictor: &usize| {
            let tallies = scored.iter().flat_map(|of| &board(of).tallies[*predictor]);
            geometric_mean(tallies.map(|tally| tally.mean()))
        };
        let classical = which.iter().filter(|p| **p != OVERCAM);
        *classical
            .min_by(|a, b| total(a).total_cmp(&total(b)))
            .unwrap_or(&0)
    };
    let (best, best_after) = (best_by(|of| &of.1), best_by(|of| &of.2));
    let ratios = |board: &Board, best: usize| {
        std::array::from_fn(|i| board.tallies[OVERCAM][i].mean() / board.tallies[best][i].mean())
    };
    scored
        .iter()
        .map(|(noise, steady, gaps)| Row {
            kind,
            noise: *noise,
            best: PREDICTORS[best],
            ratios: ratios(steady, best),
            after_gaps: ratios(gaps, best_after),
            coverage: std::array::from_fn(|i| {
                steady.tallies[OVERCAM][i].coverage().unwrap_or(f64::NAN)
            }),
        })
        .collect()
}

fn scene(noise: f64) -> Scene {
    Scene {
        scale: Scale {
            step_s: 1.0 / RATE_HZ,
            step_length: 5.0,
            sigma: noise,
        },
        low: [0.0; 2],
        high: [640.0, 480.0],
    }
}

/// A path as measured by a camera, and the truth.
fn observed(path: &Path, noise: f64, seed: u64) -> (Vec<Sample>, Vec<[f64; 2]>) {
    let mut random = Random::new(seed + 77);
    (0..FRAMES)
        .filter_map(|frame| {
            let time_s = frame as f64 / RATE_HZ;
            let truth = path.at(time_s)?;
            let sample = Sample {
                time_s,
                position: truth.map(|c| c + noise * random.normal()),
                heading_rad: None,
            };
            Some((sample, truth))
        })
        .unzip()
}

/// Scores the forecasts made just after gaps.
fn after_gaps(path: &Path, samples: &[Sample], scene: &Scene, which: &[usize], board: &mut Board) {
    // Gaps of 1 to 10 frames, each after 20 visible frames.
    let mut kept = Vec::new();
    let (mut frame, mut gap) = (20, 1);
    kept.extend(samples.iter().take(frame).map(|sample| (*sample, false)));
    while frame + gap < samples.len() {
        frame += gap;
        gap = gap % 10 + 1;
        let view = samples.iter().skip(frame).take(20).enumerate();
        kept.extend(view.map(|(i, sample)| (*sample, i < AFTER_GAP)));
        frame += 20;
    }
    let all: Vec<Sample> = kept.iter().map(|(sample, _)| *sample).collect();
    for predictor in which {
        let mut contestant = Contestant::new(*predictor, scene, &all);
        for (sample, after) in &kept {
            contestant.observe(sample);
            if !after {
                continue;
            }
            for (tally, steps) in board.tallies[*predictor].iter_mut().zip(STEPS) {
                let ahead_s = steps as f64 / RATE_HZ;
                if let Some(truth) = path.at(sample.time_s + ahead_s) {
                    let (position, _) = contestant.at(ahead_s);
                    tally
                        .errors
                        .push((position[0] - truth[0]).hypot(position[1] - truth[1]));
                }
            }
        }
    }
}
