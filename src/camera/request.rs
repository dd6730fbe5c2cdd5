//! User requests to a camera.

use imgproc::Size;

use crate::camera::controls::ControlRequest;
use crate::image::frame::PixelFormat;

/// Settings requested by the user. `None` leaves the choice to
/// [`Camera::open`](crate::camera::Camera::open).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraRequest {
    /// Size of the frames.
    pub size: Option<Size>,
    /// Frames per second; the camera uses the nearest possible rate.
    pub rate_hz: Option<f64>,
    /// Layout of the frames.
    pub format: Option<PixelFormat>,
    /// Exposure, gain, white balance and focus.
    pub controls: ControlRequest,
}

impl CameraRequest {
    /// Names of the arguments that were given.
    pub(crate) fn flags(&self) -> impl Iterator<Item = &'static str> {
        let given = [
            ("--size", self.size.is_some()),
            ("--rate", self.rate_hz.is_some()),
            ("--format", self.format.is_some()),
            ("--camera-auto", self.controls.camera_auto),
            ("--exposure", self.controls.exposure_us.is_some()),
            ("--gain", self.controls.gain.is_some()),
            ("--white-balance", self.controls.white_balance_k.is_some()),
            ("--focus", self.controls.focus.is_some()),
        ];
        let given = given.into_iter().filter(|&(_, is_given)| is_given);
        given.map(|(flag, _)| flag)
    }
}
