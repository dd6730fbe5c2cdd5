//! A V4L2 camera as a source: verifies the settings it accepted, and which of its buffers are valid
//! frames.
//!
//! `negotiation` has the rule for settings that the user does not specify. A request must be met
//! exactly, except for the rate; [`Camera::info`] returns the rate that the camera has chosen.
//! Interlaced frames are rejected: moving objects are torn in them.
//!
//! A buffer that is flagged as damaged, too short or not a complete JPEG image is skipped and
//! counted. Frames for which the driver had no buffer are detected by gaps in its count. Padding at
//! the end of rows is removed. The time of a frame is the kernel's stamp, or the time of dequeuing
//! if the driver's stamps are not on the monotonic clock.
//!
//! Exposure, gain, white balance and focus are locked at the start; for how and why, see
//! [`controls`].
//!
//! After an unplug or a driver stall, the same camera is reopened ([`Camera::resume`]) with the
//! same size, format, rate and controls, and frame numbers continue.
//!
//! # Deliberately absent
//!
//! Multi-planar capture, which only the camera interfaces of embedded boards use.

pub mod controls;
pub mod devices;
mod error;
mod identity;
mod locking;
mod negotiation;
mod numbers;
pub mod request;
mod rows;
mod session;
pub(crate) mod v4l2;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use crate::camera::controls::{ControlRequest, Controls, Written};
use crate::camera::error::call_error;
pub use crate::camera::error::{CameraError, Loss};
use crate::camera::identity::Identity;
use crate::camera::negotiation::{DEFAULT_RATE_HZ, negotiate, notes};
use crate::camera::numbers::Numbers;
pub use crate::camera::request::CameraRequest;
use crate::camera::session::{Session, Terms};
use crate::camera::v4l2::{Device, Ready};
use crate::clock::monotonic_ns;
use crate::image::frame::Frame;
use crate::run::slot::{Next, SourceInfo};

pub(crate) use crate::camera::error::open_error;
pub(crate) use crate::camera::identity::stable_names;

/// Timeout of one call of [`Camera::next`].
const WAIT: Duration = Duration::from_millis(100);
/// A camera that delivers nothing for this long has stalled. The slowest start observed is about
/// two seconds.
const STALL: Duration = Duration::from_secs(5);

/// Counts of frames that were not delivered.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames for which the driver had no buffer, or that were lost on the way to it.
    pub lost_by_driver: u64,
    /// Buffers that were damaged or too short.
    pub faulty: u64,
}

/// A camera with negotiated settings. It captures after it is started. Dropping it stops it and
/// restores its controls; it does not wait for a camera that is gone.
#[derive(Debug)]
pub struct Camera {
    identity: Identity,
    /// `None` while the camera is lost.
    session: Option<Session>,
    terms: Terms,
    info: SourceInfo,
    notes: Vec<String>,
    control_request: ControlRequest,
    /// State of the controls when they were locked.
    locked: Controls,
    /// Controls to restore.
    written: Written,
    numbers: Numbers,
    n_frames: u64,
    faulty: u64,
    /// Time of the last frame, or of the start.
    last_frame_ns: u64,
}

impl Camera {
    /// Opens a node such as `/dev/video0`, negotiates format, size and rate, and prevents other
    /// programs from capturing.
    ///
    /// # Errors
    ///
    /// [`CameraError`] if the node is not a camera, is not available now or does not offer what was
    /// requested.
    pub fn open(path: &Path, request: &CameraRequest) -> Result<Self, CameraError> {
        let device = Device::open(path).map_err(|source| open_error(path, source))?;
        let card = check_capture(&device, path)?;
        let name = format!("{} ({})", path.display(), card.name);
        // Checked again when the camera runs; impossible requests are rejected before anything else
        // happens.
        if let Err(reason) = Controls::read(&device).by_hand(&request.controls) {
            return Err(CameraError::Control { path: name, reason });
        }
        let (choice, offers) = negotiate(&device, &name, request)?;
        let mut terms = Terms {
            choice,
            is_size_fixed: request.size.is_some(),
            rate_hz: request.rate_hz.unwrap_or(DEFAULT_RATE_HZ),
        };
        let session = Session::new(device, &name, path, &terms)?;
        let info = SourceInfo {
            name,
            size: session.size,
            format: session.format,
            rate_hz: session.rate_hz,
            live: true,
            controls: None,
        };
        let notes = notes(&offers, request, session.size, session.rate_hz);
        terms.choice.size = session.size;
        terms.is_size_fixed = true;
        Ok(Self {
            identity: Identity::new(path, &card),
            session: Some(session),
            terms,
            info,
            notes,
            control_request: request.controls,
            locked: Controls::default(),
            written: Written::default(),
            numbers: Numbers::default(),
            n_frames: 0,
            faulty: 0,
            last_frame_ns: monotonic_ns(),
        })
    }

    /// Starts capturing and locks the controls. If automatics are on, they first run for a second,
    /// and those frames are discarded. Returns early if `stop` is set. The caller must consume
    /// frames immediately: otherwise they are outdated or lost.
    ///
    /// # Errors
    ///
    /// [`CameraError::Busy`] or [`CameraError::Call`] if the camera cannot start,
    /// [`CameraError::Control`] if it rejects a value given by the user, and those of
    /// [`Camera::next`].
    pub fn start(&mut self, stop: &AtomicBool) -> Result<(), CameraError> {
        self.start_stream()?;
        self.lock(stop)
    }

    fn start_stream(&mut self) -> Result<(), CameraError> {
        self.last_frame_ns = monotonic_ns();
        match &mut self.session {
            Some(session) => session
                .stream
                .start()
                .map_err(|failed| call_error(&self.info.name, &self.identity.given, failed)),
            None => Err(self.lost("it was not opened again".to_owned())),
        }
    }

    /// Makes one attempt to reopen a lost camera, at any node, with its previous format, size, rate
    /// and controls. Frames arrive from the next call of [`Camera::next`] on; their numbers
    /// continue.
    ///
    /// # Errors
    ///
    /// [`CameraError::Missing`] while it is not there, and any other error that prevents its use.
    /// The next attempt may succeed.
    pub fn resume(&mut self) -> Result<(), CameraError> {
        // Closed before it is opened again: a driver grants a camera to one user at a time.
        self.session = None;
        let (device, path) = self.identity.find()?;
        let session = Session::new(device, &self.info.name, &path, &self.terms)?;
        self.session = Some(session);
        self.lock_again();
        self.numbers.restart();
        let started = self.start_stream();
        if started.is_err() {
            self.session = None;
        }
        started
    }

    /// The negotiated settings. The rate is the one stated by the camera, not the requested one.
    /// The state of the controls is known after the start.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        self.info.clone()
    }

    /// Notes for the user on differences between the camera's mode and the requested one, one per
    /// line.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Counts of frames not delivered so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        Counters {
            lost_by_driver: self.numbers.lost,
            faulty: self.faulty,
        }
    }

    /// Waits up to 100 ms for a frame. Its sequence number also counts lost and damaged frames.
    ///
    /// # Errors
    ///
    /// [`CameraError::Lost`] if the camera was unplugged, its driver fails, or no usable frame has
    /// arrived for five seconds. It delivers nothing afterwards, unless [`Camera::resume`]
    /// succeeds.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Next, CameraError> {
        match self.try_next(frame) {
            Ok(true) => Ok(Next::Frame),
            Ok(false) => self.nothing(),
            Err(reason) => {
                self.session = None;
                Err(self.lost(reason))
            }
        }
    }

    /// Returns whether a frame arrived; an error is the reason why no more will arrive.
    fn try_next(&mut self, frame: &mut Frame) -> Result<bool, String> {
        let Some(session) = &mut self.session else {
            return Err("it was not opened again".to_owned());
        };
        let ready = session.stream.wait(WAIT).map_err(|e| e.to_string())?;
        if ready == Ready::No {
            return Ok(false);
        }
        let filled = match session.stream.take() {
            Ok(Some(filled)) => filled,
            Ok(None) if ready == Ready::Failed => return Err("it hung up".to_owned()),
            Ok(None) => return Ok(false),
            Err(error) => return Err(error.to_string()),
        };
        let now_ns = monotonic_ns();
        frame.sequence = self.numbers.next(filled.sequence);
        frame.stamp_ns = filled.stamp_ns.unwrap_or(now_ns);
        let is_whole = !filled.is_faulty && session.copy(&filled, &mut frame.bytes);
        session
            .stream
            .give_back(filled)
            .map_err(|failed| failed.source.to_string())?;
        if !is_whole {
            self.faulty += 1;
            return Ok(false);
        }
        frame.format = session.format;
        frame.full_range = session.full_range;
        frame.size = session.size;
        self.n_frames += 1;
        self.last_frame_ns = now_ns;
        Ok(true)
    }

    fn nothing(&mut self) -> Result<Next, CameraError> {
        let silent_ns = monotonic_ns().saturating_sub(self.last_frame_ns);
        if silent_ns < STALL.as_nanos() as u64 {
            return Ok(Next::Nothing);
        }
        self.session = None;
        Err(CameraError::Lost {
            loss: Loss::Stalled {
                path: self.info.name.clone(),
                seconds: STALL.as_secs(),
                n_frames: self.n_frames,
                faulty: self.faulty,
            },
        })
    }

    fn lost(&self, reason: String) -> CameraError {
        CameraError::Lost {
            loss: Loss::Gone {
                path: self.info.name.clone(),
                n_frames: self.n_frames,
                reason,
            },
        }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        if let Some(session) = &self.session {
            self.written.undo(session.stream.device());
        }
    }
}

/// What a node with these capabilities does instead of capturing video; `None` if it captures.
pub(crate) fn not_capturing(capabilities: u32) -> Option<&'static str> {
    if capabilities & v4l2::CAP_CAPTURE != 0 {
        return (capabilities & v4l2::CAP_STREAMING == 0).then_some("cannot stream");
    }
    Some(match capabilities {
        planes if planes & v4l2::CAP_CAPTURE_PLANES != 0 => {
            "delivers each plane in a buffer of its own, which is not supported"
        }
        output if output & v4l2::CAP_OUTPUT != 0 => "puts video out, and nothing sends to it yet",
        metadata if metadata & v4l2::CAP_METADATA != 0 => "delivers metadata, not pictures",
        _ => "does not capture video",
    })
}

/// The card of the device, if it captures video.
fn check_capture(device: &Device, path: &Path) -> Result<v4l2::Card, CameraError> {
    let path = path.display();
    let (name, what) = match device.card() {
        Ok(card) => match not_capturing(card.capabilities) {
            None => return Ok(card),
            Some(what) => (format!("{path} ({})", card.name), what),
        },
        // The kernel's answer for devices other than video.
        Err(_) => (path.to_string(), "is no video device"),
    };
    Err(CameraError::NotACamera { path: name, what })
}

/// The nodes `video0`, `video1` and so on of a folder, in numerical order.
pub(crate) fn nodes(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut nodes: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| {
            let name = entry.file_name();
            let number = name.to_str()?.strip_prefix("video")?.parse().ok()?;
            Some((number, entry.path()))
        })
        .collect();
    nodes.sort();
    nodes.into_iter().map(|(_, path)| path).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_are_no_cameras_say_what_to_do() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = |path: &Path| {
            let error = Camera::open(path, &CameraRequest::default()).expect_err("no camera");
            error.to_string()
        };
        for (path, part) in [
            (folder.path(), "not a camera but a file or folder"),
            (&folder.path().join("video7"), "no such camera"),
            (Path::new("/dev/null"), "is no video device"),
        ] {
            let error = error(path);
            assert!(error.starts_with(&path.display().to_string()), "{error}");
            assert!(error.contains(part), "{error}");
            assert!(error.contains("overcam devices"), "{error}");
        }
    }

    #[test]
    fn capabilities_say_what_a_node_does() {
        let streaming = v4l2::CAP_STREAMING;
        assert_eq!(not_capturing(v4l2::CAP_CAPTURE | streaming), None);
        for (capabilities, part) in [
            (v4l2::CAP_CAPTURE, "cannot stream"),
            (v4l2::CAP_METADATA | streaming, "metadata"),
            (0x2 | streaming, "puts video out"),
            (v4l2::CAP_CAPTURE_PLANES | streaming, "buffer of its own"),
            (0, "does not capture"),
        ] {
            let what = not_capturing(capabilities).expect("no capture");
            assert!(what.contains(part), "{what}");
        }
    }
}
