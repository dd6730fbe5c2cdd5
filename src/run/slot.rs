//! What travels through the program with a frame, and what its source says of itself: plain data, known to everybody and
//! knowing nobody.

use imgproc::Size;

use crate::background::model::BackgroundModel;
use crate::image::frame::{Frame, PixelFormat};

/// What a source says about its frames before the first one.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceInfo {
    /// What a person would call it: the camera's name and node, a file's path, "demo floor".
    pub name: String,
    /// Size of every frame.
    pub size: Size,
    /// Layout of every frame.
    pub format: PixelFormat,
    /// Frames per second, where the source states it.
    pub rate_hz: Option<f64>,
    /// Frames come whether or not somebody takes them: the newest one wins, and one that finds no room is dropped.
    pub live: bool,
    /// At what a camera's exposure, gain, white balance and focus are locked, and which are not, for people to read. A
    /// recording has it from the camera that it was made with.
    pub controls: Option<String>,
}

/// What [`Source::next`](crate::source::Source::next) found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// A frame; the slot is filled.
    Frame,
    /// Nothing yet: look whether the program should stop, then ask again.
    Nothing,
    /// No more frames.
    End,
}

/// What travels through the program with a frame.
#[derive(Debug)]
pub struct Slot {
    /// The frame.
    pub frame: Frame,
    /// The frame was captured but not processed, because a newer one was there or its bytes were no picture.
    pub skipped: bool,
    /// The empty floor that applies from this frame on, if it changes here. A source sets it where it knows
    /// the floor (the demo, a recording), the pipeline sets it when it has learned one.
    pub background: Option<BackgroundModel>,
    /// The floor as it was kept true up to this frame, where the recorder has asked for it to begin a new file.
    pub floor_in_use: Option<BackgroundModel>,
    /// What was found in the frame.
    pub scene: Box<scene::Scene>,
}

impl Slot {
    /// A slot without a frame, to be filled by a source.
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
