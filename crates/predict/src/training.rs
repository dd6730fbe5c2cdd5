//! For the program that computes the start weights: the forecaster of a single track, and how a
//! loss is propagated back through its mixture.

use crate::bounds::{Bounds, NO_BOUNDS, expanded};
use crate::forecast::Forecaster;
pub use crate::forecast::mixture::{Evidence, Shares, back_to_logits, back_to_sharpness, gate};
pub use crate::forecast::network::{Network, STORED_PER_UNIT};
pub use crate::forecast::sample::TrainingSample;
use crate::heading::HeadingTrack;
use crate::history::{History, Sample};
pub use crate::layout::{
    ANCHORS, ByExpert, EXPERTS, HIDDEN, HORIZONS, INPUTS, OUTPUTS, ROW, SCORES, WEIGHTS,
};
use crate::observation::{Heading, Settings};

/// A single track that is observed without assignment or merging.
#[derive(Debug, Clone)]
pub struct TrainingTrack {
    history: History,
    headings: HeadingTrack,
    forecaster: Forecaster,
    settings: Settings,
    bounds: Bounds,
}

impl TrainingTrack {
    /// A track that uses this network without training it.
    #[must_use]
    pub fn new(settings: &Settings, network: Network) -> Self {
        Self {
            history: History::EMPTY,
            headings: HeadingTrack::EMPTY,
            forecaster: Forecaster::frozen(network),
            settings: settings.checked(),
            bounds: NO_BOUNDS,
        }
    }

    /// Adds a sample later than the previous ones, with the heading of the marker if there is one.
    pub fn observe(&mut self, time_ns: u64, position: [f64; 2], heading_rad: Option<f64>) {
        if let Some(rad) = heading_rad {
            let heading = Heading {
                rad,
                variance: 1e-6,
            };
            let period_s = self.settings.frame_period_s;
            self.headings
                .observe(time_ns, heading, period_s, f64::INFINITY);
        }
        self.bounds = expanded(&self.bounds, position);
        if self.history.push(Sample { time_ns, position }, 0) {
            self.forecaster.learn(&self.history, &self.settings);
        }
        let steering = self.headings.steering(self.history.samples());
        let exact = [[0.0; 2]; 2];
        // Issued for comparison with the samples to come.
        self.forecaster.forecast(
            &self.history,
            steering.as_ref(),
            &self.bounds,
            &exact,
            &self.settings,
        );
    }

    /// The training sample of the newest frame.
    #[must_use]
    pub fn sample(&mut self) -> TrainingSample {
        let steering = self.headings.steering(self.history.samples());
        self.forecaster.sample(
            &self.history,
            steering.as_ref(),
            &self.bounds,
            &self.settings,
        )
    }
}
