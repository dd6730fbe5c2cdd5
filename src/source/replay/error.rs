//! Reasons why a recording cannot be played, as messages for the user.

use std::io;
use std::path::PathBuf;

use imgproc::Size;
use mcap::McapError;

use crate::output::foxglove::image_message::ImageError;
use crate::output::mcap::provenance::ProvenanceError;
use crate::output::mcap::records::OpenError;

/// Reasons why a recording cannot be opened or read further.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be opened.
    #[error("{} {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: OpenError,
    },
    /// The file is not an MCAP file.
    #[error("{} is not an MCAP file; name a recording", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// A read error of the system.
    #[error("{} cannot be read {after} ({source})", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Position.
        after: After,
        /// Error of the system.
        source: io::Error,
    },
    /// The file is truncated.
    #[error("{0} ends in the middle {after}: its writer was stopped; `overcam recover {0} -o NEW` completes it", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Position.
        after: After,
    },
    /// The content is damaged.
    #[error("{0} is damaged {after} ({source}); `overcam recover {0} -o NEW` keeps what is readable", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Position.
        after: After,
        /// Error of the reader.
        source: McapError,
    },
    /// The provenance in the file cannot be read.
    #[error("{} cannot be replayed: {source}", path.display())]
    Provenance {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: ProvenanceError,
    },
    /// A frame, or its background, cannot be decoded.
    #[error("{} has an unusable image {after}, of {topic}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// The topic or attachment; for another program's file with message type and encoding.
        topic: String,
        /// Position.
        after: After,
        /// The cause.
        source: ImageError,
    },
    /// The size of an image differs from that of earlier ones.
    #[error(
        "{} has an image of {}x{} pixels {after}, others have {}x{}; all must have one size", path.display(),
        found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Position.
        after: After,
        /// Size of this image.
        found: Size,
        /// Size of the others.
        expected: Size,
    },
    /// There are no playable images.
    #[error(
        "{} holds no images that overcam can play (foxglove.RawImage or foxglove.CompressedImage, protobuf); its topics: {topics}",
        path.display()
    )]
    NoImages {
        /// The file.
        path: PathBuf,
        /// All topics.
        topics: String,
    },
    /// There are several image topics.
    #[error("{} holds several image topics ({topics}); keep one of them (`mcap filter`)", path.display())]
    ManyImages {
        /// The file.
        path: PathBuf,
        /// The image topics.
        topics: String,
    },
    /// None of the images can be decoded.
    #[error("{}: none of its {count} images can be read; the first: {first}", path.display())]
    NoneReadable {
        /// The file.
        path: PathBuf,
        /// Number of images.
        count: u64,
        /// Error of the first.
        first: Box<ReplayError>,
    },
    /// Images are too far out of order.
    #[error("{} has images in so different an order than time that they do not fit into memory; sort it with `mcap sort`", path.display())]
    Disorder {
        /// The file.
        path: PathBuf,
    },
}

/// A position in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct After(
    /// Sequence number of the last good frame.
    pub Option<u64>,
);

impl std::fmt::Display for After {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            Some(sequence) => write!(f, "after frame {sequence}"),
            None => f.write_str("before its first frame"),
        }
    }
}
