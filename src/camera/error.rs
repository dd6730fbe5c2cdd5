//! Errors of cameras.

use std::io;
use std::path::Path;

use imgproc::Size;

use crate::camera::controls::ControlError;
use crate::camera::v4l2::FailedCall;
use crate::image::frame::PixelFormat;

/// Reasons why a camera cannot be used, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The file does not exist.
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
    /// No permission to open the node.
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
    /// The node does not capture video, or not in a supported way.
    #[error("{path}: not a camera: it {what}: `overcam devices` lists the cameras")]
    NotACamera {
        /// The node and its card.
        path: String,
        /// What it does instead.
        what: &'static str,
    },
    /// The camera does not offer a supported format, or not the requested one.
    #[error("{path}: does not offer {requested}: it offers {offered}")]
    Format {
        /// The node and its card.
        path: String,
        /// The requested formats.
        requested: String,
        /// All the camera's formats.
        offered: String,
    },
    /// The camera does not offer the requested size.
    #[error("{path}: does not offer {}x{} pixels: it offers {offered}", size.width, size.height)]
    Size {
        /// The node and its card.
        path: String,
        /// The requested size.
        size: Size,
        /// The camera's sizes, or the one it would use.
        offered: String,
    },
    /// The driver states an impossible frame layout.
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
        /// Bytes from one row to the next.
        bytes_per_line: usize,
        /// Bytes of a buffer.
        size_image: usize,
    },
    /// A value given by the user cannot be used.
    #[error("{path}: {reason}")]
    Control {
        /// The node and its card.
        path: String,
        /// The value and the reason.
        reason: ControlError,
    },
    /// Another system call failed.
    #[error("{path}: {call} failed: {source}: unplug the camera and plug it in again")]
    Call {
        /// The node and its card.
        path: String,
        /// Name of the call.
        call: &'static str,
        /// Error of the system.
        source: io::Error,
    },
    /// The camera delivers interlaced frames, whose two fields are half a frame period apart.
    #[error(
        "{path}: delivers interlaced frames ({field}), in which all that moves is torn: switch the camera or its signal to \
         progressive (p, not i), or choose another --size"
    )]
    Interlaced {
        /// The node and its card.
        path: String,
        /// Arrangement of the fields, in the kernel's terms.
        field: &'static str,
    },
    /// The camera has stopped delivering frames. It may come back.
    #[error("{loss}: {}", loss.remedy())]
    Lost {
        /// The kind of loss.
        loss: Loss,
    },
}

/// How a running camera was lost.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Loss {
    /// It was unplugged or its driver failed.
    #[error("{path}: the camera is gone after {n_frames} frames ({reason})")]
    Gone {
        /// The node and its card.
        path: String,
        /// Frames delivered before.
        n_frames: u64,
        /// Error of the system.
        reason: String,
    },
    /// No usable frame has arrived for a while.
    #[error("{path}: no frame for {seconds} s, after {n_frames} frames and {faulty} damaged ones")]
    Stalled {
        /// The node and its card.
        path: String,
        /// Duration.
        seconds: u64,
        /// Frames delivered before.
        n_frames: u64,
        /// Damaged frames before and since.
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

/// The error for a node that cannot be opened as a device.
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

/// The error for a failed request to an open camera.
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
