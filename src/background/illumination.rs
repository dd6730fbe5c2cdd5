//! What the light does: its gain over the floor's picture, and whether it has just changed.
//!
//! A camera's automatic exposure, its white balance, and lamps all end up as one factor a channel, fitted to each frame anew.
//! When the factor jumps, the light has changed: what is left of the change after the factor, because lamps hang somewhere,
//! looks like objects that were not there before. For a moment only those objects count that were there before it.

use imgproc::difference::Gains;
use imgproc::light::channel_gain;

use crate::image::frame::Picture;
use crate::settings::frames_in;

/// About this many pixels are looked at.
const SAMPLES: usize = 8192;

/// A gain that differs by more than this factor from the usual one is another light.
const STEP: f32 = 1.06;

/// Below this gain the frame is too dark to see anything in.
const DARK: f32 = 0.12;

/// Time for which new objects are withheld after a change of the light.
const SETTLE_S: f64 = 0.4;

/// A light that changes for longer than this does not step; it flickers or is dimmed.
const SETTLE_MAX_S: f64 = 1.5;

/// What the light does in this frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Light {
    /// It is as it was.
    Steady,
    /// It has changed. So many frames are left until new objects count again.
    Changed {
        /// 0: the last one.
        frames_left: u32,
    },
    /// There is none.
    Dark,
}

/// The light from frame to frame.
#[derive(Debug)]
pub(crate) struct Illumination {
    pub(crate) gains: Gains,
    /// What it is when it does not jump.
    usual: [f32; 3],
    /// Frames that new objects are withheld after a change.
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

    /// Fits the light to a frame, where `covered` is 0.
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
        // As it was before the dark: nothing has to settle but the first frame, whose exposure may have begun in the dark.
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

    /// The light is one that the floor is now in again: nothing has to settle but this frame, whose exposure may have begun before.
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

/// The factor of each channel between a frame and a floor where `covered` is 0; `unless` too little is seen.
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
