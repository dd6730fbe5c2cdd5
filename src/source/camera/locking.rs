//! The first second of a camera: its automatics find their values and are switched off. What is decided, and why, is in
//! [`crate::source::controls`].

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::frame::{Frame, Picture, decode};
use crate::slot::Next;
use crate::source::camera::{Camera, CameraError, Numbers};
use crate::source::controls::{Attempt, ControlError, Controls, brightness_jump, refused};
use crate::source::v4l2;

/// How long the automatics may look at the scene: at least so long, and so many frames.
const SETTLING: (Duration, u32) = (Duration::from_secs(1), 8);
/// How long until a change is seen: cameras apply it a few frames later, and frames exposed before are under way.
const TAKING_EFFECT: (Duration, u32) = (Duration::from_millis(300), 6);

impl Camera {
    /// Gives a camera that has just started what was given by hand and locks the rest. Returns early when `stop` is set.
    pub(super) fn lock(&mut self, stop: &AtomicBool) -> Result<(), CameraError> {
        let wish = self.control_wish;
        let mut controls = self.read_controls();
        let by_hand = controls.by_hand(&wish).map_err(|r| self.control(r))?;
        for &change in &by_hand {
            if let Err(error) = self.written.write(self.stream.device(), change) {
                return Err(self.control(refused(change, &wish, error)));
            }
        }
        if !by_hand.is_empty() {
            controls = self.read_controls();
            controls.check_by_hand(&wish).map_err(|r| self.control(r))?;
        }
        let mut attempt = Attempt::default();
        let switch_off = controls.to_switch_off(&wish);
        if !switch_off.is_empty() {
            if let Some(change) = controls.to_keep_rate(&switch_off) {
                // A camera that refuses this only gets a longer exposure.
                _ = self.written.write(self.stream.device(), change);
            }
            let mut frame = Frame::empty();
            let Some(before) = self.brightness_after(SETTLING, stop, &mut frame)? else {
                return Ok(());
            };
            let found = self.read_controls();
            for change in switch_off {
                let result = self.written.write(self.stream.device(), change);
                attempt.switched.push((change, result));
            }
            for change in self.read_controls().to_put_back(&found, &wish) {
                // What the camera has now is read and told in any case.
                _ = self.written.write(self.stream.device(), change);
            }
            let Some(after) = self.brightness_after(TAKING_EFFECT, stop, &mut frame)? else {
                return Ok(());
            };
            attempt.undone_by = brightness_jump(before, after);
            if attempt.undone_by.is_some() {
                let mut brightness = self.written.take_brightness();
                brightness.undo(self.stream.device());
                self.brightness_after(SETTLING, stop, &mut frame)?;
            }
            self.forget_frames();
            controls = self.read_controls();
        }
        self.info.controls = Some(controls.report(&wish, &attempt));
        Ok(())
    }

    fn read_controls(&self) -> Controls {
        Controls::read(self.stream.device())
    }

    /// Throws frames away for so long, and so many, and returns how bright the last one is (mean, of 255); `None` if stopped.
    fn brightness_after(
        &mut self,
        (time, n_least): (Duration, u32),
        stop: &AtomicBool,
        frame: &mut Frame,
    ) -> Result<Option<f64>, CameraError> {
        let start_ns = v4l2::monotonic_ns();
        let mut picture = Picture::new(self.info.size);
        let mut n = 0;
        while !stop.load(Ordering::Relaxed) {
            if self.next(frame)? != Next::Frame {
                continue;
            }
            n += 1;
            let is_over = v4l2::monotonic_ns() - start_ns >= time.as_nanos() as u64;
            // A frame that is no picture is followed by one that is.
            if is_over && n >= n_least && decode(frame, &mut picture).is_ok() {
                return Ok(Some(mean(&picture)));
            }
        }
        Ok(None)
    }

    /// Counts from here: what came before was not delivered.
    fn forget_frames(&mut self) {
        self.numbers = Numbers::default();
        self.n_frames = 0;
        self.faulty = 0;
    }

    fn control(&self, reason: ControlError) -> CameraError {
        CameraError::Control {
            path: self.info.name.clone(),
            reason,
        }
    }
}

/// Mean of all three planes.
fn mean(picture: &Picture) -> f64 {
    let planes = [&picture.red, &picture.green, &picture.blue];
    let sum: u64 = planes.into_iter().flatten().map(|&v| u64::from(v)).sum();
    sum as f64 / (3 * picture.size.area()) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use imgproc::Size;

    #[test]
    fn brightness_is_the_mean_of_all_planes() {
        let size = Size {
            width: 2,
            height: 1,
        };
        let picture = Picture {
            size,
            red: vec![255, 255],
            green: vec![0, 60],
            blue: vec![30, 0],
        };
        assert_eq!(mean(&picture), 100.0);
    }
}
