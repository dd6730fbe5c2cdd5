//! Where frames come from: one enum, because its members are known.

use std::fs::File;
use std::io::{BufReader, Stdin};
use std::path::{Path, PathBuf};

use imgproc::Size;

use crate::camera::{Camera, CameraError, Counters, Wish};
use crate::demo::{self, Demo};
use crate::frame::{Frame, Picture, PixelFormat};
use crate::pictures::{self, PictureError, Pictures};
use crate::provenance::Provenance;
use crate::replay::{Recording, ReplayError};
use crate::y4m::{Y4m, Y4mError};

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
}

/// What [`Source::next`] found.
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
    pub passed_over: bool,
    /// The picture of the empty floor that applies from this frame on, if it changes here. A source sets it where it knows
    /// the floor (the demo, a recording), the pipeline sets it when it has learned one.
    pub background: Option<Picture>,
    /// What was found in the frame.
    pub scene: Box<scene::Scene>,
}

impl Slot {
    /// A slot without a frame, to be filled by a source.
    #[must_use]
    pub fn empty() -> Self {
        Self {
            frame: Frame::empty(),
            passed_over: false,
            background: None,
            scene: Box::new(scene::Scene::EMPTY),
        }
    }
}

/// Frames of any origin.
pub enum Source {
    /// The synthetic floor.
    Demo(Box<Demo>),
    /// A V4L2 camera.
    Camera(Camera),
    /// A Y4M file.
    Y4mFile(Y4m<BufReader<File>>),
    /// Y4M on standard input.
    Y4mStdin(Y4m<BufReader<Stdin>>),
    /// A folder of pictures.
    Pictures(Pictures),
    /// An MCAP recording.
    Recording(Box<Recording>),
}

/// Why there are no frames, or no more.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// There is no such thing.
    #[error("{}: there is no such camera, file or folder; `overcam devices` lists the cameras", .0.display())]
    Missing(PathBuf),
    /// A file that is none of the known kinds.
    #[error("{}: not a source of frames; give a camera, an .mcap or .y4m file, a folder of pictures, or -", .0.display())]
    Unknown(PathBuf),
    /// From a camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// From a Y4M stream.
    #[error(transparent)]
    Y4m(#[from] Y4mError),
    /// From a folder of pictures.
    #[error(transparent)]
    Pictures(#[from] PictureError),
    /// From a recording.
    #[error(transparent)]
    Replay(#[from] ReplayError),
}

impl Source {
    /// Opens what `--device` names: `demo`, `-`, a camera's node, a file or a folder. The wish counts for cameras, its rate for folders
    /// of pictures and its size for the demo too.
    ///
    /// # Errors
    ///
    /// [`SourceError`] when it is not there or gives no frames.
    pub fn open(device: &str, wish: &Wish) -> Result<Self, SourceError> {
        if device == "demo" {
            return Ok(Self::Demo(Box::new(Demo::new(
                wish.size.unwrap_or(demo::NATURAL_SIZE),
            ))));
        }
        if device == "-" {
            return Ok(Self::Y4mStdin(Y4m::stdin()?));
        }
        let path = Path::new(device);
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match (path.metadata(), extension.as_deref()) {
            // A camera's own message says more than "missing": which cameras there are.
            (_, None) if path.starts_with("/dev") && !path.is_dir() => {
                Ok(Self::Camera(Camera::open(path, wish)?))
            }
            (Err(_), _) => Err(SourceError::Missing(path.to_owned())),
            (Ok(data), _) if data.is_dir() => {
                let rate_hz = wish.rate_hz.unwrap_or(pictures::DEFAULT_RATE_HZ);
                Ok(Self::Pictures(Pictures::open(path, rate_hz)?))
            }
            (Ok(_), Some("mcap")) => Ok(Self::Recording(Box::new(Recording::open(path)?))),
            (Ok(_), Some("y4m")) => Ok(Self::Y4mFile(Y4m::open(path)?)),
            (Ok(_), _) => Err(SourceError::Unknown(path.to_owned())),
        }
    }

    /// What is known of the frames.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        match self {
            Self::Demo(demo) => demo.info(),
            Self::Camera(camera) => camera.info(),
            Self::Y4mFile(y4m) => y4m.info(),
            Self::Y4mStdin(y4m) => y4m.info(),
            Self::Pictures(pictures) => pictures.info(),
            Self::Recording(recording) => recording.info(),
        }
    }

    /// How a recording was made; `None` for everything else.
    #[must_use]
    pub fn provenance(&self) -> Option<&Provenance> {
        match self {
            Self::Recording(recording) => Some(recording.provenance()),
            _ => None,
        }
    }

    /// What a camera lost; `None` for everything else.
    #[must_use]
    pub fn camera_counters(&self) -> Option<Counters> {
        match self {
            Self::Camera(camera) => Some(camera.counters()),
            _ => None,
        }
    }

    /// Fills the slot with the next frame. The slot's scene is left as it is.
    ///
    /// # Errors
    ///
    /// [`SourceError`] when the source broke off; it has no more frames then.
    pub fn next(&mut self, slot: &mut Slot) -> Result<Next, SourceError> {
        slot.passed_over = false;
        slot.background = None;
        Ok(match self {
            Self::Demo(demo) => demo.next(slot),
            Self::Camera(camera) => camera.next(&mut slot.frame)?,
            Self::Y4mFile(y4m) => y4m.next(&mut slot.frame)?,
            Self::Y4mStdin(y4m) => y4m.next(&mut slot.frame)?,
            Self::Pictures(pictures) => pictures.next(&mut slot.frame)?,
            Self::Recording(recording) => recording.next(slot)?,
        })
    }
}
