//! Why a recording cannot be played, for people to read.

use std::io;
use std::path::PathBuf;

use imgproc::Size;
use mcap::McapError;

use crate::output::foxglove::image_message::ImageError;
use crate::output::mcap::provenance::ProvenanceError;
use crate::output::mcap::records::OpenError;

/// Why a recording cannot be opened or read on.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be opened.
    #[error("{} {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: OpenError,
    },
    /// The file is something else.
    #[error("{} is not an MCAP file; name a recording", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The system could not read on.
    #[error("{} cannot be read {after} ({source})", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Where.
        after: After,
        /// What the system says.
        source: io::Error,
    },
    /// The file stops where more should come.
    #[error("{0} ends in the middle {after}: its writer was stopped; `overcam recover {0} -o NEW` completes it", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Where.
        after: After,
    },
    /// The content is damaged.
    #[error("{0} is damaged {after} ({source}); `overcam recover {0} -o NEW` keeps what is readable", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        after: After,
        /// What the reader found.
        source: McapError,
    },
    /// The file says something about its making that cannot be read.
    #[error("{} cannot be replayed: {source}", path.display())]
    Provenance {
        /// The file.
        path: PathBuf,
        /// What.
        source: ProvenanceError,
    },
    /// A frame, or the background that comes with it, cannot be read.
    #[error("{} has an unusable image {after}, of {topic}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// The topic or attachment; of another program's file with its message type and encoding.
        topic: String,
        /// Where.
        after: After,
        /// Why.
        source: ImageError,
    },
    /// A picture has another size than those before it.
    #[error(
        "{} has an image of {}x{} pixels {after}, others have {}x{}; all must have one size", path.display(),
        found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Where.
        after: After,
        /// Size of this picture.
        found: Size,
        /// Size of the others.
        expected: Size,
    },
    /// Nothing to play.
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
    /// Too much to play.
    #[error("{} holds several image topics ({topics}); keep one of them (`mcap filter`)", path.display())]
    ManyImages {
        /// The file.
        path: PathBuf,
        /// The image topics.
        topics: String,
    },
    /// Images, and not one of them can be read.
    #[error("{}: none of its {count} images can be read; the first: {first}", path.display())]
    NoneReadable {
        /// The file.
        path: PathBuf,
        /// Images in it.
        count: u64,
        /// What is wrong with the first.
        first: Box<ReplayError>,
    },
    /// Images far behind those that belong after them.
    #[error("{} has images in so different an order than time that they do not fit into memory; sort it with `mcap sort`", path.display())]
    Disorder {
        /// The file.
        path: PathBuf,
    },
}

/// A place in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct After(
    /// Number of the last good frame.
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
