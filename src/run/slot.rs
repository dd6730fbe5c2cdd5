//! Plain data passed between the threads with each frame, and information about the source. Depends
//! on no other part of the program.

use imgproc::Size;

use crate::background::model::BackgroundModel;
use crate::image::frame::{Frame, PixelFormat};

/// Information about a source before its first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceInfo {
    /// Name for the user: the camera's name and node, a file's path, "demo floor".
    pub name: String,
    /// Size of every frame.
    pub size: Size,
    /// Layout of every frame.
    pub format: PixelFormat,
    /// Frames per second, if the source states it.
    pub rate_hz: Option<f64>,
    /// Frames arrive whether or not they are consumed: the newest one is used, and one without a
    /// free slot is dropped.
    pub live: bool,
    /// The locked values of a camera's exposure, gain, white balance and focus, and which are not
    /// locked, as text. A recording has it from its camera.
    pub controls: Option<String>,
}

/// Result of [`Source::next`](crate::source::Source::next).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// A frame; the slot is filled.
    Frame,
    /// Nothing yet: check whether to stop, then call again.
    Nothing,
    /// No more frames.
    End,
}

/// The data passed between the threads for each frame.
#[derive(Debug)]
pub struct Slot {
    /// The frame.
    pub frame: Frame,
    /// The frame was captured but not processed, because there was a newer one or it could not be
    /// decoded.
    pub skipped: bool,
    /// The background that applies from this frame on, if it changes here. A source sets it if it
    /// knows the floor (the demo, a recording); the pipeline sets it after learning one.
    pub background: Option<BackgroundModel>,
    /// The background with all updates up to this frame, if the recorder has requested it to start
    /// a new file.
    pub floor_in_use: Option<BackgroundModel>,
    /// Result of processing the frame.
    pub scene: Box<scene::Scene>,
}

impl Slot {
    /// An empty slot, to be filled by a source.
    #[must_use]
    pub fn empty() -> Self {
        Self {
            frame: Frame::empty(),
            skipped: false,
            background: None,
            floor_in_use: None,
            scene: Box::new(scene::Scene::EMPTY),
        }
    }
}
