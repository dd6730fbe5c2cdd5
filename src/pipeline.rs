//! One frame in, one scene out: the chain of the paper from picture to forecast.
//!
//! A `View` finds what stands on the floor in a frame of its camera, the `World` makes tracks and the scene of it. The pipeline holds all
//! memory it needs, allocates nothing for a frame in a raw format, looks at no clock, and gives the same scene for the same
//! frames whatever its scratch memory held before.

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

/// Frames per second where a source does not say.
const RATE_HZ: f64 = 30.0;

/// Everything between a frame and its scene.
#[derive(Debug)]
pub struct Pipeline {
    view: View,
    world: World,
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It was used to learn the empty floor; the slot's scene is untouched.
    Learning,
    /// The slot's scene is what the frame shows.
    Scene,
}

impl Pipeline {
    /// A pipeline for frames of one size. `rate_hz` is the rate of the frames, where it is known.
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
            // The middle of the picture may be beyond the horizon; the measured points are not.
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

    /// Looks at this part of the frames only, or at all of them again.
    ///
    /// # Panics
    ///
    /// When the region has another size than the frames.
    pub fn set_region(&mut self, region: Option<Region>) {
        self.view.set_region(region);
    }

    /// Learns the empty floor anew from the next [`Settings::learn`] frames. The old one is used meanwhile; the new one applies from the frame
    /// after them on. Where one is being learned already, that one goes on.
    pub fn relearn(&mut self) {
        self.view.relearn();
    }

    /// Whether a floor is being learned that is not in use yet.
    #[must_use]
    pub fn is_learning(&self) -> bool {
        self.view.is_learning()
    }

    /// While frames are collected to learn a floor: how many there are so far, and how many are needed.
    #[must_use]
    pub fn learning_progress(&self) -> Option<(u32, u32)> {
        self.view.learning_progress()
    }

    /// The floor that is in use, up to date; `None` before one is known. Takes memory.
    #[must_use]
    pub fn floor(&self) -> Option<BackgroundModel> {
        self.view.floor()
    }

    /// Processes the slot's frame. A background in the slot replaces the one in use; one that was learned is put into the slot
    /// of the first frame that it is used for.
    ///
    /// # Errors
    ///
    /// [`DecodeError`] when the frame's bytes are no picture; the tracks are left as they were.
    ///
    /// # Panics
    ///
    /// When the background has another size than the frames.
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
