//! Frame sources: one enum, because its members are known. `kind` recognises a path by its content,
//! not by its name.
//!
//! [`camera`](crate::camera) captures from a V4L2 device, [`y4m`] and [`folder`] read files,
//! [`replay`] reads recordings and `foreign` those of other programs, and [`demo`] is the synthetic
//! floor that `render` draws. `combing` detects interlaced frames, `damaged` counts images that
//! cannot be decoded.

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

/// A source of frames of any kind.
pub enum Source {
    /// The synthetic floor.
    Demo(Box<Demo>),
    /// A V4L2 camera.
    Camera(Box<Camera>),
    /// A Y4M file, or a named pipe with such a stream.
    Y4mFile(Y4m<BufReader<File>>),
    /// Y4M on standard input.
    Y4mStdin(Y4m<BufReader<Stdin>>),
    /// A folder of images.
    Pictures(Pictures),
    /// An MCAP recording.
    Recording(Box<Recording>),
}

/// Reasons why there are no frames, or no more.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The path does not exist.
    #[error("{}: there is no such camera, file or folder; `overcam devices` lists the cameras", .0.display())]
    Missing(PathBuf),
    /// It exists, but cannot be opened.
    #[error("{}: cannot be opened: {source}", path.display())]
    Closed {
        /// Argument of `--device`.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// None of the known kinds.
    #[error("{}: {what}", path.display())]
    Unknown {
        /// Argument of `--device`.
        path: PathBuf,
        /// What it is, and what to do.
        what: String,
    },
    /// An argument for cameras or image folders that does not apply to this source.
    #[error("{device}: {flag} does not apply to {kind}: leave it out")]
    Argument {
        /// Argument of `--device`.
        device: String,
        /// The argument.
        flag: &'static str,
        /// Kind of the source.
        kind: &'static str,
    },
    /// From a camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// From a Y4M stream.
    #[error(transparent)]
    Y4m(#[from] Y4mError),
    /// From a folder of images.
    #[error(transparent)]
    Pictures(#[from] FolderError),
    /// From a recording.
    #[error(transparent)]
    Replay(#[from] ReplayError),
}

impl SourceError {
    /// Whether the camera does not exist.
    #[must_use]
    pub fn is_missing_camera(&self) -> bool {
        matches!(self, Self::Camera(CameraError::Missing { .. }))
    }
}

/// Whether this path is a recording; reads only its first bytes.
pub(crate) fn is_recording(device: &str) -> bool {
    matches!(kind::of(Path::new(device)), Ok(Kind::Recording))
}

impl Source {
    /// Opens the argument of `--device`: `demo`, `-`, a camera's node, a file, a pipe or a folder.
    /// The kind is determined from the file type and its first bytes. The request is for cameras;
    /// its rate also applies to folders of images, and its size to the demo.
    ///
    /// For a named pipe, this waits until a program writes to it.
    ///
    /// # Errors
    ///
    /// [`SourceError`] if it does not exist, gives no frames, or the request contains settings that
    /// do not apply.
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
            // The message of the camera module also lists the existing cameras.
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

    /// Information about the frames.
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

    /// How a recording was made; `None` for other sources.
    #[must_use]
    pub fn provenance(&self) -> Option<&Provenance> {
        match self {
            Self::Recording(recording) => Some(recording.provenance()),
            _ => None,
        }
    }

    /// Counts of frames lost by a camera, and of incomplete images of a camera, a folder or a
    /// recording; `None` for other sources.
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

    /// Number of bits in use in samples of 16 bits in a folder's images; `None` if they have 8, and
    /// for other sources.
    #[must_use]
    pub fn n_bits(&self) -> Option<u8> {
        match self {
            Self::Pictures(pictures) => pictures.n_bits(),
            _ => None,
        }
    }

    /// Notes for the user on differences between a camera's mode and the requested one, one per
    /// line.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        match self {
            Self::Camera(camera) => camera.notes(),
            _ => &[],
        }
    }

    /// Makes one attempt to reopen a lost camera with its previous settings. Other sources are
    /// never lost.
    ///
    /// # Errors
    ///
    /// [`SourceError::Camera`] if it fails.
    pub fn resume(&mut self) -> Result<(), SourceError> {
        match self {
            Self::Camera(camera) => Ok(camera.resume()?),
            _ => Ok(()),
        }
    }

    /// Starts a camera and locks its controls, which takes at most a second unless `stop` is set;
    /// it runs from then on. All other sources deliver frames only on request.
    ///
    /// # Errors
    ///
    /// [`SourceError::Camera`] if it cannot start.
    pub fn start(&mut self, stop: &AtomicBool) -> Result<(), SourceError> {
        match self {
            Self::Camera(camera) => Ok(camera.start(stop)?),
            _ => Ok(()),
        }
    }

    /// Fills the slot with the next frame. The slot's scene is not changed.
    ///
    /// # Errors
    ///
    /// [`SourceError`] if the source failed; there are then no more frames.
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
