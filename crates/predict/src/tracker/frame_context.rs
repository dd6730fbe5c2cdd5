//! What is common to all tracks in one frame.

use crate::bounds::Walls;
use crate::observation::Settings;

/// The frame that a track lives through.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Now<'a> {
    /// Its moment on the tracker's clock.
    pub(crate) ns: u64,
    pub(crate) walls: Walls,
    pub(crate) settings: &'a Settings,
}
