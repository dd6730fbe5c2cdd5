//! A V4L2 camera as a source: whether it really gave what it was asked for, and which of its buffers are frames.
//!
//! What it is asked for when the user leaves that open: of the sizes, 640x480 or the nearest; 30 frames/s, and the first of
//! YUYV, UYVY, NV12, YU12, RGB3, MJPG that reaches them. A wish must be met exactly, except for the rate, of which
//! [`Camera::info`] says what the camera has chosen.
//!
//! A buffer that is flagged as damaged, too short or no whole JPEG picture is skipped and counted. Frames that the driver had
//! no buffer for are found by gaps in its count. Padding at the end of rows is removed. A frame's moment is the kernel's stamp,
//! or the moment at which the buffer is taken if the driver's stamps are not on the monotonic clock.
//!
//! Exposure, gain, white balance and focus are locked at the start: [`controls`](crate::source::controls) says how and why.
//!
//! # Deliberately absent
//!
//! Multi-planar capture, which only
//! camera interfaces of embedded boards have. Reconnection: a camera that was unplugged may have been moved, and the picture of
//! the empty floor would be wrong.

mod locking;
mod numbers;
mod rows;

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use imgproc::Size;

use crate::frame::{Frame, MAX_SIDE, PixelFormat};
use crate::jpeg;
use crate::slot::{Next, SourceInfo};
use crate::source::camera::numbers::Numbers;
use crate::source::camera::rows::rows;
use crate::source::controls::{ControlError, ControlWish, Controls, Written};
use crate::source::negotiation::{DEFAULT_RATE_HZ, interval, negotiate, text};
use crate::source::v4l2::{self, Device, FailedCall, Filled, Fraction, Ready, Stream};

/// Buffers asked for. With four, one can be copied and one filled while two wait for a thread that was not scheduled in time.
const N_BUFFERS: u32 = 4;
/// How long one call of [`Camera::next`] waits for a frame.
const WAIT: Duration = Duration::from_millis(100);
/// A camera that delivers nothing for so long has stalled. The slowest start seen is about two seconds.
const STALL: Duration = Duration::from_secs(5);

/// `V4L2_COLORSPACE_JPEG`, and `V4L2_QUANTIZATION_` as it is stated.
const COLORSPACE_JPEG: u32 = 7;
const QUANTIZATION_DEFAULT: u32 = 0;
const QUANTIZATION_FULL_RANGE: u32 = 1;

/// What the user wants of a camera. `None` leaves the choice to [`Camera::open`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Wish {
    /// Size of the frames.
    pub size: Option<Size>,
    /// Frames per second; the camera gives the nearest that it can.
    pub rate_hz: Option<f64>,
    /// Layout of the frames.
    pub format: Option<PixelFormat>,
    /// Exposure, gain, white balance and focus.
    pub controls: ControlWish,
}

impl Wish {
    /// Names of the arguments that it was made from.
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

/// What a camera delivered that did not become a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames that the driver had no buffer for, or that were lost on the way to it.
    pub lost_by_driver: u64,
    /// Buffers that were damaged or too short.
    pub faulty: u64,
}

/// Why a camera cannot be used, or can no longer.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// There is no such file.
    #[error("{path}: no such camera: `overcam devices` lists those that are there")]
    Missing {
        /// The node.
        path: String,
    },
    /// The file is not a device.
    #[error("{path}: not a camera but a file or folder: `overcam devices` lists the cameras")]
    NotADevice {
        /// The node.
        path: String,
    },
    /// The user may not open the node.
    #[error(
        "{path}: no permission: join the group that owns it \
         (`sudo usermod -aG video $USER`, then log in again)"
    )]
    Permission {
        /// The node.
        path: String,
    },
    /// Another program captures from the camera.
    #[error("{path}: in use by another program: end that one (`fuser {path}` names it)")]
    Busy {
        /// The node.
        path: String,
    },
    /// The node does not capture video, or not in a way that is read here.
    #[error("{path}: not a camera: it {what}: `overcam devices` lists the cameras")]
    NotACamera {
        /// The node and its card.
        path: String,
        /// What it does instead.
        what: &'static str,
    },
    /// The camera does not offer a format that is read here or the one that was wished.
    #[error("{path}: does not offer {wished}: it offers {offered}")]
    Format {
        /// The node and its card.
        path: String,
        /// What was looked for.
        wished: String,
        /// All the camera's formats.
        offered: String,
    },
    /// The camera does not offer the wished size.
    #[error("{path}: does not offer {}x{} pixels: it offers {offered}", size.width, size.height)]
    Size {
        /// The node and its card.
        path: String,
        /// What was wished.
        size: Size,
        /// The camera's sizes, or the one it would give.
        offered: String,
    },
    /// The driver states a layout of frames that cannot be.
    #[error(
        "{path}: its driver states {bytes_per_line} bytes a row and {size_image} a frame for \
         {}x{} pixels in {format:?}: try another format or size",
        size.width, size.height
    )]
    Layout {
        /// The node and its card.
        path: String,
        /// Format of the frames.
        format: PixelFormat,
        /// Size of the frames.
        size: Size,
        /// From one row to the next.
        bytes_per_line: usize,
        /// Of a buffer.
        size_image: usize,
    },
    /// A value that was given by hand cannot be had.
    #[error("{path}: {reason}")]
    Control {
        /// The node and its card.
        path: String,
        /// Which value, and why.
        reason: ControlError,
    },
    /// Another request failed.
    #[error("{path}: {call} failed: {source}: unplug the camera and plug it in again")]
    Call {
        /// The node and its card.
        path: String,
        /// Name of the request.
        call: &'static str,
        /// What the system says.
        source: io::Error,
    },
    /// The camera was unplugged or its driver gave up.
    #[error(
        "{path}: the camera is gone after {n_frames} frames ({source}): check its cable, then start again"
    )]
    Gone {
        /// The node and its card.
        path: String,
        /// Frames delivered before.
        n_frames: u64,
        /// What the system says.
        source: io::Error,
    },
    /// No usable frame has come for a while.
    #[error(
        "{path}: no frame for {seconds} s, after {n_frames} frames and {faulty} damaged ones: \
         is something sending to it, and is its cable good?"
    )]
    Stalled {
        /// The node and its card.
        path: String,
        /// How long.
        seconds: u64,
        /// Frames delivered before.
        n_frames: u64,
        /// Damaged ones before and since.
        faulty: u64,
    },
}

/// A camera and what was agreed on with it. It captures once it is started. Dropping it stops it and puts its controls back; a
/// camera that is gone is not waited for.
#[derive(Debug)]
pub struct Camera {
    stream: Stream,
    path: PathBuf,
    info: SourceInfo,
    control_wish: ControlWish,
    /// Controls that are to be put back.
    written: Written,
    full_range: bool,
    /// Bytes of the pixels within a buffer, row by row; none for JPEG.
    rows: Vec<Range<usize>>,
    numbers: Numbers,
    n_frames: u64,
    faulty: u64,
    /// When the last frame came, or the start.
    last_frame_ns: u64,
}

impl Camera {
    /// Opens a node such as `/dev/video0`, agrees on format, size and rate, and keeps other programs from capturing.
    ///
    /// # Errors
    ///
    /// [`CameraError`] when the node is no camera, cannot be used now or does not offer what is wished.
    pub fn open(path: &Path, wish: &Wish) -> Result<Self, CameraError> {
        let device = open_device(path)?;
        let (device, name) = check_capture(device, path)?;
        // Asked again when the camera runs; what cannot be had is refused before anything else happens.
        if let Err(reason) = Controls::read(&device).by_hand(&wish.controls) {
            return Err(CameraError::Control { path: name, reason });
        }
        let choice = negotiate(&device, &name, wish)?;
        let call_failed = |failed| call_error(&name, path, failed);
        let given = device
            .set_format(choice.fourcc, choice.size)
            .map_err(|source| {
                call_failed(FailedCall {
                    call: "VIDIOC_S_FMT",
                    source,
                })
            })?;
        let size = Size {
            width: given.width as usize,
            height: given.height as usize,
        };
        if given.pixel_format != choice.fourcc {
            return Err(CameraError::Format {
                path: name,
                wished: text(choice.fourcc),
                offered: format!("{} at this size", text(given.pixel_format)),
            });
        }
        let is_possible =
            (1..=MAX_SIDE).contains(&size.width) && (1..=MAX_SIDE).contains(&size.height);
        if wish.size.is_some_and(|wished| wished != size) || !is_possible {
            return Err(CameraError::Size {
                path: name,
                size: choice.size,
                offered: format!("{}x{}", size.width, size.height),
            });
        }
        let (bytes_per_line, size_image) =
            (given.bytes_per_line as usize, given.size_image as usize);
        let rows = rows(choice.format, size, bytes_per_line)
            .filter(|rows| rows.last().is_none_or(|last| last.end <= size_image))
            .ok_or_else(|| CameraError::Layout {
                path: name.clone(),
                format: choice.format,
                size,
                bytes_per_line,
                size_image,
            })?;
        let rate_hz = wish.rate_hz.unwrap_or(DEFAULT_RATE_HZ);
        let rate_hz = device
            .set_interval(interval(rate_hz))
            .map(Fraction::rate_hz);
        let stream = Stream::new(device, N_BUFFERS).map_err(call_failed)?;
        Ok(Self {
            stream,
            path: path.to_owned(),
            info: SourceInfo {
                name,
                size,
                format: choice.format,
                rate_hz,
                live: true,
                controls: None,
            },
            control_wish: wish.controls,
            written: Written::default(),
            full_range: match given.quantization {
                QUANTIZATION_DEFAULT => given.colorspace == COLORSPACE_JPEG,
                stated => stated == QUANTIZATION_FULL_RANGE,
            },
            rows,
            numbers: Numbers::default(),
            n_frames: 0,
            faulty: 0,
            last_frame_ns: v4l2::monotonic_ns(),
        })
    }

    /// Starts capturing and locks the controls; if automatics are on, they get a second of frames before, which is thrown
    /// away. Returns early when `stop` is set. Whoever starts takes the frames at once: what a camera delivers while nobody
    /// does is old or lost.
    ///
    /// # Errors
    ///
    /// [`CameraError::Busy`] or [`CameraError::Call`] when the camera cannot start, [`CameraError::Control`] when it refuses a
    /// value that was given by hand, and those of [`Camera::next`].
    pub fn start(&mut self, stop: &AtomicBool) -> Result<(), CameraError> {
        self.last_frame_ns = v4l2::monotonic_ns();
        self.stream
            .start()
            .map_err(|failed| call_error(&self.info.name, &self.path, failed))?;
        self.lock(stop)
    }

    /// What was agreed on. The rate is the one that the camera states, whatever was wished. What became of the controls is
    /// known once the camera is started.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        self.info.clone()
    }

    /// What did not become a frame so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        Counters {
            lost_by_driver: self.numbers.lost,
            faulty: self.faulty,
        }
    }

    /// Waits up to 100 ms for a frame. A frame's sequence number counts lost and damaged ones too.
    ///
    /// # Errors
    ///
    /// [`CameraError::Gone`] when the camera was unplugged, [`CameraError::Stalled`] when it has delivered nothing usable for
    /// five seconds, [`CameraError::Call`] when its driver fails otherwise. The camera delivers nothing afterwards.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Next, CameraError> {
        let ready = self.stream.wait(WAIT).map_err(|error| self.gone(error))?;
        if ready == Ready::No {
            return self.nothing();
        }
        let filled = match self.stream.take() {
            Ok(Some(filled)) => filled,
            Ok(None) if ready == Ready::Failed => {
                return Err(self.gone(io::Error::other("it hung up")));
            }
            Ok(None) => return self.nothing(),
            Err(error) => return Err(self.gone(error)),
        };
        let now_ns = v4l2::monotonic_ns();
        frame.sequence = self.numbers.next(filled.sequence);
        frame.stamp_ns = filled.stamp_ns.unwrap_or(now_ns);
        let is_whole = !filled.is_faulty && self.copy(&filled, &mut frame.bytes);
        self.stream
            .give_back(filled)
            .map_err(|failed| self.gone(failed.source))?;
        if !is_whole {
            self.faulty += 1;
            return self.nothing();
        }
        frame.format = self.info.format;
        frame.full_range = self.full_range;
        frame.size = self.info.size;
        self.n_frames += 1;
        self.last_frame_ns = now_ns;
        Ok(Next::Frame)
    }

    /// Copies the pixels of a buffer; `false` if they are not all there.
    fn copy(&self, filled: &Filled, bytes: &mut Vec<u8>) -> bool {
        bytes.clear();
        let Some(last) = self.rows.last() else {
            self.stream.append_to(filled, 0..filled.bytes_used, bytes);
            return jpeg::size(bytes) == Ok(self.info.size);
        };
        if filled.bytes_used < last.end {
            return false;
        }
        for row in &self.rows {
            self.stream.append_to(filled, row.clone(), bytes);
        }
        true
    }

    fn nothing(&self) -> Result<Next, CameraError> {
        let silent_ns = v4l2::monotonic_ns().saturating_sub(self.last_frame_ns);
        if silent_ns < STALL.as_nanos() as u64 {
            return Ok(Next::Nothing);
        }
        Err(CameraError::Stalled {
            path: self.info.name.clone(),
            seconds: STALL.as_secs(),
            n_frames: self.n_frames,
            faulty: self.faulty,
        })
    }

    fn gone(&self, source: io::Error) -> CameraError {
        CameraError::Gone {
            path: self.info.name.clone(),
            n_frames: self.n_frames,
            source,
        }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.written.undo(self.stream.device());
    }
}

/// What a node with these capabilities does instead of capturing video, if it does not.
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

pub(crate) fn open_device(path: &Path) -> Result<Device, CameraError> {
    Device::open(path).map_err(|source| {
        let path = path.display().to_string();
        match source.kind() {
            io::ErrorKind::NotFound => CameraError::Missing { path },
            io::ErrorKind::InvalidInput => CameraError::NotADevice { path },
            io::ErrorKind::PermissionDenied => CameraError::Permission { path },
            io::ErrorKind::ResourceBusy => CameraError::Busy { path },
            _ => CameraError::Call {
                path,
                call: "open",
                source,
            },
        }
    })
}

/// The device and its name, if it captures video.
fn check_capture(device: Device, path: &Path) -> Result<(Device, String), CameraError> {
    let path = path.display();
    let (name, what) = match device.card() {
        Ok(card) => {
            let name = format!("{path} ({})", card.name);
            (name, not_capturing(card.capabilities))
        }
        // The kernel's answer of anything that has nothing to do with video.
        Err(_) => (path.to_string(), Some("is no video device")),
    };
    match what {
        None => Ok((device, name)),
        Some(what) => Err(CameraError::NotACamera { path: name, what }),
    }
}

fn call_error(name: &str, path: &Path, failed: FailedCall) -> CameraError {
    match failed.source.kind() {
        io::ErrorKind::ResourceBusy => CameraError::Busy {
            path: path.display().to_string(),
        },
        _ => CameraError::Call {
            path: name.to_owned(),
            call: failed.call,
            source: failed.source,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_that_are_no_cameras_say_what_to_do() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = |path: &Path| {
            let error = Camera::open(path, &Wish::default()).expect_err("no camera");
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
