//! Why a camera cannot be used, or can no longer.

use std::io;
use std::path::Path;

use imgproc::Size;

use crate::camera::controls::ControlError;
use crate::camera::v4l2::FailedCall;
use crate::image::frame::PixelFormat;

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
    /// The camera delivers frames of two fields, half of its rows half a frame older than the other half.
    #[error(
        "{path}: delivers interlaced frames ({field}), in which all that moves is torn: switch the camera or its signal to \
         progressive (p, not i), or choose another --size"
    )]
    Interlaced {
        /// The node and its card.
        path: String,
        /// How the fields are arranged, in the kernel's words.
        field: &'static str,
    },
    /// The camera has stopped delivering frames. It may come back.
    #[error("{loss}: {}", loss.remedy())]
    Lost {
        /// How.
        loss: Loss,
    },
}

/// How a camera was lost while it ran.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Loss {
    /// It was unplugged or its driver gave up.
    #[error("{path}: the camera is gone after {n_frames} frames ({reason})")]
    Gone {
        /// The node and its card.
        path: String,
        /// Frames delivered before.
        n_frames: u64,
        /// What the system says.
        reason: String,
    },
    /// No usable frame has come for a while.
    #[error("{path}: no frame for {seconds} s, after {n_frames} frames and {faulty} damaged ones")]
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

impl Loss {
    fn remedy(&self) -> &'static str {
        match self {
            Self::Gone { .. } => "check its cable, then start again",
            Self::Stalled { .. } => "is something sending to it, and is its cable good?",
        }
    }
}

/// What opening a node as a device failed with.
pub(crate) fn open_error(path: &Path, source: io::Error) -> CameraError {
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
}

/// What a request to an open camera failed with.
pub(super) fn call_error(name: &str, path: &Path, failed: FailedCall) -> CameraError {
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
