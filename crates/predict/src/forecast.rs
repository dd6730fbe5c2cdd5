//! One track's forecast: experts (`experts`) weighed by a network (`mixture`) that goes on learning on the track, with an
//! ellipse for every moment (`ellipse`).
//!
//! # Differences from the paper
//!
//! Section 3.1.2 lets the network itself say the next position, from the first training on, and feeds that back for positions
//! farther ahead. So built, it is 98 px wrong 30 frames ahead on a straight line without noise, after 32 samples. Here the
//! network says which of the classical forecasts to trust, separately for near and far, so that what it does not know yet costs
//! little; there is no feeding back, and every moment ahead is asked for directly.

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

use crate::bounds::Walls;
use crate::covariance::{Covariance, trace};
use crate::forecast::comparison::{Comparison, Issued};
use crate::forecast::curve::{Forecast, limited};
use crate::forecast::ellipse::{ellipses, on_axes, published};
use crate::forecast::experts::fit;
use crate::forecast::horizon::Horizons;
use crate::forecast::inputs::Motions;
use crate::forecast::line::Line;
use crate::forecast::mixture::{Evidence, back_to_said, weigh};
use crate::forecast::motion::Motion;
use crate::forecast::network::{Descent, Network};
use crate::forecast::past::Past;
use crate::forecast::sample::Lesson;
use crate::forecast::scores::Marks;
use crate::heading::Steering;
use crate::history::{History, Sample};
use crate::layout::{EXPERTS, HORIZONS, OUTPUTS};
use crate::limits::FARTHEST_S;
use crate::observation::Settings;
use crate::vector::{add, norm, scale, sub};

/// Samples of the line that tells how much noise a first forecast carries.
const LINE_SAMPLES: usize = 5;
/// What moves is able to stop, or to turn as hard, within about this time. As long as nothing else is known of an
/// object, the standard deviation of its acceleration, on each axis, is its speed divided by this.
const STOPPING_TIME_S: f64 = 1.0;
/// How the network follows a comparison. Faster learning gains on tracks that last for minutes and loses on short ones.
const DESCENT: Descent = Descent {
    rate: 0.015,
    most: 1.0,
};
/// Part of the way back to the start weights for every step of training.
const PULL: f32 = 2e-4;

/// What learns about one track.
#[derive(Debug, Clone)]
pub(crate) struct Forecaster {
    network: Network,
    /// Whether the network learns.
    learns: bool,
    marks: Marks,
}

/// All that is known at the newest sample.
struct Known {
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
        marks: Marks::START,
    };

    /// Learns from the newest sample of `history`: compares the forecasts made before it, and trains the network with them.
    pub(crate) fn learn(&mut self, history: &History, settings: &Settings) {
        let Some(newest) = history.newest() else {
            return;
        };
        let horizons = Horizons::new(settings.frame_period_s);
        let before = history.samples().iter().rev().nth(1);
        let (network, learns, mut n_steps) = (&mut self.network, self.learns, 0.0);
        self.marks.compare(newest, before, &horizons, |comparison| {
            if learns {
                train(network, comparison);
                n_steps += 1.0;
            }
        });
        if n_steps > 0.0 {
            network.pull_back(n_steps * PULL);
        }
    }

    /// Looks ahead from the newest sample, whose covariance is given, and remembers what it said. The sample lies within the walls.
    pub(crate) fn forecast(
        &mut self,
        history: &History,
        steering: Option<&Steering>,
        walls: &Walls,
        covariance: &Covariance,
        settings: &Settings,
    ) -> Forecast {
        let Some(newest) = history.newest() else {
            return Forecast::EMPTY;
        };
        let known = self.known(history, steering, walls, settings);
        let Known {
            horizons,
            motions,
            direction,
            ..
        } = known;
        let weighed = weigh(&self.network, &known.evidence);
        let ellipses = published(
            self.ellipses(&known, &weighed.spread, covariance, settings),
            &horizons,
            self.marks.fastest / horizons.step_s as f32,
        );
        let issued = Issued {
            newest: *newest,
            n_samples: history.samples().len(),
            direction: direction.map(|c| c as f32),
            motions,
            inputs: known.evidence.inputs,
            answer: weighed.answer,
            shares: weighed.shares,
            ellipses,
        };
        self.marks.issue(issued, &horizons);
        let mut forecast = Forecast {
            horizons,
            longest_s: FARTHEST_S + settings.longest_gap_s(),
            speed_limit: settings.speed_limit(),
            origin: newest.position,
            motions,
            shares: weighed.shares,
            covariance: *covariance,
            covariances: ellipses.map(|ellipse| on_axes(ellipse, direction)),
            velocity: [0.0; 2],
            turn_rate_rad_s: 0.0,
        };
        for (motion, share) in motions.iter().zip(weighed.shares[0]) {
            let share = f64::from(share);
            forecast.velocity = add(forecast.velocity, scale(motion.velocity(), share));
            forecast.turn_rate_rad_s += share * motion.turn_rate_rad_s();
        }
        forecast.velocity = limited(forecast.velocity, forecast.speed_limit);
        forecast
    }

    /// Tells that the samples were moved to another point of the body: earlier forecasts can no longer be compared.
    pub(crate) fn measured_elsewhere(&mut self) {
        self.marks.withdraw();
    }

    /// A track with another network, which stays as it is: it would be pulled to the stored start weights.
    pub(crate) fn with(network: Network) -> Self {
        Self {
            network,
            learns: false,
            ..Self::START
        }
    }

    /// What the newest sample can teach, for samples without noise of their own.
    pub(crate) fn lesson(
        &mut self,
        history: &History,
        steering: Option<&Steering>,
        walls: &Walls,
        settings: &Settings,
    ) -> Lesson {
        let known = self.known(history, steering, walls, settings);
        let times_s = known.horizons.times_s;
        let exact = [[0.0; 2]; 2];
        Lesson {
            evidence: known.evidence,
            times_s,
            places: times_s.map(|time_s| known.motions.map(|motion| motion.at(time_s as f32))),
            ellipses: self.ellipses(&known, &[0.0; HORIZONS], &exact, settings),
            direction: known.direction.map(|c| c as f32),
        }
    }

    fn known(
        &mut self,
        history: &History,
        steering: Option<&Steering>,
        walls: &Walls,
        settings: &Settings,
    ) -> Known {
        let horizons = Horizons::new(settings.frame_period_s);
        let past = Past::of(history);
        let newest = history.newest().unwrap_or(&Sample::EMPTY);
        let walls = walls.map(|corner| sub(corner, newest.position));
        let motions = fit(&past, steering, walls);
        let reach = settings.speed_limit() * settings.frame_period_s;
        let summary = self.marks.summary(&motions, reach);
        let moved = Motions::of(&past, &horizons);
        Known {
            horizons,
            motions,
            direction: moved.direction,
            evidence: Evidence {
                inputs: moved.inputs(&summary, &horizons, &motions),
                marks: summary.marks,
            },
            line: Line::fit(past.newest(LINE_SAMPLES)),
        }
    }

    fn ellipses(
        &self,
        known: &Known,
        said: &[f32; HORIZONS],
        covariance: &Covariance,
        settings: &Settings,
    ) -> [[f32; 3]; HORIZONS] {
        ellipses(&self.marks.moments, &known.horizons, said, |ahead_s| {
            expected_variance(covariance, known.line.as_ref(), ahead_s, settings)
        })
    }
}

/// One step of backpropagation on an earlier forecast and what came of it. Loss: ln(1 + e²/s²), e the mixture's error and s
/// the best expert's usual one; beyond s, a miss pulls the less the larger it is.
fn train(network: &mut Network, comparison: &Comparison<'_>) {
    let Comparison {
        issued,
        horizon,
        mixed,
        ..
    } = *comparison;
    let error = [0, 1].map(|axis| mixed[axis] - comparison.came[axis]);
    let usual = comparison.usual_error * comparison.usual_error;
    let bound = usual + error[0] * error[0] + error[1] * error[1];
    let by_place = error.map(|error| 2.0 * error / bound);
    let mut by_logits = [0.0; EXPERTS];
    for ((by_logit, share), place) in by_logits
        .iter_mut()
        .zip(&issued.shares[horizon])
        .zip(&comparison.places)
    {
        let [x, y] = [0, 1].map(|axis| place[axis] - mixed[axis]);
        *by_logit = share * (by_place[0] * x + by_place[1] * y);
    }
    // The answer is that of the moment, not of the weights as they are by now: they change little within two seconds.
    let mut by_outputs = [0.0; OUTPUTS];
    back_to_said(&issued.answer, horizon, &by_logits, &mut by_outputs);
    network.train(&issued.inputs, &issued.answer, &by_outputs, DESCENT);
}

/// Variance of a measurement `ahead_s` after the newest sample before any error is known, on each axis: observation
/// noise as a line carries it forward, the measurement's own, and what the object may do of its own will. Without a
/// velocity it may go anywhere within its top speed.
fn expected_variance(
    observation: &Covariance,
    line: Option<&Line>,
    ahead_s: f64,
    settings: &Settings,
) -> f64 {
    let (noise_gain, will) = match line {
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
    0.5 * trace(observation) * (1.0 + noise_gain) + will * will
}
