//! A training sample.

use crate::forecast::mixture::Evidence;
use crate::layout::{ByExpert, HORIZONS};

/// The training sample of one frame.
#[derive(Debug, Clone)]
pub struct TrainingSample {
    /// What the shares are computed from.
    pub evidence: Evidence,
    /// The horizons in seconds.
    pub times_s: [f64; HORIZONS],
    /// Forecasts by horizon and expert, relative to the newest position.
    pub positions: ByExpert<[f32; 2]>,
    /// Ellipses before the network scales them: along, both, across.
    pub ellipses: [[f32; 3]; HORIZONS],
    /// Direction of motion, the axis of the ellipses.
    pub direction: [f32; 2],
}
