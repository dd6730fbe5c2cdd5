//! One track's forecast: three models, mixed by their scores, with a covariance for every step.
//!
//! The models are the line and the constant turn of `motion` and the network of `learner`. The line through the
//! last five positions is the floor: it has all of a new track, and each of the others gets the share that `score`
//! says it has earned on this track at this horizon. So the network is trusted neither at the start, when it knows
//! nothing, nor later on a path that never repeats.
//!
//! # Differences from the paper
//!
//! Section 3.1.2 lets the network alone forecast, from its first training on. Without a line beside it, a network
//! loses to the line by far, on straight motion most of all.

use libm::sqrt;

use crate::covariance::{Covariance, trace};
use crate::history::{History, Sample};
use crate::learner::{Learner, direction};
use crate::motion::{Line, Turn, add, norm_squared, scale, sub};
use crate::observation::Settings;
use crate::score::{Paths, Scores};
use crate::{MAX_FORECAST, MAX_GAP_STEPS};

/// Forecasts made from fewer samples are not scored: they say more about the start than about a model.
const MIN_SCORED_SAMPLES: usize = 4;
/// Steps shorter than this part of the forecast step are neither trained nor kept apart in the history.
pub(crate) const LEAST_SPACING_STEPS: f64 = 0.05;
/// Models whose errors differ by less than this part of a step's way are equally good.
const EQUAL_PART_OF_STEP: f64 = 1e-3;
/// The same as a part of the observations' standard deviation.
const EQUAL_PART_OF_NOISE: f64 = 0.02;
/// The same where neither motion nor noise gives a scale, in units.
const EQUAL_ERROR: f64 = 1e-12;
/// What moves is able to stop, or to turn as hard, within about this time. As long as nothing else is known of an
/// object, the standard deviation of its acceleration, on each axis, is its speed divided by this.
const STOPPING_TIME_S: f64 = 1.0;

/// What learns about one track: network and score book.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Forecaster {
    learner: Learner,
    scores: Scores,
}

/// Where an object will be, counted from its newest sample.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Forecast {
    step_s: f64,
    /// Index 0: the newest sample as measured; index k: k steps later.
    places: [[f64; 2]; MAX_FORECAST + 1],
    covariances: [Covariance; MAX_FORECAST + 1],
    /// Velocity at the newest sample, units a second.
    pub(crate) velocity: [f64; 2],
}

impl Forecaster {
    pub(crate) const START: Self = Self {
        learner: Learner::START,
        scores: Scores::START,
    };

    /// Learns from the newest sample of `history`: scores the forecasts made before it and trains the network with it.
    pub(crate) fn learn(&mut self, history: &History, settings: &Settings) {
        let Some(newest) = history.newest() else {
            return;
        };
        let step_s = settings.forecast_step_s;
        self.scores.compare(newest, step_s);
        self.learner
            .learn(history.samples(), LEAST_SPACING_STEPS * step_s);
    }

    /// Looks ahead from the newest sample, whose covariance is given, and remembers what it said.
    pub(crate) fn forecast(
        &mut self,
        history: &History,
        covariance: &Covariance,
        settings: &Settings,
    ) -> Forecast {
        let samples = history.samples();
        let Some(newest) = samples.last() else {
            return Forecast::EMPTY;
        };
        let step_s = settings.forecast_step_s;
        let line = Line::fit(samples);
        let velocity = limited(line.velocity, settings.speed_limit());
        let direction = direction(velocity);
        let paths = self.paths(samples, &line, settings);
        let speed = sqrt(norm_squared(velocity));
        let noise = sqrt(0.5 * trace(covariance));
        let least_error =
            EQUAL_PART_OF_STEP * speed * step_s + EQUAL_PART_OF_NOISE * noise + EQUAL_ERROR;
        let shares = self.scores.shares(least_error);

        let mut mixture = [[0.0; 2]; MAX_FORECAST];
        for (mixed, (places, shares)) in mixture.iter_mut().zip(paths.iter().zip(&shares)) {
            for (place, share) in places.iter().zip(shares) {
                *mixed = add(*mixed, scale(*place, *share));
            }
        }
        let step_covariances = self.scores.covariances(direction, |step| {
            expected_covariance(covariance, &line, (step as f64 + 1.0) * step_s, settings)
        });
        if samples.len() >= MIN_SCORED_SAMPLES {
            self.scores
                .issue(newest, direction, &paths, &mixture, step_s);
        }

        let mut forecast = Forecast {
            step_s,
            places: [newest.position; MAX_FORECAST + 1],
            covariances: [*covariance; MAX_FORECAST + 1],
            velocity,
        };
        forecast.places[1..].copy_from_slice(&mixture);
        forecast.covariances[1..].copy_from_slice(&step_covariances);
        forecast
    }

    /// Tells that the samples were moved to another point of the body: earlier forecasts can no longer be compared.
    pub(crate) fn measured_elsewhere(&mut self) {
        self.scores.withdraw();
    }

    /// Every model's places, none faster than the speed limit.
    fn paths(&self, samples: &[Sample], line: &Line, settings: &Settings) -> Paths {
        let step_s = settings.forecast_step_s;
        let origin = samples[samples.len() - 1].position;
        let turn = Turn::fit(samples, step_s);
        let learned = self.learner.path(samples, step_s);
        let mut paths = Paths::default();
        for (i, places) in paths.iter_mut().enumerate() {
            let ahead_s = (i as f64 + 1.0) * step_s;
            let straight = line.at(ahead_s);
            *places = [
                straight,
                turn.map_or(straight, |turn| turn.at(ahead_s)),
                learned.map_or(straight, |path| path[i]),
            ];
            let reach = settings.speed_limit() * ahead_s;
            *places = places.map(|place| add(origin, limited(sub(place, origin), reach)));
        }
        paths
    }
}

impl Forecast {
    pub(crate) const EMPTY: Self = Self {
        step_s: 1.0,
        places: [[0.0; 2]; MAX_FORECAST + 1],
        covariances: [[[0.0; 2]; 2]; MAX_FORECAST + 1],
        velocity: [0.0; 2],
    };

    /// Place and covariance `ahead_s` seconds after the newest sample: linear between the steps, straight on after
    /// the last, where the standard deviations grow with time, and no further than the longest gap.
    pub(crate) fn at(&self, ahead_s: f64) -> ([f64; 2], Covariance) {
        let steps = (ahead_s / self.step_s).min(MAX_GAP_STEPS);
        let upper = (steps as usize + 1).min(MAX_FORECAST);
        let part = steps - (upper - 1) as f64;
        let from = self.places[upper - 1];
        let place = add(from, scale(sub(self.places[upper], from), part));
        let mut covariance = self.covariances[upper];
        if part > 1.0 {
            let growth = steps / MAX_FORECAST as f64;
            covariance = covariance.map(|row| scale(row, growth * growth));
        } else {
            for (row, from) in covariance.iter_mut().zip(self.covariances[upper - 1]) {
                *row = add(from, scale(sub(*row, from), part));
            }
        }
        (place, covariance)
    }
}

/// Covariance of a measurement `ahead_s` after the newest sample before any error is known: observation noise as
/// the line fit carries it forward, the measurement's own, and what the object may do of its own will. Without a
/// velocity it may go anywhere within its top speed.
fn expected_covariance(
    observation: &Covariance,
    line: &Line,
    ahead_s: f64,
    settings: &Settings,
) -> Covariance {
    let (noise_gain, will) = if line.has_velocity() {
        let speed = sqrt(norm_squared(line.velocity)).min(settings.speed_limit());
        let acceleration = speed / STOPPING_TIME_S;
        (
            line.noise_gain(ahead_s),
            0.5 * acceleration * ahead_s * ahead_s,
        )
    } else {
        (1.0, 0.5 * settings.top_speed * ahead_s)
    };
    let mut covariance = observation.map(|row| scale(row, 1.0 + noise_gain));
    covariance[0][0] += will * will;
    covariance[1][1] += will * will;
    covariance
}

/// The vector, shortened to the length `most`; zero if it is not finite.
fn limited(vector: [f64; 2], most: f64) -> [f64; 2] {
    let length = sqrt(norm_squared(vector));
    if !length.is_finite() {
        [0.0; 2]
    } else if length > most {
        scale(vector, most / length)
    } else {
        vector
    }
}
