//! The first second of a camera: its automatics settle and are switched off. For the rules and
//! their reasons see [`crate::camera::controls`].

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::camera::controls::{
    Attempt, Change, ControlError, Controls, brightness_jump, refused, state_folder,
};
use crate::camera::{Camera, CameraError, Numbers};
use crate::clock::monotonic_ns;
use crate::image::frame::{Frame, Picture, decode};
use crate::run::slot::Next;

/// Minimum settling time of the automatics, as a duration and a number of frames.
const SETTLING: (Duration, u32) = (Duration::from_secs(1), 8);
/// Delay before a change takes effect: cameras apply it a few frames later, and frames exposed
/// before are still queued.
const TAKING_EFFECT: (Duration, u32) = (Duration::from_millis(300), 6);

impl Camera {
    /// Writes the values given by the user to a camera that has just started, and locks the rest.
    /// Returns early if `stop` is set.
    pub(super) fn lock(&mut self, stop: &AtomicBool) -> Result<(), CameraError> {
        let request = self.control_request;
        let mut notes = self.take_over_state();
        let mut controls = self.read_controls();
        let by_hand = controls.by_hand(&request).map_err(|r| self.control(r))?;
        for &change in &by_hand {
            if let Err(error) = self.write_control(change) {
                return Err(self.control(refused(change, &request, error)));
            }
        }
        if !by_hand.is_empty() {
            controls = self.read_controls();
            controls
                .check_by_hand(&request)
                .map_err(|r| self.control(r))?;
        }
        let mut attempt = Attempt::default();
        let switch_off = controls.to_switch_off(&request);
        if !switch_off.is_empty() {
            if let Some(change) = controls.to_keep_rate(&switch_off) {
                // If a camera refuses this, the only effect is a longer exposure.
                _ = self.write_control(change);
            }
            let mut frame = Frame::empty();
            let Some(before) = self.brightness_after(SETTLING, stop, &mut frame)? else {
                return Ok(());
            };
            let found = self.read_controls();
            for change in switch_off {
                let result = self.write_control(change);
                attempt.switched.push((change, result));
            }
            for change in self.read_controls().to_put_back(&found, &request) {
                // The actual state is read and reported in any case.
                _ = self.write_control(change);
            }
            let Some(after) = self.brightness_after(TAKING_EFFECT, stop, &mut frame)? else {
                return Ok(());
            };
            attempt.undone_by = brightness_jump(before, after);
            if attempt.undone_by.is_some() {
                if let Some(session) = &self.session {
                    self.written.undo_brightness(session.stream.device());
                }
                self.brightness_after(SETTLING, stop, &mut frame)?;
            }
            self.forget_frames();
            controls = self.read_controls();
        }
        notes.insert(0, controls.report(&request, &attempt));
        self.info.controls = Some(notes.join("; "));
        self.locked = controls;
        Ok(())
    }

    /// Writes the locked values to a camera that was unplugged. [`Camera::info`] reports those it
    /// refuses.
    pub(super) fn lock_again(&mut self) {
        let mut refused: Vec<String> = Vec::new();
        // Values are writable only while automatics are off.
        for _ in 0..2 {
            for change in self.locked.to_set_again(&self.read_controls()) {
                if let Err(error) = self.write_control(change) {
                    refused.push(error.to_string());
                }
            }
        }
        if let (Some(first), Some(controls)) = (refused.first(), &mut self.info.controls) {
            *controls =
                format!("not all controls are as they were, the camera refuses them ({first})");
        }
    }

    /// Restores values left over from a killed program, and stores those that this one overwrites.
    /// Returns notes for the user.
    fn take_over_state(&mut self) -> Vec<String> {
        let camera = format!("{} {}", self.identity.card, self.identity.bus);
        let (Some(folder), Some(session)) = (state_folder(), &self.session) else {
            return Vec::new();
        };
        let kept = self
            .written
            .keep_in(&folder, &camera, session.stream.device());
        match kept {
            Ok(0) => Vec::new(),
            Ok(_) => {
                vec!["what an earlier run left locked was put back first".to_owned()]
            }
            Err(error) => vec![format!(
                "should overcam be killed, the next one cannot put these back, {}: {error}",
                folder.display()
            )],
        }
    }

    fn read_controls(&self) -> Controls {
        let session = self.session.as_ref();
        session.map_or_else(Controls::default, |session| {
            Controls::read(session.stream.device())
        })
    }

    fn write_control(&mut self, change: Change) -> io::Result<()> {
        match &self.session {
            Some(session) => self.written.write(session.stream.device(), change),
            None => Err(io::ErrorKind::NotConnected.into()),
        }
    }

    /// Discards frames for this duration and number, and returns the brightness of the last one
    /// (mean, 0 to 255); `None` if stopped.
    fn brightness_after(
        &mut self,
        (time, n_min): (Duration, u32),
        stop: &AtomicBool,
        frame: &mut Frame,
    ) -> Result<Option<f64>, CameraError> {
        let start_ns = monotonic_ns();
        let mut picture = Picture::new(self.info.size);
        let mut n = 0;
        while !stop.load(Ordering::Relaxed) {
            if self.next(frame)? != Next::Frame {
                continue;
            }
            n += 1;
            let is_over = monotonic_ns() - start_ns >= time.as_nanos() as u64;
            // If a frame cannot be decoded, the next one is used.
            if is_over && n >= n_min && decode(frame, &mut picture).is_ok() {
                return Ok(Some(mean(&picture)));
            }
        }
        Ok(None)
    }

    /// Resets the counts: earlier frames were not delivered.
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
