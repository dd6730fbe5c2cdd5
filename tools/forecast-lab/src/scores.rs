//! Errors of forecasts by predictor and by time ahead.

use predict::{Heading, Observation, Settings, Track, Tracker};

use crate::classical::{Filters, PaperNetwork, Polynomial, Predictor, Scale};

/// One place of one object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Seconds, from any moment.
    pub time_s: f64,
    /// In any unit.
    pub place: [f64; 2],
    /// Direction of its marker, where there is one, in radians.
    pub heading_rad: Option<f64>,
}

/// The predictors of the scoreboard, ours last.
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
/// Index of the predictor that this project is about.
pub const OVERCAM: usize = PREDICTORS.len() - 1;
/// Index of the least-squares line through five places.
pub const LINE5: usize = 2;
/// Index of the paper's own network, by far the slowest.
pub const PAPER: usize = 6;
/// First sample, from 0, at which forecasts are scored.
const FIRST_SCORED: usize = 7;
/// First sample from which the ellipse is expected to hold.
const FIRST_COVERED: usize = 15;

/// Errors of one predictor at one time ahead.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// Distances between forecast and truth.
    pub errors: Vec<f64>,
    /// Forecasts with an ellipse, and those of them in whose 95 % ellipse the measured place was.
    pub with_ellipse: usize,
    /// See `with_ellipse`.
    pub inside: usize,
}

impl Tally {
    /// Mean error; no number without forecasts.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.errors.iter().sum::<f64>() / self.errors.len() as f64
    }

    /// Median error.
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

    /// Part of what came that lay in the 95 % ellipse, where there was one.
    #[must_use]
    pub fn coverage(&self) -> Option<f64> {
        (self.with_ellipse > 0).then(|| self.inside as f64 / self.with_ellipse as f64)
    }
}

/// What every predictor missed by.
#[derive(Debug, Clone)]
pub struct Board {
    /// Numbers of samples ahead.
    pub steps: Vec<usize>,
    /// By predictor and number of samples ahead.
    pub tallies: Vec<Vec<Tally>>,
}

/// What is known of a scene beforehand.
#[derive(Debug, Clone, Copy)]
pub struct Scene {
    /// Sizes of steps and noise.
    pub scale: Scale,
    /// Lowest and highest coordinates.
    pub low: [f64; 2],
    /// See `low`.
    pub high: [f64; 2],
}

impl Board {
    /// Nothing scored yet, for so many samples ahead.
    #[must_use]
    pub fn new(steps: &[usize]) -> Self {
        Self {
            steps: steps.to_vec(),
            tallies: vec![vec![Tally::default(); steps.len()]; PREDICTORS.len()],
        }
    }

    /// Scores predictors, by their indices, on one object's track. `truth` is where it really was, or the samples again where nobody knows better.
    pub fn add(&mut self, samples: &[Sample], truth: &[[f64; 2]], scene: &Scene, which: &[usize]) {
        for predictor in which {
            let mut made = Contestant::new(*predictor, scene, samples);
            for (i, sample) in samples.iter().enumerate() {
                made.take(sample);
                if i < FIRST_SCORED {
                    continue;
                }
                for (tally, steps) in self.tallies[*predictor].iter_mut().zip(&self.steps) {
                    let Some(then) = samples.get(i + steps) else {
                        continue;
                    };
                    let (place, covariance) = made.at(then.time_s - sample.time_s);
                    let truth = truth[i + steps];
                    tally
                        .errors
                        .push((place[0] - truth[0]).hypot(place[1] - truth[1]));
                    if let Some([[a, b], [_, d]]) = covariance
                        && i >= FIRST_COVERED
                    {
                        let [x, y] = [0, 1].map(|axis| then.place[axis] - place[axis]);
                        let distance = (d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b);
                        tally.with_ellipse += 1;
                        // 95 % quantile of chi-squared with two degrees of freedom.
                        tally.inside += usize::from(distance <= 5.991);
                    }
                }
            }
        }
    }
}

/// One of the predictors, following one object.
pub enum Contestant {
    /// Any but ours.
    Classical(Box<dyn Predictor>),
    /// Ours.
    Overcam(Box<Overcam>),
}

impl Contestant {
    /// A predictor by its index in [`PREDICTORS`], for an object that will be seen at `samples`.
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
            _ => panic!("there is no predictor {predictor}"),
        })
    }

    /// Takes the next sample.
    pub fn take(&mut self, sample: &Sample) {
        match self {
            Self::Classical(predictor) => predictor.see(sample.time_s, sample.place),
            Self::Overcam(overcam) => overcam.see(sample),
        }
    }

    /// Place `ahead_s` after the newest sample, and the covariance of what will be measured from those that give one.
    #[must_use]
    pub fn at(&self, ahead_s: f64) -> ([f64; 2], Option<[[f64; 2]; 2]>) {
        match self {
            Self::Classical(predictor) => predictor.at(ahead_s),
            Self::Overcam(overcam) => overcam.at(ahead_s),
        }
    }
}

/// The tracker, shown one object.
pub struct Overcam {
    tracker: Tracker<Vec<Track>>,
    settings: Settings,
    start_s: f64,
}

impl Overcam {
    /// For one object that is seen as in `samples`: the gate is made wide enough that none of them is taken for another
    /// object, since not identities but forecasts are judged here.
    #[must_use]
    pub fn new(step_s: f64, samples: &[Sample]) -> Self {
        let mut fastest = 0.0_f64;
        for pair in samples.windows(2) {
            let [x, y] = [0, 1].map(|axis| pair[1].place[axis] - pair[0].place[axis]);
            fastest = fastest.max(x.hypot(y) / (pair[1].time_s - pair[0].time_s));
        }
        Self {
            tracker: Tracker::new(vec![Track::EMPTY; 1]),
            settings: Settings {
                frame_period_s: step_s,
                top_speed: 3.0 * fastest,
                gate_base: 3.0 * fastest * step_s,
                max_misses: 100,
                ..Settings::default()
            },
            start_s: samples.first().map_or(0.0, |sample| sample.time_s),
        }
    }

    /// Takes a sample.
    ///
    /// # Panics
    ///
    /// If the tracker takes it for another object.
    pub fn see(&mut self, sample: &Sample) {
        let observation = Observation {
            x: sample.place[0],
            y: sample.place[1],
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

    /// Place and covariance `ahead_s` after the newest sample.
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
    /// Of all tracks of a file together: median time and way of a step, noise from third differences (what is left of a
    /// smooth motion in them is little), extent.
    #[must_use]
    pub fn of(tracks: &[Vec<Sample>]) -> Self {
        let (mut steps, mut ways, mut thirds) = (Vec::new(), Vec::new(), Vec::new());
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for track in tracks {
            for pair in track.windows(2) {
                steps.push(pair[1].time_s - pair[0].time_s);
                let [x, y] = [0, 1].map(|axis| pair[1].place[axis] - pair[0].place[axis]);
                ways.push(x.hypot(y));
            }
            for four in track.windows(4) {
                for axis in 0..2 {
                    let at = |i: usize| four[i].place[axis];
                    thirds.push((at(3) - 3.0 * at(2) + 3.0 * at(1) - at(0)).abs());
                }
            }
            for sample in track {
                for axis in 0..2 {
                    low[axis] = low[axis].min(sample.place[axis]);
                    high[axis] = high[axis].max(sample.place[axis]);
                }
            }
        }
        let median = |values: &mut Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0)
        };
        Self {
            scale: Scale {
                step_s: median(&mut steps).max(1e-6),
                way: median(&mut ways),
                // Normal noise: median of the size .6745 deviations, third differences sqrt(20) of one sample.
                sigma: median(&mut thirds) / 0.6745 / 20.0_f64.sqrt(),
            },
            low,
            high,
        }
    }
}
