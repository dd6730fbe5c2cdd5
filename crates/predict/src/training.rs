//! For the program that makes the start weights: one track's forecaster by itself, what its network is told, and how a
//! loss goes back into it.

use crate::bounds::{NO_WALLS, Walls, pushed_out};
use crate::forecast::Forecaster;
use crate::forecast::curve::Forecast;
pub use crate::forecast::mixture::{Evidence, Shares, back_to_said, back_to_sharpness, weigh};
pub use crate::forecast::network::{Network, STORED_PER_UNIT};
pub use crate::forecast::sample::Lesson;
use crate::heading::HeadingTrack;
use crate::history::{History, Sample};
pub use crate::layout::{
    ANCHORS, ByExpert, EXPERTS, HIDDEN, HORIZONS, INPUTS, MARKS, OUTPUTS, ROW, WEIGHTS,
};
use crate::observation::{Heading, Settings};

/// The forecaster of one track that is seen without interruption by anything else.
#[derive(Debug, Clone)]
pub struct Pupil {
    history: History,
    headings: HeadingTrack,
    forecaster: Forecaster,
    settings: Settings,
    walls: Walls,
    ahead: Forecast,
}

impl Pupil {
    /// A track with this network, which does not learn on it.
    #[must_use]
    pub fn new(settings: &Settings, network: Network) -> Self {
        Self {
            history: History::EMPTY,
            headings: HeadingTrack::EMPTY,
            forecaster: Forecaster::with(network),
            settings: settings.checked(),
            walls: NO_WALLS,
            ahead: Forecast::EMPTY,
        }
    }

    /// Takes a sample, later than those before, and a marker's direction where there is one.
    pub fn see(&mut self, time_ns: u64, position: [f64; 2], heading_rad: Option<f64>) {
        if let Some(rad) = heading_rad {
            let heading = Heading {
                rad,
                variance: 1e-6,
            };
            let period_s = self.settings.frame_period_s;
            self.headings
                .observe(time_ns, heading, period_s, f64::INFINITY);
        }
        self.walls = pushed_out(&self.walls, position);
        if self.history.push(Sample { time_ns, position }, 0) {
            self.forecaster.learn(&self.history, &self.settings);
        }
        let steering = self.headings.steering(self.history.samples());
        let exact = [[0.0; 2]; 2];
        self.ahead = self.forecaster.forecast(
            &self.history,
            steering.as_ref(),
            &self.walls,
            &exact,
            &self.settings,
        );
    }

    /// Place and covariance `ahead_s` after the newest sample.
    #[must_use]
    pub fn at(&self, ahead_s: f64) -> ([f64; 2], [[f64; 2]; 2]) {
        self.ahead.at(ahead_s)
    }

    /// What the newest sample can teach.
    #[must_use]
    pub fn lesson(&mut self) -> Lesson {
        let steering = self.headings.steering(self.history.samples());
        self.forecaster.lesson(
            &self.history,
            steering.as_ref(),
            &self.walls,
            &self.settings,
        )
    }
}
