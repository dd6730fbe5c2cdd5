//! Forecast errors by predictor and time ahead.

use predict::{Heading, Observation, Settings, Track, Tracker};

use crate::classical::{Filters, Polynomial, Predictor, Scale};
use crate::paper::PaperNetwork;

/// A measured position of an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Seconds since any epoch.
    pub time_s: f64,
    /// In any unit.
    pub position: [f64; 2],
    /// Heading of its marker in radians, if it has one.
    pub heading_rad: Option<f64>,
}

/// The predictors. The last one is this project's.
pub const PREDICTORS: [&str; 8] = [
    "hold",
    "cv",
    "line5",
    "parabola8",
    "kalman_cv",
    "imm",
    "paper",
    "overcam",
];
/// Index of this project's predictor.
pub const OVERCAM: usize = PREDICTORS.len() - 1;
/// Index of the least-squares line through five positions.
pub const LINE5: usize = 2;
/// Index of the paper's network, by far the slowest.
pub const PAPER: usize = 6;
/// First sample, from 0, at which forecasts are scored.
const FIRST_SCORED: usize = 7;
/// First sample at which ellipses are scored.
const FIRST_COVERED: usize = 15;

/// Errors of one predictor at one time ahead.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// Distances between forecast and truth.
    pub errors: Vec<f64>,
    /// Number of forecasts with an ellipse, and number of measurements inside the 95 % ellipse.
    pub with_ellipse: usize,
    /// See `with_ellipse`.
    pub inside: usize,
}

impl Tally {
    /// Mean error. NaN without forecasts.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.errors.iter().sum::<f64>() / self.errors.len() as f64
    }

    /// Median error. NaN without forecasts.
    #[must_use]
    pub fn median(&self) -> f64 {
        let mut sorted = self.errors.clone();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        if n == 0 {
            return f64::NAN;
        }
        0.5 * (sorted[(n - 1) / 2] + sorted[n / 2])
    }

    /// Share of measurements inside the 95 % ellipse, if there was one.
    #[must_use]
    pub fn coverage(&self) -> Option<f64> {
        (self.with_ellipse > 0).then(|| self.inside as f64 / self.with_ellipse as f64)
    }
}

/// The errors of all predictors.
#[derive(Debug, Clone)]
pub struct Board {
    /// Numbers of samples ahead.
    pub steps: Vec<usize>,
    /// By predictor and number of samples ahead.
    pub tallies: Vec<Vec<Tally>>,
}

/// Prior knowledge of a scene.
#[derive(Debug, Clone, Copy)]
pub struct Scene {
    /// Scale of steps and noise.
    pub scale: Scale,
    /// Minimum and maximum coordinates.
    pub low: [f64; 2],
    /// See `low`.
    pub high: [f64; 2],
}

impl Board {
    /// An empty board for these numbers of samples ahead.
    #[must_use]
    pub fn new(steps: &[usize]) -> Self {
        Self {
            steps: steps.to_vec(),
            tallies: vec![vec![Tally::default(); steps.len()]; PREDICTORS.len()],
        }
    }

    /// Scores predictors, given by index, on the track of one object. `truth` holds the true
    /// positions, or the samples if the truth is unknown.
    pub fn add(&mut self, samples: &[Sample], truth: &[[f64; 2]], scene: &Scene, which: &[usize]) {
        for predictor in which {
            let mut contestant = Contestant::new(*predictor, scene, samples);
            for (i, sample) in samples.iter().enumerate() {
                contestant.observe(sample);
                if i < FIRST_SCORED {
                    continue;
                }
                for (tally, steps) in self.tallies[*predictor].iter_mut().zip(&self.steps) {
                    let Some(then) = samples.get(i + steps) else {
                        continue;
                    };
                    let (position, covariance) = contestant.at(then.time_s - sample.time_s);
                    let truth = truth[i + steps];
                    tally
                        .errors
                        .push((position[0] - truth[0]).hypot(position[1] - truth[1]));
                    if let Some([[a, b], [_, d]]) = covariance
                        && i >= FIRST_COVERED
                    {
                        let [x, y] = [0, 1].map(|axis| then.position[axis] - position[axis]);
                        let distance = (d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b);
                        tally.with_ellipse += 1;
                        // 95 % quantile of the chi-squared distribution with two degrees of
                        // freedom.
                        tally.inside += usize::from(distance <= 5.991);
                    }
                }
            }
        }
    }
}

/// A predictor that follows one object.
pub enum Contestant {
    /// A baseline.
    Classical(Box<dyn Predictor>),
    /// This project's predictor.
    Overcam(Box<Overcam>),
}

impl Contestant {
    /// A predictor by its index in [`PREDICTORS`], for an object that will be measured at
    /// `samples`.
    ///
    /// # Panics
    ///
    /// If there is no such predictor.
    #[must_use]
    pub fn new(predictor: usize, scene: &Scene, samples: &[Sample]) -> Self {
        let scale = scene.scale;
        if predictor == OVERCAM {
            return Self::Overcam(Box::new(Overcam::new(scale.step_s, samples)));
        }
        Self::Classical(match predictor {
            0 => Box::new(Polynomial::hold()),
            1 => Box::new(Polynomial::cv()),
            LINE5 => Box::new(Polynomial::line5()),
            3 => Box::new(Polynomial::parabola8()),
            4 => Box::new(Filters::kalman_cv(scale)),
            5 => Box::new(Filters::imm(scale)),
            PAPER => Box::new(PaperNetwork::new(scale.step_s, scene.low, scene.high)),
            _ => panic!("no predictor has the index {predictor}"),
        })
    }

    /// Adds the next sample.
    pub fn observe(&mut self, sample: &Sample) {
        match self {
            Self::Classical(predictor) => predictor.observe(sample.time_s, sample.position),
            Self::Overcam(overcam) => overcam.observe(sample),
        }
    }

    /// Position `ahead_s` after the newest sample, and the covariance of a measurement there if the
    /// predictor has one.
    #[must_use]
    pub fn at(&self, ahead_s: f64) -> ([f64; 2], Option<[[f64; 2]; 2]>) {
        match self {
            Self::Classical(predictor) => predictor.at(ahead_s),
            Self::Overcam(overcam) => overcam.at(ahead_s),
        }
    }
}

/// The tracker with a single object.
pub struct Overcam {
    tracker: Tracker<Vec<Track>>,
    settings: Settings,
    start_s: f64,
}

impl Overcam {
    /// A tracker for one object with these `samples`. The gate is wide enough that all of them
    /// belong to the same track: this evaluates forecasts, not association.
    #[must_use]
    pub fn new(step_s: f64, samples: &[Sample]) -> Self {
        let mut max_speed = 0.0_f64;
        for pair in samples.windows(2) {
            let [x, y] = [0, 1].map(|axis| pair[1].position[axis] - pair[0].position[axis]);
            max_speed = max_speed.max(x.hypot(y) / (pair[1].time_s - pair[0].time_s));
        }
        Self {
            tracker: Tracker::new(vec![Track::EMPTY; 1]),
            settings: Settings {
                frame_period_s: step_s,
                top_speed: 3.0 * max_speed,
                gate_base: 3.0 * max_speed * step_s,
                max_misses: 100,
                ..Settings::default()
            },
            start_s: samples.first().map_or(0.0, |sample| sample.time_s),
        }
    }

    /// Adds a sample.
    ///
    /// # Panics
    ///
    /// If the tracker assigns it to another track.
    pub fn observe(&mut self, sample: &Sample) {
        let observation = Observation {
            x: sample.position[0],
            y: sample.position[1],
            covariance: [[0.0; 2]; 2],
            heading: sample.heading_rad.map(|rad| Heading {
                rad,
                variance: 1e-6,
            }),
            marker: sample.heading_rad.map(|_| 0),
            reach: 0.0,
            area: 0.0,
        };
        let stamp_ns = ((sample.time_s - self.start_s) * 1e9).round() as u64;
        self.tracker
            .update(stamp_ns, &[observation], &self.settings);
        let id = self.tracker.tracks().next().map(Track::id);
        assert_eq!(id, Some(1), "the track was lost");
    }

    /// Position and covariance `ahead_s` after the newest sample.
    #[must_use]
    pub fn at(&self, ahead_s: f64) -> ([f64; 2], Option<[[f64; 2]; 2]>) {
        self.tracker
            .tracks()
            .next()
            .map_or(([f64::NAN; 2], None), |track| {
                let point = track.forecast_at(ahead_s);
                ([point.x, point.y], Some(point.covariance))
            })
    }
}

impl Scene {
    /// Scene of all tracks of a file: median period and step length, noise from third differences,
    /// to which smooth motion contributes little, and extent.
    #[must_use]
    pub fn of(tracks: &[Vec<Sample>]) -> Self {
        let (mut periods, mut step_lengths, mut thirds) = (Vec::new(), Vec::new(), Vec::new());
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for track in tracks {
            for pair in track.windows(2) {
                periods.push(pair[1].time_s - pair[0].time_s);
                let [x, y] = [0, 1].map(|axis| pair[1].position[axis] - pair[0].position[axis]);
                step_lengths.push(x.hypot(y));
            }
            for four in track.windows(4) {
                for axis in 0..2 {
                    let at = |i: usize| four[i].position[axis];
                    thirds.push((at(3) - 3.0 * at(2) + 3.0 * at(1) - at(0)).abs());
                }
            }
            for sample in track {
                for axis in 0..2 {
                    low[axis] = low[axis].min(sample.position[axis]);
                    high[axis] = high[axis].max(sample.position[axis]);
                }
            }
        }
        let median = |values: &mut Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        };
        Self {
            scale: Scale {
                step_s: median(&mut periods).max(1e-6),
                step_length: median(&mut step_lengths),
                // For normal noise, the median magnitude is 0.6745 standard deviations, and third
                // differences have sqrt(20) times the standard deviation of a sample.
                sigma: median(&mut thirds) / 0.6745 / 20.0_f64.sqrt(),
            },
            low,
            high,
        }
    }
}
