//! An earlier forecast, and what came of it.

use libm::sqrtf;

use crate::forecast::motion::Motion;
use crate::forecast::network::Answer;
use crate::history::Sample;
use crate::layout::{ByExpert, EXPERTS, HORIZONS, INPUTS};
use crate::vector::sub;

/// Bound of an error's components in units.
const MOST_ERROR: f32 = 1e18;

/// One forecast as it was made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Issued {
    /// The newest sample then, and how many there were.
    pub(crate) newest: Sample,
    pub(crate) n_samples: usize,
    /// Direction of motion, for the ellipse's axes.
    pub(crate) direction: [f32; 2],
    pub(crate) motions: [Motion; EXPERTS],
    pub(crate) inputs: [f32; INPUTS],
    pub(crate) answer: Answer,
    pub(crate) shares: ByExpert<f32>,
    /// Covariances along, both, across.
    pub(crate) ellipses: [[f32; 3]; HORIZONS],
}

/// What came of an earlier forecast.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Comparison<'a> {
    pub(crate) issued: &'a Issued,
    pub(crate) horizon: usize,
    /// Place that came, and those forecast by each expert and by the mixture, relative to the newest sample then.
    pub(crate) came: [f32; 2],
    pub(crate) places: [[f32; 2]; EXPERTS],
    pub(crate) mixed: [f32; 2],
    /// The best expert's usual error at this horizon, not below the least that means anything.
    pub(crate) usual_error: f32,
}

impl Issued {
    /// A place for one.
    pub(crate) const NONE: Self = Self {
        newest: Sample::EMPTY,
        n_samples: 0,
        direction: [1.0, 0.0],
        motions: [Motion::NONE; EXPERTS],
        inputs: [0.0; INPUTS],
        answer: Answer::NONE,
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
        usual_error: f32,
    ) -> Self {
        let places = issued.motions.map(|motion| motion.at(age_s as f32));
        let mut mixed = [0.0; 2];
        for (share, place) in issued.shares[horizon].iter().zip(&places) {
            mixed[0] += share * place[0];
            mixed[1] += share * place[1];
        }
        Self {
            issued,
            horizon,
            came: sub(newest.position, issued.newest.position).map(|c| c as f32),
            places,
            mixed,
            usual_error,
        }
    }

    pub(crate) fn errors(&self) -> [f32; EXPERTS] {
        self.places
            .map(|place| length([place[0] - self.came[0], place[1] - self.came[1]]))
    }
}

/// From what holds at the first horizon to what holds at the last.
pub(crate) fn between([first, last]: [f32; 2], horizon: usize) -> f32 {
    first + (last - first) * (horizon as f32 / (HORIZONS - 1) as f32)
}

/// Length of an error, within what can be squared.
pub(crate) fn length(error: [f32; 2]) -> f32 {
    let [x, y] = error.map(|c| c.clamp(-MOST_ERROR, MOST_ERROR));
    sqrtf(x * x + y * y)
}
