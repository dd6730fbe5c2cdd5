//! One frame in, one scene out: the processing chain of the paper from image to forecast.
//!
//! A `View` finds the objects on the floor in a frame of its camera; the `World` turns them into
//! tracks and the scene. The pipeline owns all its memory, does not allocate for a frame in a raw
//! format, uses no clock, and gives the same scenes for the same frames, whatever its scratch
//! memory held before.

use imgproc::Size;

use crate::background::model::BackgroundModel;
use crate::background::region::Region;
use crate::geometry::calibration::Calibration;
use crate::image::frame::DecodeError;
use crate::marker::Family;
use crate::run::slot::Slot;
use crate::settings::Settings;
use crate::view::View;
use crate::world::World;

/// Assumed frames per second if the source does not give a rate.
const RATE_HZ: f64 = 30.0;

/// All processing between a frame and its scene.
#[derive(Debug)]
pub struct Pipeline {
    view: View,
    world: World,
}

/// The result of processing a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The frame was used to learn the empty floor; the slot's scene is unchanged.
    Learning,
    /// The slot's scene describes the frame.
    Scene,
}

impl Pipeline {
    /// A pipeline for frames of one size. `rate_hz` is the frame rate, if known.
    #[must_use]
    pub fn new(
        size: Size,
        rate_hz: Option<f64>,
        settings: Settings,
        family: Family,
        calibration: Option<Calibration>,
    ) -> Self {
        let names = family.names().map(str::to_owned).collect();
        let metres_per_px = calibration.as_ref().and_then(|calibration| {
            let [width, height] = [size.width as f64, size.height as f64];
            let middle = calibration.to_floor([(width - 1.0) / 2.0, (height - 1.0) / 2.0]);
            // The image centre may be beyond the horizon; the measured points are not.
            middle
                .map(|floor| floor.metres_per_px())
                .or_else(|| calibration.metres_per_px())
        });
        let rate_hz = rate_hz.unwrap_or(RATE_HZ);
        Self {
            world: World::new(size, rate_hz, &settings, metres_per_px, names),
            view: View::new(size, rate_hz, settings, family, calibration),
        }
    }

    /// Restricts detection to a region of the frames, or removes the restriction.
    ///
    /// # Panics
    ///
    /// If the size of the region differs from that of the frames.
    pub fn set_region(&mut self, region: Option<Region>) {
        self.view.set_region(region);
    }

    /// Learns the empty floor again from the next [`Settings::learn`] frames. The old background
    /// stays in use until the frame after them. If learning is already in progress, it continues.
    pub fn relearn(&mut self) {
        self.view.relearn();
    }

    /// Whether a background is being learned that is not yet in use.
    #[must_use]
    pub fn is_learning(&self) -> bool {
        self.view.is_learning()
    }

    /// While learning: the number of frames collected so far and the number needed.
    #[must_use]
    pub fn learning_progress(&self) -> Option<(u32, u32)> {
        self.view.learning_progress()
    }

    /// The current background, with all updates; `None` before there is one. Allocates.
    #[must_use]
    pub fn floor(&self) -> Option<BackgroundModel> {
        self.view.floor()
    }

    /// Processes the slot's frame. A background in the slot replaces the current one. A learned
    /// background is put into the slot of the first frame for which it is used.
    ///
    /// # Errors
    ///
    /// [`DecodeError`] if the frame cannot be decoded; the tracks are unchanged.
    ///
    /// # Panics
    ///
    /// If the size of the background differs from that of the frames.
    pub fn process(&mut self, slot: &mut Slot) -> Result<Outcome, DecodeError> {
        if self.view.take(&slot.frame, &mut slot.background)? {
            self.world.forget_floor();
        }
        let Some(seen) = self.view.look() else {
            return Ok(Outcome::Learning);
        };
        slot.scene.sequence = slot.frame.sequence;
        self.world
            .update(slot.frame.stamp_ns, &seen, &mut slot.scene);
        Ok(Outcome::Scene)
    }
}
