//! Effects of lens and sensor that are the same for every plate: blur, estimated from the
//! recognised markers, and noise.

use imgproc::fit::{Fit, Prior};

use crate::marker::perspective::ExpectedStretch;

/// Initial blur, and the standard deviation of its logarithm: an ordinary lens, in focus or
/// slightly out of focus.
const START: (f32, f32) = (0.65, 0.35);

/// Variation of blur between two plates seen by one camera (distance, motion): standard deviation
/// of the logarithm.
const BETWEEN_PLATES: f32 = 0.08;

/// Drift of the camera's blur per frame: standard deviation of the logarithm.
const DRIFT: f32 = 0.003;

/// Noise of a channel relative to that of the brightness, the sum of three channels with
/// independent noise.
const CHANNEL_NOISE: f32 = 1.5;

/// Blur of colours relative to that of brightness, and the standard deviation of its logarithm.
const COLOUR_BLUR: (f32, f32) = (1.3, 0.4);

/// What is known of the camera before a plate is fitted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Optics {
    pub(crate) blur: BlurEstimate,
    pub(crate) stretch: ExpectedStretch,
}

/// Estimate for a camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BlurEstimate {
    /// Noise of a pixel, grey levels.
    pub(crate) noise: f32,
    ln_blur: f32,
    ln_variance: f32,
    of_colour: bool,
}

impl BlurEstimate {
    pub(crate) fn new() -> Self {
        Self {
            noise: 0.0,
            ln_blur: START.0.ln(),
            ln_variance: START.1 * START.1,
            of_colour: false,
        }
    }

    /// Estimated blur: standard deviation of the point spread, pixels.
    pub(crate) fn blur_px(&self) -> f32 {
        self.ln_blur.exp()
    }

    /// The estimate for a projection of the colours in which the noise of a channel is `gain` times
    /// as large. Cameras blur colours more than brightness; the ratio varies and is not learned.
    pub(crate) fn of_colour(&self, gain: f32) -> Self {
        Self {
            noise: CHANNEL_NOISE * gain * self.noise,
            ln_blur: self.ln_blur + COLOUR_BLUR.0.ln(),
            ln_variance: COLOUR_BLUR.1 * COLOUR_BLUR.1,
            of_colour: true,
        }
    }

    /// Noise of a pixel in grey levels, as the fits assume it.
    pub(crate) fn noise(&self) -> f32 {
        self.noise.max(NOISE_MIN)
    }

    /// Prior of a fit.
    pub(crate) fn prior(&self, plate_ln_sigma: f32, residual_ratio_max: f32) -> Prior {
        Prior {
            noise: self.noise(),
            blur_ln_sigma: (self.ln_variance + BETWEEN_PLATES * BETWEEN_PLATES).sqrt(),
            plate_ln_sigma,
            residual_ratio_max,
        }
    }

    /// The camera's blur according to a fit: its logarithm, and the variance of that.
    pub(crate) fn blur_of(&self, fit: &Fit) -> Option<(f32, f32)> {
        (!self.of_colour).then(|| (fit.pose.blur_px.ln(), fit.blur_ln_variance))
    }

    /// Updates the estimate from the fits of a frame, which all started from [`Self::prior`]. Each
    /// is a blur and its variance, both of the logarithm.
    pub(crate) fn learn(&mut self, fits: impl Iterator<Item = (f32, f32)>) {
        let spread = BETWEEN_PLATES * BETWEEN_PLATES;
        let prior = self.ln_variance + spread;
        let (mut information, mut sum) = (0.0, 0.0);
        for (ln_blur, variance) in fits {
            // Information that the fit adds to its prior.
            let own = 1.0 / variance - 1.0 / prior;
            if own <= 0.0 {
                continue;
            }
            let measured = (ln_blur / variance - self.ln_blur / prior) / own;
            let weight = 1.0 / (1.0 / own + spread);
            information += weight;
            sum += weight * (measured - self.ln_blur).clamp(-1.0, 1.0);
        }
        let own = 1.0 / self.ln_variance;
        self.ln_blur += sum / (own + information);
        self.ln_variance = 1.0 / (own + information) + DRIFT * DRIFT;
    }
}

/// Minimum noise: a camera rounds to whole grey levels, and compresses.
const NOISE_MIN: f32 = 0.5;
