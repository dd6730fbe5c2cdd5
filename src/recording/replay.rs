//! Replay: the frames of a recording, exactly as they were captured.
//!
//! A recording is read from its start to its end in bounded memory (a chunk and a frame), so that its length does not matter,
//! and it needs no index: one whose writer was killed replays up to its last whole chunk and then says so.
//!
//! What is restored: the bytes, layout and colour range of each frame as they were stored, its number, its time stamp to the
//! nanosecond, whether it was passed over, and the empty floor where it changes. With
//! [`Provenance`] that is all on which results depend. Results themselves are not read back:
//! they are computed again.
//!
//! A file that overcam did not write is played too if exactly one of its topics holds Foxglove images. Its time stamps count
//! from its first image, its frames from 0.
//!
//! Deliberately absent: seeking, other speeds, and other message types (ROS).

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read, Seek};
use std::path::{Path, PathBuf};

use foxglove::bytes::Bytes;
use mcap::McapError;
use mcap::records::{AttachmentHeader, Channel, MessageHeader, Record};
use mcap::sans_io::{SummaryReadEvent, SummaryReader};

use crate::floor::Floor;
use crate::frame::Frame;
use crate::recording::image_message::{ImageError, ImageSchema, decode_message};
use crate::recording::provenance::{
    self, BACKGROUND_NAME, Frames, METADATA_NAME, Provenance, ProvenanceError,
};
use crate::recording::records::{Chunks, OpenError, Records, RecordsError, open};
use crate::recording::topics::{FULL_RANGE_KEY, IMAGE_TOPIC, PASSED_OVER_TOPIC};
use crate::slot::{Next, Slot, SourceInfo};

use imgproc::Size;

/// A recording, or another MCAP file with images, as a source of frames.
pub struct Recording {
    reader: Reader,
    info: SourceInfo,
    /// The first frame, read on opening to learn its size and layout.
    first: Option<Image>,
}

/// One frame and what comes with it.
struct Image {
    frame: Frame,
    passed_over: bool,
    background: Option<Floor>,
}

struct Reader {
    path: PathBuf,
    records: Records<File>,
    provenance: Provenance,
    maker: Maker,
    schemas: HashMap<u16, ImageSchema>,
    channels: HashMap<u16, ImageChannel>,
    /// Number of the newest frame.
    newest: Option<u64>,
    ended: bool,
}

/// Who wrote the file, which decides how messages become frames.
enum Maker {
    /// Not known yet: no metadata and no channel so far.
    Unknown,
    Overcam(Frames),
    Other {
        topic: String,
        first_log_time_ns: Option<u64>,
    },
}

#[derive(Clone, Copy)]
struct ImageChannel {
    schema: ImageSchema,
    passed_over: bool,
    full_range: bool,
}

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
    #[error("{} has an unusable image {after}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
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
    /// Another program's file whose topics cannot be looked up.
    #[error("{0} was not written by overcam and has no index; `overcam recover {0} -o NEW` adds one", path.display())]
    NoIndex {
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

impl Recording {
    /// Opens a file and reads up to its first frame.
    ///
    /// # Errors
    ///
    /// [`ReplayError`] when there is no such file, when it is no recording, or when no whole frame can be read.
    pub fn open(path: &Path) -> Result<Self, ReplayError> {
        let file = open(path).map_err(|source| ReplayError::Open {
            path: path.to_owned(),
            source,
        })?;
        let mut reader = Reader {
            path: path.to_owned(),
            records: Records::new(file, Chunks::Unpacked),
            provenance: Provenance::default(),
            maker: Maker::Unknown,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            newest: None,
            ended: false,
        };
        let mut first = Image {
            frame: Frame::empty(),
            passed_over: false,
            background: None,
        };
        let found = reader.next(&mut first, None)?;
        let (size, format) = match &reader.maker {
            _ if found => (first.frame.size, first.frame.format),
            Maker::Overcam(frames) => (frames.size, frames.stored_format),
            Maker::Other { topic, .. } => {
                return Err(reader.no_images(format!("{topic} (without a message)")));
            }
            Maker::Unknown => return Err(reader.no_images("none".to_owned())),
        };
        let (rate_hz, controls) = match &reader.maker {
            Maker::Overcam(frames) => (frames.rate_hz, frames.controls.clone()),
            _ => (None, None),
        };
        Ok(Self {
            info: SourceInfo {
                name: path.display().to_string(),
                size,
                format,
                rate_hz,
                live: false,
                controls,
            },
            first: found.then_some(first),
            reader,
        })
    }

    /// What the file says about its frames.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        self.info.clone()
    }

    /// How the recording was made. Empty if overcam did not make it.
    #[must_use]
    pub fn provenance(&self) -> &Provenance {
        &self.reader.provenance
    }

    /// Fills a slot with the next frame, with the background if it changes there, and with whether the frame was passed over.
    /// The slot's scene stays as it is.
    ///
    /// # Errors
    ///
    /// [`ReplayError`] when the file cannot be read on; after that, [`Next::End`].
    pub fn next(&mut self, slot: &mut Slot) -> Result<Next, ReplayError> {
        let found = match self.first.take() {
            Some(first) => {
                slot.frame = first.frame;
                slot.passed_over = first.passed_over;
                slot.background = first.background;
                true
            }
            None => {
                let mut image = Image {
                    frame: std::mem::replace(&mut slot.frame, Frame::empty()),
                    passed_over: false,
                    background: None,
                };
                let result = self.reader.next(&mut image, Some(self.info.size));
                slot.frame = image.frame;
                slot.passed_over = image.passed_over;
                slot.background = image.background;
                result?
            }
        };
        Ok(if found { Next::Frame } else { Next::End })
    }
}

impl Reader {
    /// Reads up to the next frame; false when there is none.
    fn next(&mut self, image: &mut Image, size: Option<Size>) -> Result<bool, ReplayError> {
        if self.ended {
            return Ok(false);
        }
        // Whatever ends the loop below ends the recording, unless it is a frame.
        self.ended = true;
        image.background = None;
        while let Some(record) = self.records.next().map_err(|error| self.error(error))? {
            match record.parse().map_err(|error| self.error(error))? {
                Record::Metadata(metadata) if metadata.name == METADATA_NAME => {
                    let (frames, provenance) = provenance::from_metadata(&metadata.metadata)
                        .map_err(|error| self.provenance_error(error))?;
                    self.provenance = provenance;
                    self.maker = Maker::Overcam(frames);
                }
                Record::Attachment { header, data, .. } => {
                    self.take_attachment(&header, &data, image)?;
                }
                Record::Schema { header, .. } => {
                    if let Some(schema) = image_schema(&header.name, &header.encoding) {
                        self.schemas.insert(header.id, schema);
                    }
                }
                Record::Channel(channel) => self.add_channel(&channel)?,
                Record::Message { header, data } => {
                    if let Some(&channel) = self.channels.get(&header.channel_id) {
                        let message = record.content.slice_ref(&data);
                        self.take_frame(&header, message, channel, image, size)?;
                        self.ended = false;
                        return Ok(true);
                    }
                }
                // What follows is the index.
                Record::DataEnd(_) => break,
                _ => {}
            }
        }
        Ok(false)
    }

    fn take_attachment(
        &mut self,
        header: &AttachmentHeader,
        data: &[u8],
        image: &mut Image,
    ) -> Result<(), ReplayError> {
        if !matches!(self.maker, Maker::Overcam(_)) {
            return Ok(());
        }
        if header.name == BACKGROUND_NAME {
            let floor = Floor::from_png(data).map_err(|error| self.image_error(error.into()))?;
            image.background = Some(floor);
            return Ok(());
        }
        self.provenance
            .add_attachment(&header.name, data)
            .map_err(|error| self.provenance_error(error))
    }

    fn add_channel(&mut self, channel: &Channel) -> Result<(), ReplayError> {
        // A recording's metadata comes before all channels.
        if matches!(self.maker, Maker::Unknown) {
            self.maker = Maker::Other {
                topic: self.only_image_topic()?,
                first_log_time_ns: None,
            };
        }
        let is_wanted = match &self.maker {
            Maker::Other { topic, .. } => channel.topic == *topic,
            _ => [IMAGE_TOPIC, PASSED_OVER_TOPIC].contains(&channel.topic.as_str()),
        };
        let schema = self.schemas.get(&channel.schema_id);
        if let (true, Some(&schema)) = (is_wanted, schema) {
            let full_range = channel.metadata.get(FULL_RANGE_KEY);
            let image_channel = ImageChannel {
                schema,
                passed_over: channel.topic == PASSED_OVER_TOPIC,
                full_range: full_range.is_some_and(|value| value == "true"),
            };
            self.channels.insert(channel.id, image_channel);
        }
        Ok(())
    }

    fn take_frame(
        &mut self,
        header: &MessageHeader,
        message: Bytes,
        channel: ImageChannel,
        image: &mut Image,
        size: Option<Size>,
    ) -> Result<(), ReplayError> {
        let (stamp_ns, sequence, own_size) = match &mut self.maker {
            Maker::Overcam(frames) => (
                header.log_time.wrapping_sub(frames.wall_offset_ns),
                full_sequence(self.newest, header.sequence),
                Some(frames.size),
            ),
            Maker::Other {
                first_log_time_ns, ..
            } => (
                header
                    .log_time
                    .saturating_sub(*first_log_time_ns.get_or_insert(header.log_time)),
                self.newest.map_or(0, |newest| newest + 1),
                None,
            ),
            Maker::Unknown => unreachable!("a channel settles who made the file"),
        };
        let frame = &mut image.frame;
        decode_message(channel.schema, message, own_size, frame)
            .map_err(|source| self.image_error(source))?;
        let expected = own_size.or(size).unwrap_or(frame.size);
        let background_size = image.background.as_ref().map(|floor| floor.picture.size);
        for found in [Some(frame.size), background_size].into_iter().flatten() {
            if found != expected {
                return Err(ReplayError::Size {
                    path: self.path.clone(),
                    after: After(self.newest),
                    found,
                    expected,
                });
            }
        }
        frame.sequence = sequence;
        frame.stamp_ns = stamp_ns;
        frame.full_range = channel.full_range;
        image.passed_over = channel.passed_over;
        self.newest = Some(sequence);
        Ok(())
    }

    /// Looks up the image topic of a file that overcam did not write.
    fn only_image_topic(&self) -> Result<String, ReplayError> {
        let summary = read_summary(&self.path).ok().flatten();
        let Some(summary) = summary else {
            return Err(ReplayError::NoIndex {
                path: self.path.clone(),
            });
        };
        let mut topics: Vec<&str> = Vec::new();
        let mut image_topics: Vec<&str> = Vec::new();
        for channel in summary.channels.values() {
            topics.push(&channel.topic);
            let schema = channel.schema.as_ref();
            if schema.is_some_and(|schema| image_schema(&schema.name, &schema.encoding).is_some()) {
                image_topics.push(&channel.topic);
            }
        }
        for list in [&mut topics, &mut image_topics] {
            list.sort_unstable();
            list.dedup();
        }
        match image_topics[..] {
            [topic] => Ok(topic.to_owned()),
            [] => Err(self.no_images(topics.join(", "))),
            _ => Err(ReplayError::ManyImages {
                path: self.path.clone(),
                topics: image_topics.join(", "),
            }),
        }
    }

    fn no_images(&self, topics: String) -> ReplayError {
        ReplayError::NoImages {
            path: self.path.clone(),
            topics,
        }
    }

    fn error(&self, error: RecordsError) -> ReplayError {
        let path = self.path.clone();
        let after = After(self.newest);
        match error {
            RecordsError::File(source) => ReplayError::Read {
                path,
                after,
                source,
            },
            RecordsError::NotMcap => ReplayError::NotMcap { path },
            RecordsError::Truncated => ReplayError::Truncated { path, after },
            RecordsError::Damaged(source) => ReplayError::Damaged {
                path,
                after,
                source,
            },
        }
    }

    fn image_error(&self, source: ImageError) -> ReplayError {
        ReplayError::Image {
            path: self.path.clone(),
            after: After(self.newest),
            source,
        }
    }

    fn provenance_error(&self, source: ProvenanceError) -> ReplayError {
        ReplayError::Provenance {
            path: self.path.clone(),
            source,
        }
    }
}

/// The message type of a topic, if it is one that can be played.
pub(crate) fn image_schema(name: &str, encoding: &str) -> Option<ImageSchema> {
    match (name, encoding) {
        ("foxglove.RawImage", "protobuf") => Some(ImageSchema::Raw),
        ("foxglove.CompressedImage", "protobuf") => Some(ImageSchema::Compressed),
        _ => None,
    }
}

/// The number of a frame from its low 32 bits: the next one with these bits after the newest.
fn full_sequence(newest: Option<u64>, low_bits: u32) -> u64 {
    newest.map_or(u64::from(low_bits), |newest| {
        newest.wrapping_add(u64::from(low_bits.wrapping_sub(newest as u32)))
    })
}

fn read_summary(path: &Path) -> Result<Option<mcap::Summary>, McapError> {
    let mut file = File::open(path)?;
    let mut reader = SummaryReader::new();
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(n_bytes) => {
                let n_read = file.read(reader.insert(n_bytes))?;
                reader.notify_read(n_read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    Ok(reader.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_numbers_go_on_beyond_32_bits() {
        let top = u64::from(u32::MAX);
        assert_eq!(full_sequence(None, 5), 5);
        assert_eq!(full_sequence(Some(5), 6), 6);
        assert_eq!(full_sequence(Some(top), 0), top + 1);
        assert_eq!(full_sequence(Some(top - 1), 3), top + 4);
        assert_eq!(full_sequence(Some(5 * (top + 1) + 7), 9), 5 * (top + 1) + 9);
    }
}
