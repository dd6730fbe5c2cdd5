//! What lens and sensor do to every plate alike: blur, learned from the markers that were read, and noise.

use imgproc::fit::{Fit, Prior};

/// Blur before any marker was read, and the standard deviation of its logarithm: an ordinary lens, in focus or a little out.
const START: (f32, f32) = (0.65, 0.35);

/// How much the blurs of two plates before one camera differ (distance, motion): standard deviation of the logarithm.
const BETWEEN_PLATES: f32 = 0.08;

/// By how much the camera's blur may change from frame to frame: standard deviation of the logarithm.
const DRIFT: f32 = 0.003;

/// Noise of a channel over that of the brightness, to which three channels with their own noise add up.
const CHANNEL_NOISE: f32 = 1.5;

/// Blur of colours over that of brightness, and the standard deviation of its logarithm.
const COLOUR_BLUR: (f32, f32) = (1.3, 0.4);

/// What is known of a camera.
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

    /// Standard deviation of the blur, pixels.
    pub(crate) fn blur_px(&self) -> f32 {
        self.ln_blur.exp()
    }

    /// The same for a projection of the colours in which the noise of a channel is so many times as large. Cameras blur colours
    /// more than brightness, by how much differs, and nothing is learned from it.
    pub(crate) fn of_colour(&self, gain: f32) -> Self {
        Self {
            noise: CHANNEL_NOISE * gain * self.noise,
            ln_blur: self.ln_blur + COLOUR_BLUR.0.ln(),
            ln_variance: COLOUR_BLUR.1 * COLOUR_BLUR.1,
            of_colour: true,
        }
    }

    /// What a fit may start from.
    pub(crate) fn prior(&self, plate_ln_sigma: f32, residual_ratio_max: f32) -> Prior {
        Prior {
            noise: self.noise.max(NOISE_MIN),
            blur_ln_sigma: (self.ln_variance + BETWEEN_PLATES * BETWEEN_PLATES).sqrt(),
            plate_ln_sigma,
            residual_ratio_max,
        }
    }

    /// What a fit says of the camera's blur: its logarithm, and the variance of that.
    pub(crate) fn blur_of(&self, fit: &Fit) -> Option<(f32, f32)> {
        (!self.of_colour).then(|| (fit.pose.blur_px.ln(), fit.blur_ln_variance))
    }

    /// Learns from the fits of a frame, which all started from [`Self::prior`]: blur and its variance, both of the logarithm.
    pub(crate) fn learn(&mut self, fits: impl Iterator<Item = (f32, f32)>) {
        let spread = BETWEEN_PLATES * BETWEEN_PLATES;
        let prior = self.ln_variance + spread;
        let (mut information, mut sum) = (0.0, 0.0);
        for (ln_blur, variance) in fits {
            // What the fit adds to what it started from.
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

/// A camera rounds to whole grey levels, and compresses.
const NOISE_MIN: f32 = 0.5;
