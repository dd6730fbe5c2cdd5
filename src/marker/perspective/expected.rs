//! What is expected of a plate at one place of the picture, and what a fit of it says.

use imgproc::fit::StretchPrior;

/// Tolerance for robots on ramps and bent plates, when it is decided whether a stretch is possible.
const TOLERANCE: f32 = 0.01;

/// The perspective is known with this standard deviation of the stretch.
const KNOWN: f32 = 0.03;

/// Up to this stretch, the contour of a marker is near enough to that of an upright plate.
const STRETCHED: f32 = 0.02;

/// What is expected of a plate at one place of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ExpectedStretch {
    pub(super) stretch: [f32; 2],
    pub(super) sigma: f32,
    pub(super) curvature: [[f32; 3]; 2],
    /// Standard deviation of the curvature, per pixel of the plate's side.
    pub(super) curvature_sigma: f32,
}

impl ExpectedStretch {
    /// The prior of a fit.
    pub(crate) fn prior(&self, blur_px: f32, plate_px: f32) -> StretchPrior {
        StretchPrior {
            blur_px,
            stretch: self.stretch,
            sigma: self.sigma,
            curvature: self.curvature,
            curvature_sigma: self.curvature_sigma * plate_px,
        }
    }

    /// What a fit that started from this prior adds to it: a measurement of the stretch, and its
    /// variance. `None` if it adds nothing.
    pub(crate) fn reading(&self, stretch: [f32; 2], variance: [f32; 2]) -> Option<StretchReading> {
        let prior = f64::from(self.sigma * self.sigma);
        let variance = f64::from(variance[0].max(variance[1]));
        let information = 1.0 / variance - 1.0 / prior;
        if information.is_nan() || information <= 0.1 / prior {
            return None;
        }
        let measured = [0, 1].map(|i| {
            let (now, before) = (f64::from(stretch[i]), f64::from(self.stretch[i]));
            (now / variance - before / prior) / information
        });
        Some(StretchReading {
            stretch: measured,
            variance: 1.0 / information,
        })
    }

    /// Square of the deviation of a stretch that was measured with this variance, in standard
    /// deviations of both.
    pub(crate) fn deviation2(&self, stretch: [f32; 2], variance: f32) -> f32 {
        let off = [0, 1].map(|i| stretch[i] - self.stretch[i]);
        let tolerated = TOLERANCE * TOLERANCE;
        (off[0] * off[0] + off[1] * off[1]) / (self.sigma * self.sigma + variance + tolerated)
    }

    /// How plates are seen here.
    pub(crate) fn seen(&self) -> Seen {
        let [s, t] = self.stretch;
        if self.sigma > KNOWN {
            Seen::Unknown
        } else if s.hypot(t) > STRETCHED {
            Seen::AtAnAngle
        } else {
            Seen::FromAbove
        }
    }
}

/// How a camera sees plates at one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Seen {
    /// As squares, or nearly.
    FromAbove,
    AtAnAngle,
    /// Its perspective is not known yet.
    Unknown,
}

/// A measurement of the stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StretchReading {
    pub(super) stretch: [f64; 2],
    pub(super) variance: f64,
}

impl StretchReading {
    pub(crate) fn stretch(&self) -> [f32; 2] {
        self.stretch.map(|s| s as f32)
    }

    /// Variance of each of the two numbers.
    pub(crate) fn variance(&self) -> f32 {
        self.variance as f32
    }
}
