//! What training takes from one frame.

use crate::forecast::mixture::Evidence;
use crate::layout::{ByExpert, HORIZONS};

/// What one frame can teach.
#[derive(Debug, Clone)]
pub struct Lesson {
    /// What was known.
    pub evidence: Evidence,
    /// The horizons.
    pub times_s: [f64; HORIZONS],
    /// By horizon and expert, relative to the newest place.
    pub places: ByExpert<[f32; 2]>,
    /// Ellipses before the network has a say: along, both, across.
    pub ellipses: [[f32; 3]; HORIZONS],
    /// Direction of motion, the ellipses' axis.
    pub direction: [f32; 2],
}
