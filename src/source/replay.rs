//! Replay: the frames of a recording, exactly as they were captured.
//!
//! A recording is read sequentially in bounded memory (a chunk and a frame), so its length does not
//! matter. No index is needed: if the writer was killed, the recording is replayed up to the last
//! complete chunk, and then the truncation is reported.
//!
//! Restored for each frame: bytes, layout and colour range as stored, sequence number, time stamp
//! to the nanosecond, whether it was skipped, and the background where it changes. Together with
//! [`Provenance`] that is all that results depend on. Results are not read back but computed again.
//!
//! A file of another program is played too if exactly one of its topics has Foxglove images. Its
//! time stamps count from its first image, its frames from 0; for its times see `foreign`.
//!
//! An image that cannot be decoded is skipped, reported and counted, like a frame lost by a camera.
//! JPEG images of overcam's own recordings are not checked here: each one that gave a result when
//! it was recorded gives it again.
//!
//! Deliberately absent: seeking, other speeds, and other message types (ROS).

mod error;

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use foxglove::bytes::Bytes;
use mcap::records::{AttachmentHeader, Channel, MessageHeader, Record};

use crate::background::model::BackgroundModel;
use crate::image::frame::Frame;
use crate::output::foxglove::image_message::{
    ImageError, ImageSchema, Known, decode_message, image_schema,
};
use crate::output::foxglove::topics::{IMAGE_TOPIC, PASSED_OVER_TOPIC};
use crate::output::mcap::channels::FULL_RANGE_KEY;
use crate::output::mcap::provenance::{
    self, BACKGROUND_NAME, Frames, METADATA_NAME, Provenance, ProvenanceError,
};
use crate::output::mcap::records::{Chunks, Records, RecordsError, open};
use crate::run::slot::{Next, Slot, SourceInfo};
use crate::run::status::log;
use crate::source::damaged::Damaged;
use crate::source::foreign::{ClockStep, Order, survey};

use imgproc::Size;

/// Maximum number of bytes of images waiting for an earlier one.
const WAITING_BYTES_MAX: usize = 1 << 29;

/// Maximum number of clock steps reported individually.
const REPORTED_STEPS_MAX: usize = 5;

pub use error::{After, ReplayError};

/// A recording, or an MCAP file of another program with images, as a source of frames.
pub struct Recording {
    reader: Reader,
    info: SourceInfo,
    /// The first frame, read on opening for its size and layout.
    first: Option<Image>,
}

/// One frame and its data.
struct Image {
    frame: Frame,
    skipped: bool,
    background: Option<BackgroundModel>,
}

struct Reader {
    path: PathBuf,
    records: Records<File>,
    provenance: Provenance,
    maker: Maker,
    schemas: HashMap<u16, ImageSchema>,
    channels: HashMap<u16, ImageChannel>,
    known: Known,
    /// Sequence number of the newest frame.
    newest: Option<u64>,
    damaged: Damaged,
    /// Error of the first image that could not be decoded.
    first_damage: Option<ReplayError>,
    ended: bool,
}

/// The program that wrote the file, which determines how messages become frames.
enum Maker {
    /// Still unknown: no metadata and no channel so far.
    Unknown,
    Overcam(Frames),
    Other(Foreign),
}

/// State for the file of another program.
struct Foreign {
    /// The image topic with its message type and encoding.
    name: String,
    /// Its channels.
    channels: HashMap<u16, ImageSchema>,
    order: Order,
}

#[derive(Clone, Copy)]
struct ImageChannel {
    schema: ImageSchema,
    skipped: bool,
    full_range: bool,
}

impl Recording {
    /// Opens a file and reads up to its first frame.
    ///
    /// # Errors
    ///
    /// [`ReplayError`] if the file does not exist, is not a recording, or has no complete frame.
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
            known: Known::default(),
            newest: None,
            damaged: Damaged::default(),
            first_damage: None,
            ended: false,
        };
        let mut first = Image {
            frame: Frame::empty(),
            skipped: false,
            background: None,
        };
        let found = reader.next(&mut first, None)?;
        if !found && reader.first_damage.is_some() {
            return Err(reader.none_readable());
        }
        let (size, format) = match &reader.maker {
            _ if found => (first.frame.size, first.frame.format),
            Maker::Overcam(frames) => (frames.size, frames.stored_format),
            Maker::Other(_) => return Err(reader.none_readable()),
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

    /// Information about the frames.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        self.info.clone()
    }

    /// Number of damaged images so far.
    #[must_use]
    pub fn n_damaged(&self) -> u64 {
        self.reader.damaged.count
    }

    /// How the recording was made. Empty if another program made it.
    #[must_use]
    pub fn provenance(&self) -> &Provenance {
        &self.reader.provenance
    }

    /// Fills a slot with the next frame, the background if it changes there, and whether the frame
    /// was skipped. The slot's scene is not changed.
    ///
    /// # Errors
    ///
    /// [`ReplayError`] if reading fails; after that, [`Next::End`].
    pub fn next(&mut self, slot: &mut Slot) -> Result<Next, ReplayError> {
        let found = match self.first.take() {
            Some(first) => {
                slot.frame = first.frame;
                slot.skipped = first.skipped;
                slot.background = first.background;
                true
            }
            None => {
                let mut image = Image {
                    frame: std::mem::replace(&mut slot.frame, Frame::empty()),
                    skipped: false,
                    background: None,
                };
                let result = self.reader.next(&mut image, Some(self.info.size));
                slot.frame = image.frame;
                slot.skipped = image.skipped;
                slot.background = image.background;
                result?
            }
        };
        Ok(if found { Next::Frame } else { Next::End })
    }
}

impl Reader {
    /// Reads up to the next frame; returns false if there is none.
    fn next(&mut self, image: &mut Image, size: Option<Size>) -> Result<bool, ReplayError> {
        if self.ended {
            return Ok(false);
        }
        // Any exit from the loop below ends the recording, except a frame.
        self.ended = true;
        image.background = None;
        loop {
            if self.take_due(image, size)? {
                self.ended = false;
                return Ok(true);
            }
            let Some(record) = self.records.next().map_err(|error| self.error(error))? else {
                return Ok(false);
            };
            match record.parse().map_err(|error| self.error(error))? {
                Record::Metadata(metadata) if metadata.name == METADATA_NAME => {
                    let (frames, provenance) = provenance::from_metadata(&metadata.metadata)
                        .map_err(|error| self.provenance_error(error))?;
                    self.provenance = provenance;
                    self.known.jpeg_size = Some(frames.size);
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
                    let message = record.content.slice_ref(&data);
                    if self.take_message(&header, message, image)? {
                        self.ended = false;
                        return Ok(true);
                    }
                }
                // The index follows.
                Record::DataEnd(_) => return Ok(false),
                _ => {}
            }
        }
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
            let floor = BackgroundModel::from_png(data)
                .map_err(|error| self.image_error(header.name.clone(), error.into()))?;
            image.background = Some(floor);
            return Ok(());
        }
        self.provenance
            .add_attachment(&header.name, data)
            .map_err(|error| self.provenance_error(error))
    }

    fn add_channel(&mut self, channel: &Channel) -> Result<(), ReplayError> {
        // The metadata of an overcam recording precedes all channels.
        if matches!(self.maker, Maker::Unknown) {
            self.maker = Maker::Other(self.look_through()?);
        }
        let schema = self.schemas.get(&channel.schema_id);
        let is_wanted = [IMAGE_TOPIC, PASSED_OVER_TOPIC].contains(&channel.topic.as_str());
        if let (Maker::Overcam(_), true, Some(&schema)) = (&self.maker, is_wanted, schema) {
            let full_range = channel.metadata.get(FULL_RANGE_KEY);
            let image_channel = ImageChannel {
                schema,
                skipped: channel.topic == PASSED_OVER_TOPIC,
                full_range: full_range.is_some_and(|value| value == "true"),
            };
            self.channels.insert(channel.id, image_channel);
        }
        Ok(())
    }

    /// Processes a message; returns true if it became a frame. An image of another program is
    /// queued until its turn.
    fn take_message(
        &mut self,
        header: &MessageHeader,
        message: Bytes,
        image: &mut Image,
    ) -> Result<bool, ReplayError> {
        let frames = match &mut self.maker {
            Maker::Overcam(frames) => frames,
            Maker::Other(foreign) => {
                if let Some(&schema) = foreign.channels.get(&header.channel_id) {
                    foreign.order.add(schema, message);
                    if foreign.order.waiting_bytes() > WAITING_BYTES_MAX {
                        let path = self.path.clone();
                        return Err(ReplayError::Disorder { path });
                    }
                }
                return Ok(false);
            }
            Maker::Unknown => return Ok(false),
        };
        let Some(&channel) = self.channels.get(&header.channel_id) else {
            return Ok(false);
        };
        let sequence = full_sequence(self.newest, header.sequence);
        let stamp_ns = header.log_time.wrapping_sub(frames.wall_offset_ns);
        let expected = frames.size;
        let read = decode_message(channel.schema, message, &mut self.known, &mut image.frame);
        if let Err(source) = read {
            self.skip(
                if channel.skipped {
                    PASSED_OVER_TOPIC
                } else {
                    IMAGE_TOPIC
                }
                .to_owned(),
                source,
            );
            self.newest = Some(sequence);
            return Ok(false);
        }
        self.check_size(image, expected)?;
        image.frame.sequence = sequence;
        image.frame.stamp_ns = stamp_ns;
        image.frame.full_range = channel.full_range;
        image.skipped = channel.skipped;
        self.newest = Some(sequence);
        Ok(true)
    }

    /// Processes the queued images of another program whose turn has come, up to the first valid
    /// one; returns false if there is none yet.
    fn take_due(&mut self, image: &mut Image, size: Option<Size>) -> Result<bool, ReplayError> {
        while let Maker::Other(foreign) = &mut self.maker {
            let Some(due) = foreign.order.due() else {
                return Ok(false);
            };
            let frame = &mut image.frame;
            let read = decode_message(due.schema, due.message, &mut self.known, frame);
            if let Err(source) = read {
                let name = foreign.name.clone();
                self.skip(name, source);
                self.newest = Some(due.number);
                continue;
            }
            self.check_size(image, size.unwrap_or(image.frame.size))?;
            image.frame.sequence = due.number;
            image.frame.stamp_ns = due.stamp_ns;
            image.frame.full_range = false;
            image.skipped = false;
            self.newest = Some(due.number);
            return Ok(true);
        }
        Ok(false)
    }

    fn skip(&mut self, topic: String, source: ImageError) {
        let error = self.image_error(topic, source);
        self.damaged.skip(&error);
        self.first_damage.get_or_insert(error);
    }

    fn check_size(&self, image: &Image, expected: Size) -> Result<(), ReplayError> {
        let background_size = image.background.as_ref().map(|floor| floor.picture.size);
        for found in [Some(image.frame.size), background_size]
            .into_iter()
            .flatten()
        {
            if found != expected {
                return Err(ReplayError::Size {
                    path: self.path.clone(),
                    after: After(self.newest),
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// Makes the first pass over another program's file: finds the image messages and their times.
    fn look_through(&self) -> Result<Foreign, ReplayError> {
        let file = open(&self.path).map_err(|source| ReplayError::Open {
            path: self.path.clone(),
            source,
        })?;
        let survey =
            survey(Records::new(file, Chunks::Unpacked)).map_err(|error| self.error(error))?;
        let topic = match survey.image_topics()[..] {
            [topic] => topic.to_owned(),
            [] => return Err(self.no_images(survey.topics())),
            ref topics => {
                return Err(ReplayError::ManyImages {
                    path: self.path.clone(),
                    topics: topics.join(", "),
                });
            }
        };
        let (order, steps) = survey.order();
        self.report_steps(&steps);
        let of_topic = || survey.channels.iter().filter(|(_, c)| c.topic == topic);
        let name = of_topic().find(|(_, c)| c.image.is_some());
        Ok(Foreign {
            name: name.map_or(topic.clone(), |(_, channel)| channel.to_string()),
            channels: of_topic()
                .filter_map(|(&id, c)| Some((id, c.image?)))
                .collect(),
            order,
        })
    }

    fn report_steps(&self, steps: &[ClockStep]) {
        let path = self.path.display();
        for step in steps.iter().take(REPORTED_STEPS_MAX) {
            let (seconds, image) = (step.step_ns as f64 * 1e-9, step.image);
            log(format_args!(
                "overcam: {path}: a clock was set by {seconds:+.3} s before its image {image}; time goes on without the step"
            ));
        }
        if let Some(further) = steps
            .len()
            .checked_sub(REPORTED_STEPS_MAX)
            .filter(|&n| n > 0)
        {
            log(format_args!("overcam: {path}: and {further} times more"));
        }
    }

    /// The error for a file whose images gave no frame.
    fn none_readable(&mut self) -> ReplayError {
        let path = self.path.clone();
        match (self.damaged.count, self.first_damage.take()) {
            (1, Some(only)) => only,
            (count, Some(first)) => ReplayError::NoneReadable {
                path,
                count,
                first: Box::new(first),
            },
            (_, None) => ReplayError::Truncated {
                path,
                after: After(None),
            },
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

    fn image_error(&self, topic: String, source: ImageError) -> ReplayError {
        ReplayError::Image {
            path: self.path.clone(),
            topic,
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

/// Reconstructs a sequence number from its low 32 bits: the first one after the newest with these
/// bits.
fn full_sequence(newest: Option<u64>, low_bits: u32) -> u64 {
    newest.map_or(u64::from(low_bits), |newest| {
        newest.wrapping_add(u64::from(low_bits.wrapping_sub(newest as u32)))
    })
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
