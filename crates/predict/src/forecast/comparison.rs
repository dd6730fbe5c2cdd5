//! An earlier forecast compared with the position that was measured later.

use libm::sqrtf;

use crate::forecast::motion::Motion;
use crate::forecast::network::Activations;
use crate::history::Sample;
use crate::layout::{ByExpert, EXPERTS, HORIZONS, INPUTS};
use crate::vector::sub;

/// Maximum of an error's components in units.
const MAX_ERROR: f32 = 1e18;

/// A forecast as it was issued.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Issued {
    /// The newest sample at that time, and the number of samples.
    pub(crate) newest: Sample,
    pub(crate) n_samples: usize,
    /// Direction of motion: the axis of the ellipses.
    pub(crate) direction: [f32; 2],
    pub(crate) motions: [Motion; EXPERTS],
    pub(crate) inputs: [f32; INPUTS],
    pub(crate) activations: Activations,
    pub(crate) shares: ByExpert<f32>,
    /// Covariances by horizon: along, both, across.
    pub(crate) ellipses: [[f32; 3]; HORIZONS],
}

/// An issued forecast and the position measured at one of its horizons.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Comparison<'a> {
    pub(crate) issued: &'a Issued,
    pub(crate) horizon: usize,
    /// Measured position, and the forecasts of each expert and of the mixture, relative to the
    /// newest sample of the forecast.
    pub(crate) measured: [f32; 2],
    pub(crate) positions: [[f32; 2]; EXPERTS],
    pub(crate) mixed: [f32; 2],
    /// Typical error of the best expert at this horizon, not below the error floor.
    pub(crate) typical_error: f32,
}

impl Issued {
    /// An empty value.
    pub(crate) const NONE: Self = Self {
        newest: Sample::EMPTY,
        n_samples: 0,
        direction: [1.0, 0.0],
        motions: [Motion::NONE; EXPERTS],
        inputs: [0.0; INPUTS],
        activations: Activations::NONE,
        shares: [[0.0; EXPERTS]; HORIZONS],
        ellipses: [[0.0; 3]; HORIZONS],
    };
}

impl<'a> Comparison<'a> {
    pub(crate) fn of(
        issued: &'a Issued,
        horizon: usize,
        age_s: f64,
        newest: &Sample,
        typical_error: f32,
    ) -> Self {
        let positions = issued.motions.map(|motion| motion.at(age_s as f32));
        let mut mixed = [0.0; 2];
        for (share, position) in issued.shares[horizon].iter().zip(&positions) {
            mixed[0] += share * position[0];
            mixed[1] += share * position[1];
        }
        Self {
            issued,
            horizon,
            measured: sub(newest.position, issued.newest.position).map(|c| c as f32),
            positions,
            mixed,
            typical_error,
        }
    }

    pub(crate) fn errors(&self) -> [f32; EXPERTS] {
        self.positions.map(|position| {
            error_length([
                position[0] - self.measured[0],
                position[1] - self.measured[1],
            ])
        })
    }
}

/// Interpolates between the values at the first and the last horizon.
pub(crate) fn between([first, last]: [f32; 2], horizon: usize) -> f32 {
    first + (last - first) * (horizon as f32 / (HORIZONS - 1) as f32)
}

/// Length of an error, limited so that its square is finite.
pub(crate) fn error_length(error: [f32; 2]) -> f32 {
    let [x, y] = error.map(|c| c.clamp(-MAX_ERROR, MAX_ERROR));
    sqrtf(x * x + y * y)
}
