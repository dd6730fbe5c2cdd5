//! Illumination: its gain relative to the background, and whether it has just changed.
//!
//! Automatic exposure, white balance and lamps are all modelled as one factor per channel, fitted
//! to each frame. A jump of the factor is a change of illumination. Lamps are local, so some of the
//! change remains after the factor is applied, and looks like new objects. For a short time, only
//! objects that were there before the change are therefore reported.

use imgproc::difference::Gains;
use imgproc::light::channel_gain;

use crate::image::frame::Picture;
use crate::settings::frames_in;

/// Approximate number of sampled pixels.
const SAMPLES: usize = 8192;

/// The illumination has changed if the gain differs from the usual one by more than this factor.
const STEP: f32 = 1.06;

/// Below this gain the frame is too dark to detect anything.
const DARK: f32 = 0.12;

/// Time after a change of illumination during which new objects are withheld.
const SETTLE_S: f64 = 0.4;

/// Illumination that changes for longer than this is not a step; it flickers or is being dimmed.
const SETTLE_MAX_S: f64 = 1.5;

/// State of the illumination in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Light {
    /// Unchanged.
    Steady,
    /// Changed a short time ago.
    Changed {
        /// Frames left until new objects are reported again; 0 in the last of them.
        frames_left: u32,
    },
    /// Too dark.
    Dark,
}

/// Estimates the illumination of each frame.
#[derive(Debug)]
pub(crate) struct Illumination {
    pub(crate) gains: Gains,
    /// The gains when they do not jump.
    usual: [f32; 3],
    /// Frames during which new objects are withheld after a change.
    pub(crate) settle_frames: u32,
    settle_frames_max: u32,
    settling: u32,
    settled_after: u32,
    dark: bool,
}

impl Illumination {
    pub(crate) fn new(rate_hz: f64) -> Self {
        Self {
            gains: Gains::NONE,
            usual: [1.0; 3],
            settle_frames: frames_in(SETTLE_S, rate_hz),
            settle_frames_max: frames_in(SETTLE_MAX_S, rate_hz),
            settling: 0,
            settled_after: 0,
            dark: false,
        }
    }

    /// Fits the gains to a frame, where `covered` is 0.
    pub(crate) fn observe(
        &mut self,
        frame: &Picture,
        floor: &[Vec<u16>; 3],
        covered: &[u8],
    ) -> Light {
        let fitted = fit(frame, floor, covered, self.gains);
        let now = [fitted.red, fitted.green, fitted.blue];
        if now.iter().sum::<f32>() < 3.0 * DARK {
            self.dark = true;
            return Light::Dark;
        }
        self.gains = fitted;
        let stepped = now.iter().zip(self.usual).any(|(now, usual)| {
            let factor = now / usual.max(1e-3);
            !(1.0 / STEP..=STEP).contains(&factor)
        });
        if stepped {
            self.usual = now;
            self.settling = self.settle_frames;
        } else {
            for (usual, now) in self.usual.iter_mut().zip(now) {
                *usual += (now - *usual) / 8.0;
            }
        }
        // Same as before the dark: only the first frame has to settle, since its exposure may have
        // begun in the dark.
        if std::mem::take(&mut self.dark) {
            self.settling = self.settling.max(1);
        }
        if self.settling == 0 {
            self.settled_after = 0;
            return Light::Steady;
        }
        self.settling -= 1;
        self.settled_after += 1;
        if self.settled_after >= self.settle_frames_max {
            self.settling = 0;
        }
        Light::Changed {
            frames_left: self.settling,
        }
    }

    /// The background matches this illumination again: only this frame has to settle, since its
    /// exposure may have begun before the change.
    pub(crate) fn return_to(
        &mut self,
        frame: &Picture,
        floor: &[Vec<u16>; 3],
        covered: &[u8],
    ) -> Light {
        self.settling = 0;
        let fitted = fit(frame, floor, covered, self.gains);
        self.gains = fitted;
        self.usual = [fitted.red, fitted.green, fitted.blue];
        Light::Changed { frames_left: 0 }
    }
}

/// The factor of each channel between a frame and a background, where `covered` is 0; `unless` if
/// too few pixels are visible.
pub(crate) fn fit(frame: &Picture, floor: &[Vec<u16>; 3], covered: &[u8], unless: Gains) -> Gains {
    let stride = (frame.size.area() / SAMPLES).max(1) | 1;
    let of = |channel: &[u8], floor: &[u16], last: f32| {
        channel_gain(channel, floor, covered, stride).unwrap_or(last)
    };
    Gains {
        red: of(&frame.red, &floor[0], unless.red),
        green: of(&frame.green, &floor[1], unless.green),
        blue: of(&frame.blue, &floor[2], unless.blue),
    }
}
