//! Where frames come from: one enum, because its members are known. `kind` tells what a path leads to by what is there, not by its
//! name.
//!
//! [`camera`](crate::camera) captures from a V4L2 device, [`y4m`] and [`folder`] read files, [`replay`] reads recordings and `foreign` what
//! other programs recorded, and [`demo`] is the synthetic floor that `render` draws. `combing` tells interlaced frames, `damaged` counts
//! pictures that cannot be read.

mod combing;
pub(crate) mod damaged;
pub mod demo;
pub mod folder;
pub(crate) mod foreign;
mod kind;
mod render;
pub mod replay;
pub mod y4m;

use std::fs::File;
use std::io::{self, BufReader, Stdin};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use crate::camera::{Camera, CameraError, CameraRequest, Counters};
use crate::output::mcap::provenance::Provenance;
use crate::run::slot::{Next, Slot, SourceInfo};
use crate::source::demo::Demo;
use crate::source::folder::{FolderError, Pictures};
use crate::source::kind::Kind;
use crate::source::replay::{Recording, ReplayError};
use crate::source::y4m::{Y4m, Y4mError};

/// Frames of any origin.
pub enum Source {
    /// The synthetic floor.
    Demo(Box<Demo>),
    /// A V4L2 camera.
    Camera(Box<Camera>),
    /// A Y4M file, or a named pipe with such a stream.
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
    /// It is there, but the system does not let it be looked at.
    #[error("{}: cannot be opened: {source}", path.display())]
    Closed {
        /// What `--device` names.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Something that is none of the known kinds.
    #[error("{}: {what}", path.display())]
    Unknown {
        /// What `--device` names.
        path: PathBuf,
        /// What it is, and what to do.
        what: String,
    },
    /// An argument that says something of a camera, or of a folder of pictures, to which it does not apply.
    #[error("{device}: {flag} does not apply to {kind}: leave it out")]
    Argument {
        /// What `--device` names.
        device: String,
        /// The argument.
        flag: &'static str,
        /// What the source is.
        kind: &'static str,
    },
    /// From a camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// From a Y4M stream.
    #[error(transparent)]
    Y4m(#[from] Y4mError),
    /// From a folder of pictures.
    #[error(transparent)]
    Pictures(#[from] FolderError),
    /// From a recording.
    #[error(transparent)]
    Replay(#[from] ReplayError),
}

impl SourceError {
    /// Whether there is no camera where it was looked for.
    #[must_use]
    pub fn is_missing_camera(&self) -> bool {
        matches!(self, Self::Camera(CameraError::Missing { .. }))
    }
}

/// Whether a recording is at this path; only its first bytes are read.
pub(crate) fn is_recording(device: &str) -> bool {
    matches!(kind::of(Path::new(device)), Ok(Kind::Recording))
}

impl Source {
    /// Opens what `--device` names: `demo`, `-`, a camera's node, a file, a pipe or a folder. What it is, its kind and its first bytes
    /// say. The wish is for cameras; its rate counts for folders of pictures and its size for the demo too.
    ///
    /// A named pipe is waited for until a program writes to it.
    ///
    /// # Errors
    ///
    /// [`SourceError`] when it is not there, gives no frames, or the request contains what does not apply to it.
    pub fn open(device: &str, request: &CameraRequest) -> Result<Self, SourceError> {
        let only = |flags: &[&str], kind: &'static str| {
            let stray = request.flags().find(|flag| !flags.contains(flag));
            stray.map_or(Ok(()), |flag| {
                let device = device.to_owned();
                Err(SourceError::Argument { device, flag, kind })
            })
        };
        if device == "demo" {
            only(&["--size"], "the demo")?;
            return Ok(Self::Demo(Box::new(Demo::new(
                request.size.unwrap_or(demo::NATURAL_SIZE),
            ))));
        }
        if device == "-" {
            only(&[], "Y4M on standard input")?;
            return Ok(Self::Y4mStdin(Y4m::stdin()?));
        }
        let path = Path::new(device);
        let kind = match kind::of(path) {
            Ok(kind) => kind,
            // A camera's own message says more: which cameras there are.
            Err(error) if error.kind() == io::ErrorKind::NotFound && path.starts_with("/dev") => {
                Kind::Device
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(SourceError::Missing(path.to_owned()));
            }
            Err(source) => {
                let path = path.to_owned();
                return Err(SourceError::Closed { path, source });
            }
        };
        match kind {
            Kind::Device => Ok(Self::Camera(Box::new(Camera::open(path, request)?))),
            Kind::Folder => {
                only(&["--rate"], "a folder of pictures")?;
                let rate_hz = request.rate_hz.unwrap_or(folder::DEFAULT_RATE_HZ);
                Ok(Self::Pictures(Pictures::open(path, rate_hz)?))
            }
            Kind::Recording => {
                only(&[], "a recording")?;
                Ok(Self::Recording(Box::new(Recording::open(path)?)))
            }
            Kind::Y4m => {
                only(&[], "a Y4M file")?;
                Ok(Self::Y4mFile(Y4m::open(path)?))
            }
            Kind::Pipe => {
                only(&[], "Y4M on a pipe")?;
                Ok(Self::Y4mFile(Y4m::open(path)?))
            }
            Kind::Other(what) => Err(SourceError::Unknown {
                path: path.to_owned(),
                what,
            }),
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

    /// What a camera lost, and what a camera, a folder or a recording had that is no whole picture; `None` for everything else.
    #[must_use]
    pub fn camera_counters(&self) -> Option<Counters> {
        let damaged = |faulty| Counters {
            lost_by_driver: 0,
            faulty,
        };
        match self {
            Self::Camera(camera) => Some(camera.counters()),
            Self::Pictures(pictures) => Some(damaged(pictures.n_damaged())),
            Self::Recording(recording) => Some(damaged(recording.n_damaged())),
            _ => None,
        }
    }

    /// How many of 16 bits the samples of a folder's pictures use; `None` where they have 8, and for everything else.
    #[must_use]
    pub fn n_bits(&self) -> Option<u8> {
        match self {
            Self::Pictures(pictures) => pictures.n_bits(),
            _ => None,
        }
    }

    /// What a person should know of what a camera gives instead of what was asked for, a line each.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        match self {
            Self::Camera(camera) => camera.notes(),
            _ => &[],
        }
    }

    /// Tries once to open a camera again that was lost, as it was before. Nothing else is ever lost.
    ///
    /// # Errors
    ///
    /// [`SourceError::Camera`] while that cannot be done.
    pub fn resume(&mut self) -> Result<(), SourceError> {
        match self {
            Self::Camera(camera) => Ok(camera.resume()?),
            _ => Ok(()),
        }
    }

    /// Starts a camera and locks its controls, which takes a second at most unless `stop` is set; it runs from then on. All
    /// other sources wait for whoever takes their frames.
    ///
    /// # Errors
    ///
    /// [`SourceError::Camera`] when it cannot start.
    pub fn start(&mut self, stop: &AtomicBool) -> Result<(), SourceError> {
        match self {
            Self::Camera(camera) => Ok(camera.start(stop)?),
            _ => Ok(()),
        }
    }

    /// Fills the slot with the next frame. The slot's scene is left as it is.
    ///
    /// # Errors
    ///
    /// [`SourceError`] when the source broke off; it has no more frames then.
    pub fn next(&mut self, slot: &mut Slot) -> Result<Next, SourceError> {
        slot.skipped = false;
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
