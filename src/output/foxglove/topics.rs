//! The topics of the Foxglove messages, and the messages of one scene. Independent of their
//! destination: a file ([`mcap`](crate::output::mcap)), or a socket.
//!
//! | topic | schema | content |
//! | --- | --- | --- |
//! | `/camera/image` | `RawImage` or `CompressedImage` | the processed frames |
//! | `/camera/passed_over` | the same | the frames that were captured but not processed |
//! | `/overcam/annotations` | `ImageAnnotations` | outlines, names, headings and forecasts |
//! | `/overcam/poses` | `PosesInFrame` | the markers read |
//! | `/overcam/robots`, `/overcam/obstacles` | `SceneUpdate` | the floor in 3D |
//! | `/overcam/forecasts` | `SceneUpdate` | forecasts on the floor in 3D |
//! | `/tf` | `FrameTransform` | the root of the coordinate frames, once |
//! | `/overcam/log` | `Log` | gaps in the sequence of frames |
//!
//! A frame's messages follow its image, with the frame's number (its low 32 bits) and its log time.

use foxglove::messages::{
    FrameTransform, ImageAnnotations, Log, PosesInFrame, SceneUpdate, Timestamp,
};
use foxglove::{Encode, Schema};
use nalgebra::Matrix3;
use scene::Scene;

use crate::output::foxglove::annotate;
use crate::output::foxglove::image_message::encode_message;

/// Topic of the processed frames.
pub const IMAGE_TOPIC: &str = "/camera/image";
/// Topic of the frames that were captured but not processed.
pub const PASSED_OVER_TOPIC: &str = "/camera/passed_over";

/// Topics other than those of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ResultTopic {
    Transform,
    Log,
    Annotations,
    Poses,
    Robots,
    Obstacles,
    Forecasts,
}

impl ResultTopic {
    /// In numerical order.
    pub(crate) const ALL: [Self; 7] = [
        Self::Transform,
        Self::Log,
        Self::Annotations,
        Self::Poses,
        Self::Robots,
        Self::Obstacles,
        Self::Forecasts,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Transform => "/tf",
            Self::Log => "/overcam/log",
            Self::Annotations => "/overcam/annotations",
            Self::Poses => "/overcam/poses",
            Self::Robots => "/overcam/robots",
            Self::Obstacles => "/overcam/obstacles",
            Self::Forecasts => "/overcam/forecasts",
        }
    }

    pub(crate) fn schema(self) -> Schema {
        match self {
            Self::Transform => schema_of::<FrameTransform>(),
            Self::Log => schema_of::<Log>(),
            Self::Annotations => schema_of::<ImageAnnotations>(),
            Self::Poses => schema_of::<PosesInFrame>(),
            Self::Robots | Self::Obstacles | Self::Forecasts => schema_of::<SceneUpdate>(),
        }
    }
}

/// Schema of a message type.
pub(crate) fn schema_of<T: Encode>() -> Schema {
    T::get_schema().expect("every Foxglove message has a schema")
}

/// Encodes the results of a frame, one message after another into `buffer`, and passes each to
/// `write`.
///
/// # Errors
///
/// The first error of `write`.
pub(crate) fn scene_messages<E>(
    scene: &Scene,
    now: Timestamp,
    image_from_floor: Option<&Matrix3<f64>>,
    buffer: &mut Vec<u8>,
    mut write: impl FnMut(ResultTopic, &[u8]) -> Result<(), E>,
) -> Result<(), E> {
    let annotations = annotate::image_annotations(scene, now, image_from_floor);
    encode_message(&annotations, buffer);
    write(ResultTopic::Annotations, buffer)?;
    encode_message(&annotate::poses(scene, now), buffer);
    write(ResultTopic::Poses, buffer)?;
    for (topic, update) in [
        (ResultTopic::Robots, annotate::robots(scene, now)),
        (ResultTopic::Obstacles, annotate::obstacles(scene, now)),
        (ResultTopic::Forecasts, annotate::forecasts(scene, now)),
    ] {
        encode_message(&update, buffer);
        write(topic, buffer)?;
    }
    Ok(())
}

/// Nanoseconds since 1970 as a Foxglove timestamp.
pub(crate) fn timestamp(log_time_ns: u64) -> Timestamp {
    let seconds = log_time_ns / 1_000_000_000;
    let rest_ns = (log_time_ns % 1_000_000_000) as u32;
    Timestamp::new(u32::try_from(seconds).unwrap_or(u32::MAX), rest_ns)
}
