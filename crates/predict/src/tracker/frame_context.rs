//! The data of one frame that all tracks share.

use crate::bounds::Bounds;
use crate::observation::Settings;

/// The current frame, as seen by a track.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrameContext<'a> {
    /// Time of the frame on the tracker's clock.
    pub(crate) time_ns: u64,
    /// Seconds since the previous frame.
    pub(crate) since_last_s: f64,
    pub(crate) bounds: Bounds,
    pub(crate) settings: &'a Settings,
}
