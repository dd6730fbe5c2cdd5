//! The channels of a recording; writes the messages of a frame to them.

use std::collections::BTreeMap;

use foxglove::messages::{CompressedImage, RawImage, Timestamp};
use foxglove::{Encode, Schema};
use mcap::McapResult;
use mcap::records::MessageHeader;
use nalgebra::Matrix3;
use scene::Scene;

use crate::output::foxglove::image_message::{ImageSchema, encode_message};
use crate::output::foxglove::topics::{
    IMAGE_TOPIC, PASSED_OVER_TOPIC, ResultTopic, scene_messages, schema_of, timestamp,
};
use crate::output::mcap::Mcap;

/// Key of an image channel's metadata: whether luma and chroma use the full range.
pub(crate) const FULL_RANGE_KEY: &str = "full_range";

/// Encoding of all messages.
const ENCODING: &str = "protobuf";

/// Channels of the frames with one colour range.
#[derive(Clone, Copy)]
pub(super) struct ImageChannels {
    pub(super) processed: u16,
    pub(super) skipped: u16,
}

/// All other channels, in the order of [`ResultTopic::ALL`].
pub(super) struct ResultChannels([u16; ResultTopic::ALL.len()]);

/// Writes the messages of one frame, which differ only in channel and content.
pub(super) struct FrameWriter<'a> {
    mcap: &'a mut Mcap,
    header: MessageHeader,
    message: &'a mut Vec<u8>,
    /// Size of the messages so far, including the overhead of each.
    bytes: u64,
}

/// Overhead per message in a file: its header, and its entry in the index of the chunk.
const MESSAGE_OVERHEAD_BYTES: u64 = 64;

impl ImageChannels {
    /// Defines both at once, early in the file, so that no definition is lost if a later chunk is
    /// damaged.
    pub(super) fn add(mcap: &mut Mcap, schema: ImageSchema, full_range: bool) -> McapResult<Self> {
        let schema = match schema {
            ImageSchema::Raw => schema_of::<RawImage>(),
            ImageSchema::Compressed => schema_of::<CompressedImage>(),
        };
        let metadata = BTreeMap::from([(FULL_RANGE_KEY.to_owned(), full_range.to_string())]);
        Ok(Self {
            processed: add_channel(mcap, &schema, IMAGE_TOPIC, &metadata)?,
            skipped: add_channel(mcap, &schema, PASSED_OVER_TOPIC, &metadata)?,
        })
    }
}

impl ResultChannels {
    /// Defines all of them.
    pub(super) fn add(mcap: &mut Mcap) -> McapResult<Self> {
        let mut channels = [0; ResultTopic::ALL.len()];
        for (channel, topic) in channels.iter_mut().zip(ResultTopic::ALL) {
            *channel = add_channel(mcap, &topic.schema(), topic.name(), &BTreeMap::new())?;
        }
        Ok(Self(channels))
    }

    fn of(&self, topic: ResultTopic) -> u16 {
        self.0[topic as usize]
    }
}

impl<'a> FrameWriter<'a> {
    /// `message` holds an encoded message, or is scratch memory.
    pub(super) fn new(
        mcap: &'a mut Mcap,
        sequence: u64,
        log_time_ns: u64,
        message: &'a mut Vec<u8>,
    ) -> Self {
        Self {
            mcap,
            header: MessageHeader {
                channel_id: 0,
                // A reader extends the low bits: gaps of 2^32 frames do not occur.
                sequence: sequence as u32,
                log_time: log_time_ns,
                publish_time: log_time_ns,
            },
            message,
            bytes: 0,
        }
    }

    /// Uncompressed size of the messages so far, including the overhead of each.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Time stamp of the frame's messages.
    pub(super) fn timestamp(&self) -> Timestamp {
        timestamp(self.header.log_time)
    }

    /// Writes the message that is already encoded.
    pub(super) fn write_encoded(&mut self, channel: u16) -> McapResult<()> {
        self.bytes += write(self.mcap, &mut self.header, channel, self.message)?;
        Ok(())
    }

    /// Writes a message.
    pub(super) fn write<T: Encode>(
        &mut self,
        channels: &ResultChannels,
        topic: ResultTopic,
        message: &T,
    ) -> McapResult<()> {
        encode_message(message, self.message);
        self.write_encoded(channels.of(topic))
    }

    /// Writes the results of the frame.
    pub(super) fn write_scene(
        &mut self,
        channels: &ResultChannels,
        scene: &Scene,
        image_from_floor: Option<&Matrix3<f64>>,
    ) -> McapResult<()> {
        let now = self.timestamp();
        let (mcap, header, bytes) = (&mut *self.mcap, &mut self.header, &mut self.bytes);
        scene_messages(scene, now, image_from_floor, self.message, |topic, data| {
            *bytes += write(mcap, header, channels.of(topic), data)?;
            Ok(())
        })
    }
}

/// Returns the size of the message in the file.
fn write(
    mcap: &mut Mcap,
    header: &mut MessageHeader,
    channel: u16,
    data: &[u8],
) -> McapResult<u64> {
    header.channel_id = channel;
    mcap.write_to_known_channel(header, data)?;
    Ok(data.len() as u64 + MESSAGE_OVERHEAD_BYTES)
}

fn add_channel(
    mcap: &mut Mcap,
    schema: &Schema,
    topic: &str,
    metadata: &BTreeMap<String, String>,
) -> McapResult<u16> {
    let schema_id = mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?;
    mcap.add_channel(schema_id, topic, ENCODING, metadata)
}
