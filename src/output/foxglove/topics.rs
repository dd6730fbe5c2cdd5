//! The topics of a recording.
//!
//! | topic | schema | what |
//! | --- | --- | --- |
//! | `/camera/image` | `RawImage` or `CompressedImage` | the frames that were processed |
//! | `/camera/passed_over` | the same | the frames that were captured and not processed |
//! | `/overcam/annotations` | `ImageAnnotations` | outlines, names, headings and forecasts over the image |
//! | `/overcam/poses` | `PosesInFrame` | the markers seen |
//! | `/overcam/robots`, `/overcam/obstacles`, `/overcam/forecasts` | `SceneUpdate` | the floor in three dimensions |
//! | `/tf` | `FrameTransform` | the root of the frames of reference, once |
//! | `/overcam/log` | `Log` | gaps in the sequence of frames |
//!
//! A frame's messages follow its image, with the frame's number (its low 32 bits) and its log time.

use foxglove::Encode;
use foxglove::messages::{
    CompressedImage, FrameTransform, ImageAnnotations, Log, PosesInFrame, RawImage, SceneUpdate,
    Timestamp,
};
use mcap::McapResult;
use mcap::records::MessageHeader;
use nalgebra::Matrix3;
use scene::Scene;

use crate::output::foxglove::annotate;
use crate::output::foxglove::image_message::{ImageSchema, encode_message};
use crate::output::mcap::Mcap;

/// Topic of the frames that were processed.
pub const IMAGE_TOPIC: &str = "/camera/image";
/// Topic of the frames that were captured and not processed.
pub const PASSED_OVER_TOPIC: &str = "/camera/passed_over";
/// Key of an image channel's metadata: whether luma and chroma use the full range.
pub(crate) const FULL_RANGE_KEY: &str = "full_range";

/// Channels of the frames with one colour range.
#[derive(Clone, Copy)]
pub(crate) struct ImageChannels {
    pub(crate) processed: u16,
    pub(crate) skipped: u16,
}

/// Channels of everything else.
pub(crate) struct ResultChannels {
    pub(crate) transform: u16,
    pub(crate) log: u16,
    annotations: u16,
    poses: u16,
    robots: u16,
    obstacles: u16,
    forecasts: u16,
}

/// Writes the messages of one frame: they differ in channel and content only.
pub(crate) struct FrameWriter<'a> {
    mcap: &'a mut Mcap,
    header: MessageHeader,
    message: &'a mut Vec<u8>,
    /// Bytes of the messages so far, with what the file adds to each.
    bytes: u64,
}

/// What a file adds to a message: its header, and its entry in the index of the chunk.
const MESSAGE_OVERHEAD_BYTES: u64 = 64;

impl ImageChannels {
    /// Defines both at once, early in the file: damage to a later chunk then takes no definition with it.
    pub(crate) fn add(mcap: &mut Mcap, schema: ImageSchema, full_range: bool) -> McapResult<Self> {
        let metadata = || [(FULL_RANGE_KEY, full_range.to_string())];
        let mut add = |topic| match schema {
            ImageSchema::Raw => add_channel::<RawImage>(mcap, topic, metadata()),
            ImageSchema::Compressed => add_channel::<CompressedImage>(mcap, topic, metadata()),
        };
        Ok(Self {
            processed: add(IMAGE_TOPIC)?,
            skipped: add(PASSED_OVER_TOPIC)?,
        })
    }
}

impl ResultChannels {
    /// Defines all of them.
    pub(crate) fn add(mcap: &mut Mcap) -> McapResult<Self> {
        Ok(Self {
            transform: add_channel::<FrameTransform>(mcap, "/tf", [])?,
            log: add_channel::<Log>(mcap, "/overcam/log", [])?,
            annotations: add_channel::<ImageAnnotations>(mcap, "/overcam/annotations", [])?,
            poses: add_channel::<PosesInFrame>(mcap, "/overcam/poses", [])?,
            robots: add_channel::<SceneUpdate>(mcap, "/overcam/robots", [])?,
            obstacles: add_channel::<SceneUpdate>(mcap, "/overcam/obstacles", [])?,
            forecasts: add_channel::<SceneUpdate>(mcap, "/overcam/forecasts", [])?,
        })
    }
}

impl<'a> FrameWriter<'a> {
    /// `message` holds a message that is already encoded, or is scratch memory.
    pub(crate) fn new(
        mcap: &'a mut Mcap,
        sequence: u64,
        log_time_ns: u64,
        message: &'a mut Vec<u8>,
    ) -> Self {
        Self {
            mcap,
            header: MessageHeader {
                channel_id: 0,
                // A reader counts on from the low bits: gaps of 2^32 frames do not occur.
                sequence: sequence as u32,
                log_time: log_time_ns,
                publish_time: log_time_ns,
            },
            message,
            bytes: 0,
        }
    }

    /// Bytes of the messages so far, not compressed, with what the file adds to each.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Time stamp of the frame's messages.
    pub(crate) fn timestamp(&self) -> Timestamp {
        timestamp(self.header.log_time)
    }

    /// Writes a message.
    pub(crate) fn write<T: Encode>(&mut self, channel_id: u16, message: &T) -> McapResult<()> {
        encode_message(message, self.message);
        self.write_encoded(channel_id)
    }

    /// Writes the message that is already encoded.
    pub(crate) fn write_encoded(&mut self, channel_id: u16) -> McapResult<()> {
        self.bytes += self.message.len() as u64 + MESSAGE_OVERHEAD_BYTES;
        self.header.channel_id = channel_id;
        self.mcap.write_to_known_channel(&self.header, self.message)
    }

    /// Writes what was found in the frame.
    pub(crate) fn write_scene(
        &mut self,
        channels: &ResultChannels,
        scene: &Scene,
        image_from_floor: Option<&Matrix3<f64>>,
    ) -> McapResult<()> {
        let now = self.timestamp();
        let annotations = annotate::image_annotations(scene, now, image_from_floor);
        self.write(channels.annotations, &annotations)?;
        self.write(channels.poses, &annotate::poses(scene, now))?;
        self.write(channels.robots, &annotate::robots(scene, now))?;
        self.write(channels.obstacles, &annotate::obstacles(scene, now))?;
        self.write(channels.forecasts, &annotate::forecasts(scene, now))
    }
}

/// Nanoseconds since 1970 as Foxglove has them.
pub(crate) fn timestamp(log_time_ns: u64) -> Timestamp {
    let seconds = log_time_ns / 1_000_000_000;
    let rest_ns = (log_time_ns % 1_000_000_000) as u32;
    Timestamp::new(u32::try_from(seconds).unwrap_or(u32::MAX), rest_ns)
}

fn add_channel<T: Encode>(
    mcap: &mut Mcap,
    topic: &str,
    metadata: impl IntoIterator<Item = (&'static str, String)>,
) -> McapResult<u16> {
    let schema = T::get_schema().expect("every Foxglove message has a schema");
    let schema_id = mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?;
    let metadata = metadata
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect();
    mcap.add_channel(schema_id, topic, &T::get_message_encoding(), &metadata)
}
