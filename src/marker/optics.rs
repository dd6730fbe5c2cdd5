//! Effects of lens and sensor that are the same for every plate: blur, tone curve and sharpening,
//! estimated from the recognised markers, and noise.

use imgproc::fit::{Fit, Prior};
use imgproc::tone::ToneCurve;

use crate::marker::perspective::ExpectedStretch;

/// Blur: logarithm of the standard deviation in pixels. An ordinary lens, in focus or slightly out
/// of focus. It differs between two plates by distance and motion.
const BLUR: Estimate = Estimate {
    // 0.65 px.
    mean: -0.43,
    variance: 0.35 * 0.35,
    between_plates: 0.08,
    drift: 0.003,
};

/// Exponent of the tone curve. Most cameras have 0.45, those for measuring 1. Ink that spreads in
/// the paper, or does not fill its outline, has the same effect and may differ between plates.
const TONE: Estimate = Estimate {
    mean: 0.75,
    variance: 0.3 * 0.3,
    between_plates: 0.01,
    drift: 0.001,
};

/// The imaging is known from this standard deviation of the exponent on.
const KNOWN_TONE: f32 = 0.05;

/// Sharpening: the share of the difference from a softer picture that the camera adds. Cameras for
/// measuring add none, others up to twice the difference.
const SHARPENING: Estimate = Estimate {
    mean: 0.3,
    variance: 0.5 * 0.5,
    between_plates: 0.03,
    drift: 0.001,
};

/// Noise of a channel relative to that of the brightness, the sum of three channels with
/// independent noise.
const CHANNEL_NOISE: f32 = 1.5;

/// Blur of colours relative to that of brightness, and the standard deviation of its logarithm.
const COLOUR_BLUR: (f32, f32) = (1.3, 0.4);

/// Standard deviation of the exponent for a difference of colours, which is 1.
const COLOUR_TONE_SIGMA: f32 = 0.1;

/// Minimum noise: a camera rounds to whole grey levels, and compresses.
const NOISE_MIN: f32 = 0.5;

/// What is known of the camera before a plate is fitted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Optics {
    pub(crate) imaging: Imaging,
    pub(crate) stretch: ExpectedStretch,
}

/// A number that is nearly the same for all plates, and changes slowly.
#[derive(Debug, Clone, Copy)]
struct Estimate {
    mean: f32,
    variance: f32,
    /// Standard deviation between two plates.
    between_plates: f32,
    /// Standard deviation of the change per frame.
    drift: f32,
}

/// A number as one fit has it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Fitted {
    value: f32,
    variance: f32,
}

impl Estimate {
    /// Variance of the number for a plate that is not yet fitted.
    fn prior_variance(&self) -> f32 {
        self.variance + self.between_plates * self.between_plates
    }

    /// Updates the estimate from the fits of a frame, which all started from it.
    fn learn(&mut self, fits: impl Iterator<Item = Fitted>) {
        let prior = self.prior_variance();
        let (mut information, mut sum) = (0.0, 0.0);
        for Fitted { value, variance } in fits {
            // Information that the fit adds to its prior.
            let own = 1.0 / variance - 1.0 / prior;
            if own <= 0.0 {
                continue;
            }
            let measured = (value / variance - self.mean / prior) / own;
            let weight = 1.0 / (1.0 / own + self.between_plates * self.between_plates);
            information += weight;
            sum += weight * (measured - self.mean).clamp(-1.0, 1.0);
        }
        let own = 1.0 / self.variance;
        self.mean += sum / (own + information);
        self.variance = 1.0 / (own + information) + self.drift * self.drift;
    }
}

/// How a camera's picture differs from the light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Imaging {
    /// Noise of a pixel, grey levels.
    pub(crate) noise: f32,
    blur_ln: Estimate,
    tone: Estimate,
    sharpening: Estimate,
    of_colour: bool,
}

/// The imaging as one fit has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ImagingReading {
    blur_ln: Fitted,
    tone: Fitted,
    sharpening: Fitted,
}

impl Imaging {
    pub(crate) fn new() -> Self {
        Self {
            noise: 0.0,
            blur_ln: BLUR,
            tone: TONE,
            sharpening: SHARPENING,
            of_colour: false,
        }
    }

    /// Estimated blur: standard deviation of the point spread, pixels.
    pub(crate) fn blur_px(&self) -> f32 {
        self.blur_ln.mean.exp()
    }

    /// Whether markers have shown it.
    pub(crate) fn is_known(&self) -> bool {
        self.tone.variance < KNOWN_TONE * KNOWN_TONE
    }

    /// Estimated tone curve.
    pub(crate) fn tone(&self) -> ToneCurve {
        ToneCurve::new(self.tone.mean)
    }

    /// The estimate for a projection of the colours in which the noise of a channel is `gain` times
    /// as large. Cameras blur colours more than brightness; the ratio varies and is not learned.
    pub(crate) fn of_colour(&self, gain: f32) -> Self {
        Self {
            noise: CHANNEL_NOISE * gain * self.noise,
            blur_ln: Estimate {
                mean: self.blur_ln.mean + COLOUR_BLUR.0.ln(),
                variance: COLOUR_BLUR.1 * COLOUR_BLUR.1,
                ..self.blur_ln
            },
            tone: Estimate {
                mean: 1.0,
                variance: COLOUR_TONE_SIGMA * COLOUR_TONE_SIGMA,
                ..self.tone
            },
            sharpening: Estimate {
                mean: 0.0,
                variance: 0.0,
                ..self.sharpening
            },
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
            blur_ln_sigma: self.blur_ln.prior_variance().sqrt(),
            plate_ln_sigma,
            tone: self.tone.mean,
            tone_sigma: self.tone.prior_variance().sqrt(),
            sharpening: self.sharpening.mean,
            sharpening_sigma: self.sharpening.prior_variance().sqrt(),
            residual_ratio_max,
            may_be_covered: false,
        }
    }

    /// The camera's imaging according to a fit.
    pub(crate) fn reading(&self, fit: &Fit) -> Option<ImagingReading> {
        (!self.of_colour).then(|| ImagingReading {
            blur_ln: Fitted {
                value: fit.pose.blur_px.ln(),
                variance: fit.blur_ln_variance,
            },
            tone: Fitted {
                value: fit.tone,
                variance: fit.tone_variance,
            },
            sharpening: Fitted {
                value: fit.sharpening,
                variance: fit.sharpening_variance,
            },
        })
    }

    /// Updates the estimate from the fits of a frame, which all started from [`Self::prior`].
    pub(crate) fn learn(&mut self, readings: impl Iterator<Item = ImagingReading> + Clone) {
        self.blur_ln
            .learn(readings.clone().map(|reading| reading.blur_ln));
        self.tone
            .learn(readings.clone().map(|reading| reading.tone));
        self.sharpening
            .learn(readings.map(|reading| reading.sharpening));
    }
}
