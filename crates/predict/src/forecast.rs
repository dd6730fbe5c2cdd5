//! The forecast of one track: a mixture of experts with an error ellipse at every horizon. The
//! network that weighs the experts keeps learning on the track.
//!
//! # Differences from the paper
//!
//! In section 3.1.2 the network predicts the next position itself, from the first training step on,
//! and its output is fed back for later positions. Implemented that way, it is 98 px off 30 frames
//! ahead on a straight line without noise, after 32 samples. Here the network chooses between
//! classical forecasts, separately for near and far horizons, so that a lack of training costs
//! little. Nothing is fed back: every horizon is forecast directly.

pub(crate) mod comparison;
pub(crate) mod curve;
pub(crate) mod ellipse;
pub(crate) mod experts;
pub(crate) mod horizon;
pub(crate) mod inputs;
pub(crate) mod line;
pub(crate) mod mixture;
pub(crate) mod motion;
pub(crate) mod network;
pub(crate) mod parabola;
pub(crate) mod past;
pub(crate) mod sample;
pub(crate) mod scores;
pub(crate) mod turn;

use crate::bounds::Bounds;
use crate::covariance::{Covariance, trace};
use crate::forecast::comparison::{Comparison, Issued};
use crate::forecast::curve::{Forecast, limited};
use crate::forecast::ellipse::{ellipses, limited_ellipses, on_axes};
use crate::forecast::experts::fit;
use crate::forecast::horizon::Horizons;
use crate::forecast::inputs::MotionFeatures;
use crate::forecast::line::Line;
use crate::forecast::mixture::{Evidence, back_to_logits, gate};
use crate::forecast::motion::Motion;
use crate::forecast::network::{GradientStep, Network};
use crate::forecast::past::Past;
use crate::forecast::sample::TrainingSample;
use crate::forecast::scores::Scores;
use crate::heading::Steering;
use crate::history::{History, Sample};
use crate::layout::{EXPERTS, HORIZONS, OUTPUTS};
use crate::limits::FORECAST_RANGE_S;
use crate::observation::Settings;
use crate::vector::{add, norm, scale, sub};

/// Number of samples of the line that gives the noise of a first forecast.
const LINE_SAMPLES: usize = 5;
/// A moving object can stop, or turn equally hard, within about this time. Until more is known, the
/// standard deviation of its acceleration per axis is its speed divided by this.
const STOPPING_TIME_S: f64 = 1.0;
/// Online training. A higher rate gains on tracks that last for minutes and loses on short ones.
const GRADIENT_STEP: GradientStep = GradientStep {
    rate: 0.015,
    max_norm: 1.0,
};

/// The learning state of one track.
#[derive(Debug, Clone)]
pub(crate) struct Forecaster {
    network: Network,
    /// Whether the network is trained online.
    learns: bool,
    scores: Scores,
}

/// Everything computed at the newest sample before the network is evaluated.
struct Analysis {
    horizons: Horizons,
    motions: [Motion; EXPERTS],
    /// Direction of motion, a unit vector.
    direction: [f64; 2],
    evidence: Evidence,
    line: Option<Line>,
}

impl Forecaster {
    pub(crate) const START: Self = Self {
        network: Network::START,
        learns: true,
        scores: Scores::START,
    };

    /// Learns from the newest sample of `history`: compares earlier forecasts with it and trains
    /// the network on the result.
    pub(crate) fn learn(&mut self, history: &History, settings: &Settings) {
        let Some(newest) = history.newest() else {
            return;
        };
        let horizons = Horizons::new(settings.frame_period_s);
        let before = history.samples().iter().rev().nth(1);
        let (network, learns) = (&mut self.network, self.learns);
        self.scores
            .compare(newest, before, &horizons, |comparison| {
                if learns {
                    train(network, comparison);
                }
            });
    }

    /// Computes the forecast from the newest sample, which has the given covariance and lies within
    /// the bounds, and keeps it for later comparison.
    pub(crate) fn forecast(
        &mut self,
        history: &History,
        steering: Option<&Steering>,
        bounds: &Bounds,
        covariance: &Covariance,
        settings: &Settings,
    ) -> Forecast {
        let Some(newest) = history.newest() else {
            return Forecast::EMPTY;
        };
        let analysis = self.analyze(history, steering, bounds, settings);
        let Analysis {
            horizons,
            motions,
            direction,
            ..
        } = analysis;
        let mixture = gate(&self.network, &analysis.evidence);
        let ellipses = limited_ellipses(
            self.ellipses(&analysis, &mixture.log_scale, covariance, settings),
            &horizons,
            self.scores.max_step / horizons.step_s as f32,
        );
        let issued = Issued {
            newest: *newest,
            n_samples: history.samples().len(),
            direction: direction.map(|c| c as f32),
            motions,
            inputs: analysis.evidence.inputs,
            activations: mixture.activations,
            shares: mixture.shares,
            ellipses,
        };
        self.scores.issue(issued, &horizons);
        let mut forecast = Forecast {
            horizons,
            max_ahead_s: FORECAST_RANGE_S + settings.max_gap_s(),
            speed_limit: settings.speed_limit(),
            origin: newest.position,
            motions,
            shares: mixture.shares,
            covariance: *covariance,
            covariances: ellipses.map(|ellipse| on_axes(ellipse, direction)),
            velocity: [0.0; 2],
            turn_rate_rad_s: 0.0,
        };
        for (motion, share) in motions.iter().zip(mixture.shares[0]) {
            let share = f64::from(share);
            forecast.velocity = add(forecast.velocity, scale(motion.velocity(), share));
            forecast.turn_rate_rad_s += share * motion.turn_rate_rad_s();
        }
        forecast.velocity = limited(forecast.velocity, forecast.speed_limit);
        forecast
    }

    /// Drops forecasts that wait for comparison. Call this when the samples were moved to another
    /// reference point of the object.
    pub(crate) fn discard_pending(&mut self) {
        self.scores.discard_pending();
    }

    /// A forecaster with another network, which is not trained: training would pull it towards the
    /// stored start weights.
    pub(crate) fn frozen(network: Network) -> Self {
        Self {
            network,
            learns: false,
            ..Self::START
        }
    }

    /// The training sample of the newest frame, for samples without noise of their own.
    pub(crate) fn sample(
        &mut self,
        history: &History,
        steering: Option<&Steering>,
        bounds: &Bounds,
        settings: &Settings,
    ) -> TrainingSample {
        let analysis = self.analyze(history, steering, bounds, settings);
        let times_s = analysis.horizons.times_s;
        let exact = [[0.0; 2]; 2];
        TrainingSample {
            evidence: analysis.evidence,
            times_s,
            positions: times_s
                .map(|time_s| analysis.motions.map(|motion| motion.at(time_s as f32))),
            ellipses: self.ellipses(&analysis, &[0.0; HORIZONS], &exact, settings),
            direction: analysis.direction.map(|c| c as f32),
        }
    }

    fn analyze(
        &mut self,
        history: &History,
        steering: Option<&Steering>,
        bounds: &Bounds,
        settings: &Settings,
    ) -> Analysis {
        let horizons = Horizons::new(settings.frame_period_s);
        let past = Past::of(history);
        let newest = history.newest().unwrap_or(&Sample::EMPTY);
        let bounds = bounds.map(|corner| sub(corner, newest.position));
        let motions = fit(&past, steering, bounds);
        let reach = settings.speed_limit() * settings.frame_period_s;
        let summary = self.scores.summary(&motions, reach);
        let features = MotionFeatures::of(&past, &horizons);
        Analysis {
            horizons,
            motions,
            direction: features.direction,
            evidence: Evidence {
                inputs: features.inputs(&summary, &horizons, &motions),
                scores: summary.scores,
            },
            line: Line::fit(past.newest(LINE_SAMPLES)),
        }
    }

    fn ellipses(
        &self,
        analysis: &Analysis,
        log_scales: &[f32; HORIZONS],
        covariance: &Covariance,
        settings: &Settings,
    ) -> [[f32; 3]; HORIZONS] {
        ellipses(
            &self.scores.moments,
            &analysis.horizons,
            log_scales,
            |ahead_s| expected_variance(covariance, analysis.line.as_ref(), ahead_s, settings),
        )
    }
}

/// One step of backpropagation on an earlier forecast. The loss is ln(1 + e²/s²), where e is the
/// error of the mixture and s the typical error of the best expert. Beyond s, the gradient falls
/// with the error.
fn train(network: &mut Network, comparison: &Comparison<'_>) {
    let Comparison {
        issued,
        horizon,
        mixed,
        ..
    } = *comparison;
    let error = [0, 1].map(|axis| mixed[axis] - comparison.measured[axis]);
    let typical = comparison.typical_error * comparison.typical_error;
    let bound = typical + error[0] * error[0] + error[1] * error[1];
    let by_position = error.map(|error| 2.0 * error / bound);
    let mut by_logits = [0.0; EXPERTS];
    for ((by_logit, share), position) in by_logits
        .iter_mut()
        .zip(&issued.shares[horizon])
        .zip(&comparison.positions)
    {
        let [x, y] = [0, 1].map(|axis| position[axis] - mixed[axis]);
        *by_logit = share * (by_position[0] * x + by_position[1] * y);
    }
    // These are the activations at the time of the forecast. The weights change little within two
    // seconds.
    let mut by_outputs = [0.0; OUTPUTS];
    back_to_logits(&issued.activations, horizon, &by_logits, &mut by_outputs);
    network.train(
        &issued.inputs,
        &issued.activations,
        &by_outputs,
        GRADIENT_STEP,
    );
}

/// Variance per axis of a measurement `ahead_s` after the newest sample, used until errors are
/// known: the noise of the samples extrapolated along a line, the noise of the measurement, and the
/// acceleration of the object. Without a velocity, the object may go anywhere within its top speed.
fn expected_variance(
    observation: &Covariance,
    line: Option<&Line>,
    ahead_s: f64,
    settings: &Settings,
) -> f64 {
    let (noise_gain, manoeuvre) = match line {
        Some(line) => {
            let speed = norm(line.velocity).min(settings.speed_limit());
            let acceleration = speed / STOPPING_TIME_S;
            (
                line.noise_gain(ahead_s),
                0.5 * acceleration * ahead_s * ahead_s,
            )
        }
        None => (1.0, 0.5 * settings.top_speed * ahead_s),
    };
    0.5 * trace(observation) * (1.0 + noise_gain) + manoeuvre * manoeuvre
}
