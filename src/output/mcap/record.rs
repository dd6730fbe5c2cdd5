//! Recording: all frames and results in one MCAP file, as protobuf messages with Foxglove's
//! schemas.
//!
//! # Content of the file
//!
//! The camera's frames and the results of each, on the topics listed in
//! [`topics`](crate::output::foxglove::topics).
//!
//! Settings, markers, calibration and region precede the first message ([`Provenance`]). A new
//! background is stored as the attachment `background.png` ([`BackgroundModel`]) before the first
//! frame to which it applies, so the order in the file matters.
//!
//! The sequence number of a message is the frame's, in 32 bits. Its log time is the time of
//! exposure. For a camera it is on the wall clock, with an offset measured once, so that a replay
//! restores the exact time stamps. For any other source it is the stamp itself, so that the same
//! input gives the same file, byte by byte.
//!
//! # Crash safety
//!
//! Messages are collected in a chunk, compressed in memory. The chunk is written as soon as it
//! covers [`FLUSH_INTERVAL_NS`] or holds [`CHUNK_BYTES`], so a killed process loses less than that.
//! If the disk is full, a partial chunk is removed again: the file always ends with a complete
//! chunk. Only the index at its end is then missing, which
//! [`recover`](crate::output::mcap::recover) adds. There is no fsync: a power failure may lose
//! more.
//!
//! Chunks are compressed with zstd at level 1; for the reason see the constant `ZSTD_LEVEL`.

use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mcap::records::Metadata;
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, McapError, McapResult, WriteOptions};
use nalgebra::{Matrix3, RowVector3};
use scene::{FRAME_FLOOR, FRAME_IMAGE};

use crate::background::model::BackgroundModel;
use crate::clock::monotonic_ns;
use crate::output::foxglove::annotate;
use crate::output::foxglove::image_message::{ImageEncoder, ImageError, ImageMode, ImageSchema};
use crate::output::foxglove::topics::{ResultTopic, timestamp};
use crate::output::mcap::Mcap;
use crate::output::mcap::channels::{FrameWriter, ImageChannels, ResultChannels};
use crate::output::mcap::provenance::{self, BACKGROUND_NAME, METADATA_NAME, Provenance};
use crate::run::slot::{Slot, SourceInfo};
use crate::run::status::counted;

/// A chunk is written when its newest frame is this much later than the newest one in the file.
pub const FLUSH_INTERVAL_NS: u64 = 500_000_000;
/// A chunk is written when it holds this many uncompressed bytes; a reader needs about as much
/// memory.
pub const CHUNK_BYTES: usize = 8 << 20;

/// Compression level of the chunks. YUYV frames of 640x480 with noise of sigma 1 and 3 (of 255)
/// shrink to .43 and .58 of their size in 6.3 and 1.5 ms; lz4 reaches .64 and .99 in 3.1 and 2.0
/// ms, level 3 .40 and .58 in 8.7 and 12 ms.
const ZSTD_LEVEL: u32 = 1;

/// Space for the end of a file without its chunk index: schemas, channels and counts.
const INDEX_BYTES_MAX: u64 = 128 << 10;
/// Space for the index entry of a chunk at the end.
const CHUNK_INDEX_BYTES_MAX: u64 = 256;

/// Writes a recording into one file; a [`Series`](crate::output::mcap::series::Series) writes
/// several. If dropped without [`Recorder::finish`], it still tries to close the file.
pub struct Recorder {
    path: PathBuf,
    /// `None` after a write error: nothing can be written any more.
    mcap: Option<Mcap>,
    /// A second handle of the file, for its length and for removing partial writes.
    file: File,
    images: ImageEncoder,
    /// Indexed by whether the frames use the full range.
    image_channels: [Option<ImageChannels>; 2],
    results: ResultChannels,
    wall_offset_ns: u64,
    /// [`FRAME_IMAGE`] or [`FRAME_FLOOR`].
    frame_of_results: u32,
    image_from_floor: Option<Matrix3<f64>>,
    /// Sequence number of the previous frame, which may be in the previous file.
    previous_sequence: Option<u64>,
    /// Estimated upper limit for the size of all messages of the next frame.
    frame_bytes_at_most: u64,
    /// Number of chunks in the file, each of which needs an index entry.
    n_chunks: u64,
    chunk: OpenChunk,
    /// Stamp of the newest frame in the file.
    flushed_stamp_ns: Option<u64>,
    /// The readable content of the file so far.
    written: Summary,
    /// Reused for each message.
    message: Vec<u8>,
}

/// Content of the chunk that is not yet in the file.
#[derive(Default)]
struct OpenChunk {
    frames: u64,
    skipped: u64,
    missing: u64,
    image_bytes: usize,
    /// Uncompressed size of all messages.
    bytes: u64,
    newest_stamp_ns: Option<u64>,
}

/// Content of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Summary {
    /// Frames, including skipped ones.
    pub frames: u64,
    /// Skipped frames.
    pub skipped: u64,
    /// Frames missing between recorded ones, by their sequence numbers.
    pub missing: u64,
    /// Size of the file.
    pub bytes: u64,
}

/// Reasons why a recording cannot start or continue.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file already exists.
    #[error("{} exists already and is not overwritten; remove it or choose another name", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The folder for the file does not exist.
    #[error("{} cannot be created: there is no such folder; create it or choose another place", path.display())]
    MissingFolder {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be created for another reason.
    #[error("{} cannot be created ({source}); choose a place that you may write to", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The disk is full.
    #[error(
        "the disk is full: {} ends after {}; make room, then `overcam recover` completes the file", path.display(),
        counted(*frames, "frame")
    )]
    DiskFull {
        /// The file.
        path: PathBuf,
        /// Number of frames in it.
        frames: u64,
    },
    /// Writing failed for another reason.
    #[error(
        "{} cannot be written any more ({source}) and ends after {}; `overcam recover` completes the file",
        path.display(),
        counted(*frames, "frame")
    )]
    Write {
        /// The file.
        path: PathBuf,
        /// Number of frames in it.
        frames: u64,
        /// Error of the system.
        source: io::Error,
    },
    /// An earlier error ended the recording.
    #[error("{} is not written any more since an earlier error", path.display())]
    Stopped {
        /// The file.
        path: PathBuf,
    },
    /// One frame cannot be stored; the recording continues.
    #[error("frame {sequence} cannot be recorded: {source}")]
    Image {
        /// Sequence number of the frame.
        sequence: u64,
        /// The cause.
        source: ImageError,
    },
}

impl RecordError {
    /// Whether the recording has ended with this error. Otherwise only one frame is missing.
    #[must_use]
    pub fn is_final(&self) -> bool {
        !matches!(self, Self::Image { .. })
    }
}

/// Data at the start of every file of a recording.
#[derive(Debug, Clone)]
pub(crate) struct Start {
    info: SourceInfo,
    provenance: Provenance,
    mode: ImageMode,
}

impl Start {
    pub(crate) fn new(info: SourceInfo, provenance: Provenance, mode: ImageMode) -> Self {
        Self {
            info,
            provenance,
            mode,
        }
    }
}

/// State passed from one file of a recording to the next.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Continuation<'a> {
    wall_offset_ns: u64,
    previous_sequence: Option<u64>,
    /// The current background, and the stamp of the frame from which it applies.
    floor: Option<(&'a BackgroundModel, u64)>,
}

impl<'a> Continuation<'a> {
    /// Adds the background with which the next file starts.
    pub(crate) fn with_floor(self, floor: Option<&'a BackgroundModel>, stamp_ns: u64) -> Self {
        Self {
            floor: floor.map(|floor| (floor, stamp_ns)),
            ..self
        }
    }
}

impl Recorder {
    /// Creates the file and writes everything known before the first frame.
    ///
    /// # Errors
    ///
    /// [`RecordError`] if the file already exists, cannot be created or cannot be written.
    pub fn create(
        path: &Path,
        info: &SourceInfo,
        provenance: &Provenance,
        mode: ImageMode,
    ) -> Result<Self, RecordError> {
        let start = Start::new(info.clone(), provenance.clone(), mode);
        Self::start_file(path, &start, None)
    }

    /// Creates the first or a further file of a recording.
    pub(crate) fn start_file(
        path: &Path,
        start: &Start,
        before: Option<&Continuation>,
    ) -> Result<Self, RecordError> {
        let file = create_file(path)?;
        Self::start(path, file, start, before).map_err(|error| {
            // An unusable file must not block the next attempt.
            let _ = fs::remove_file(path);
            write_error(path, 0, error)
        })
    }

    fn start(
        path: &Path,
        file: File,
        Start {
            info,
            provenance,
            mode,
        }: &Start,
        before: Option<&Continuation>,
    ) -> McapResult<Self> {
        let wall_offset_ns = match before {
            Some(before) => before.wall_offset_ns,
            None if info.live => wall_offset_ns(),
            None => 0,
        };
        let mut mcap = open_mcap(file.try_clone()?)?;
        mcap.write_metadata(&Metadata {
            name: METADATA_NAME.to_owned(),
            metadata: provenance::to_metadata(info, provenance, *mode, wall_offset_ns),
        })?;
        for attached in provenance.attached_files() {
            attach(
                &mut mcap,
                &attached.name,
                attached.media_type,
                attached.data,
                wall_offset_ns,
            )?;
        }
        if let Some((floor, stamp_ns)) = before.and_then(|before| before.floor) {
            let log_time_ns = stamp_ns.wrapping_add(wall_offset_ns);
            let png = floor.to_png();
            attach(&mut mcap, BACKGROUND_NAME, "image/png", &png, log_time_ns)?;
        }
        mcap.flush()?;
        Ok(Self {
            path: path.to_owned(),
            results: ResultChannels::add(&mut mcap)?,
            mcap: Some(mcap),
            images: ImageEncoder::new(*mode, info),
            image_channels: Default::default(),
            wall_offset_ns,
            frame_of_results: if provenance.floor_from_image.is_some() {
                FRAME_FLOOR
            } else {
                FRAME_IMAGE
            },
            image_from_floor: provenance.floor_from_image.and_then(inverse),
            previous_sequence: before.and_then(|before| before.previous_sequence),
            frame_bytes_at_most: 0,
            n_chunks: 0,
            chunk: OpenChunk::default(),
            flushed_stamp_ns: None,
            written: Summary {
                bytes: file.metadata()?.len(),
                ..Summary::default()
            },
            file,
            message: Vec::new(),
        })
    }

    /// State for the next file of the recording.
    pub(crate) fn continuation(&self) -> Continuation<'static> {
        Continuation {
            wall_offset_ns: self.wall_offset_ns,
            previous_sequence: self.previous_sequence,
            floor: None,
        }
    }

    /// Estimated upper limit for the size of the finished file after this many more frames like the
    /// last one, but with twice as many objects and, for compressed images, twice the data.
    pub(crate) fn bytes_at_most(&self, more_frames: u64) -> u64 {
        self.written.bytes
            + self.chunk.bytes
            + more_frames * self.frame_bytes_at_most
            + INDEX_BYTES_MAX
            + self.n_chunks * CHUNK_INDEX_BYTES_MAX
    }

    /// Writes one frame, the background that applies from it on, and its results: the slot's scene,
    /// if the frame was processed and the scene has its number and its time stamp. Slots are
    /// reused: for a frame without results, because the background was still being learned, the
    /// slot may hold an older scene.
    ///
    /// # Errors
    ///
    /// [`RecordError::Image`] drops one frame and the recording continues. After any other error it
    /// has ended, the file holds what was flushed before, and further calls return
    /// [`RecordError::Stopped`].
    ///
    /// # Panics
    ///
    /// If the background is empty, or its planes or its noise do not match its size.
    pub fn write(&mut self, slot: &Slot) -> Result<(), RecordError> {
        let Some(mut mcap) = self.mcap.take() else {
            return Err(RecordError::Stopped {
                path: self.path.clone(),
            });
        };
        // Encoded before anything is written, so that an unusable frame leaves no trace.
        let timestamp = timestamp(self.log_time_ns(slot.frame.stamp_ns));
        let encoded = self
            .images
            .encode(&slot.frame, timestamp, &mut self.message);
        if let Err(source) = encoded {
            self.mcap = Some(mcap);
            return Err(RecordError::Image {
                sequence: slot.frame.sequence,
                source,
            });
        }
        if let Err(error) = self.write_slot(&mut mcap, slot) {
            return Err(self.stop(mcap, error));
        }
        self.mcap = Some(mcap);
        Ok(())
    }

    /// The content of the file so far, without data since the last flush.
    #[must_use]
    pub fn written(&self) -> Summary {
        self.written
    }

    /// Writes the remaining data and the index.
    ///
    /// # Errors
    ///
    /// [`RecordError`] if there is no space for the rest; [`RecordError::Stopped`] if the recording
    /// had already ended.
    pub fn finish(mut self) -> Result<Summary, RecordError> {
        let Some(mut mcap) = self.mcap.take() else {
            return Err(RecordError::Stopped {
                path: self.path.clone(),
            });
        };
        let finished = self.flush(&mut mcap).and_then(|()| {
            mcap.finish()?;
            Ok(self.file.metadata()?.len())
        });
        match finished {
            Ok(bytes) => Ok(Summary {
                bytes,
                ..self.written
            }),
            Err(error) => Err(self.stop(mcap, error)),
        }
    }

    /// Writes a slot whose image message is in `self.message`.
    fn write_slot(&mut self, mcap: &mut Mcap, slot: &Slot) -> McapResult<()> {
        let frame = &slot.frame;
        let log_time_ns = self.log_time_ns(frame.stamp_ns);
        if let Some(background) = &slot.background {
            self.flush(mcap)?;
            let png = background.to_png();
            attach(mcap, BACKGROUND_NAME, "image/png", &png, log_time_ns)?;
        }
        let image_bytes = self.message.len();
        let channels = self.image_channels(mcap, frame.full_range)?;
        let channel_id = if slot.skipped {
            channels.skipped
        } else {
            channels.processed
        };
        let mut writer = FrameWriter::new(mcap, frame.sequence, log_time_ns, &mut self.message);
        writer.write_encoded(channel_id)?;
        let missing = missing_before(self.previous_sequence, frame.sequence);
        if missing > 0 {
            let are_missing = match missing {
                1 => "1 frame is missing".to_owned(),
                _ => format!("{missing} frames are missing"),
            };
            let text = format!("{are_missing} before frame {}", frame.sequence);
            let warning = annotate::warning(text, writer.timestamp());
            writer.write(&self.results, ResultTopic::Log, &warning)?;
        }
        if self.written.frames + self.chunk.frames == 0 {
            let transform = annotate::root_transform(self.frame_of_results, writer.timestamp());
            writer.write(&self.results, ResultTopic::Transform, &transform)?;
        }
        let scene = &slot.scene;
        let is_of_this_frame = (scene.sequence, scene.stamp_ns) == (frame.sequence, frame.stamp_ns);
        if !slot.skipped && is_of_this_frame {
            writer.write_scene(&self.results, scene, self.image_from_floor.as_ref())?;
        }
        let frame_bytes = writer.bytes();
        self.frame_bytes_at_most = match self.images.schema() {
            ImageSchema::Raw => 2 * frame_bytes - image_bytes as u64,
            ImageSchema::Compressed => 2 * frame_bytes,
        };
        self.previous_sequence = Some(frame.sequence);
        self.chunk.frames += 1;
        self.chunk.skipped += u64::from(slot.skipped);
        self.chunk.missing += missing;
        self.chunk.image_bytes += image_bytes;
        self.chunk.bytes += frame_bytes;
        self.chunk.newest_stamp_ns = Some(frame.stamp_ns);
        // The very first frame is flushed immediately: from then on the file can be replayed.
        let is_due = self
            .flushed_stamp_ns
            .is_none_or(|flushed_ns| frame.stamp_ns.abs_diff(flushed_ns) >= FLUSH_INTERVAL_NS);
        if is_due || self.chunk.image_bytes >= CHUNK_BYTES {
            self.flush(mcap)?;
        }
        Ok(())
    }

    /// Writes the open chunk to the file.
    fn flush(&mut self, mcap: &mut Mcap) -> McapResult<()> {
        mcap.flush()?;
        self.n_chunks += 1;
        let chunk = std::mem::take(&mut self.chunk);
        self.flushed_stamp_ns = chunk.newest_stamp_ns.or(self.flushed_stamp_ns);
        self.written = Summary {
            frames: self.written.frames + chunk.frames,
            skipped: self.written.skipped + chunk.skipped,
            missing: self.written.missing + chunk.missing,
            bytes: self.file.metadata()?.len(),
        };
        Ok(())
    }

    /// Ends the recording after an error: the file is truncated to its readable part.
    fn stop(&mut self, mcap: Mcap, error: McapError) -> RecordError {
        // Dropping the buffer would write its content after the truncation.
        let (file, _unwritten) = mcap.into_inner().into_inner().into_parts();
        drop(file);
        // If this fails too, the file ends within a chunk, and readers stop before it just as well.
        let _ = self.file.set_len(self.written.bytes);
        write_error(&self.path, self.written.frames, error)
    }

    fn image_channels(&mut self, mcap: &mut Mcap, full_range: bool) -> McapResult<ImageChannels> {
        let known = &mut self.image_channels[usize::from(full_range)];
        if let Some(channels) = *known {
            return Ok(channels);
        }
        let channels = ImageChannels::add(mcap, self.images.schema(), full_range)?;
        *known = Some(channels);
        Ok(channels)
    }

    fn log_time_ns(&self, stamp_ns: u64) -> u64 {
        // Wrapping, so that a replay restores any stamp by subtraction.
        stamp_ns.wrapping_add(self.wall_offset_ns)
    }
}

/// Creates a new file.
pub(crate) fn create_file(path: &Path) -> Result<File, RecordError> {
    File::create_new(path).map_err(|source| {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::AlreadyExists => RecordError::Exists { path },
            io::ErrorKind::NotFound => RecordError::MissingFolder { path },
            _ => RecordError::Create { path, source },
        }
    })
}

/// Starts an MCAP file. Chunks are assembled in memory and end only with a flush, so that each is
/// written completely or not at all.
pub(crate) fn open_mcap(file: File) -> McapResult<Mcap> {
    WriteOptions::new()
        .library(concat!("overcam ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        .compression_level(ZSTD_LEVEL)
        .compression_threads(0)
        .chunk_size(None)
        .disable_seeking(true)
        .create(NoSeek::new(BufWriter::new(file)))
}

/// The error for a failed write.
pub(crate) fn write_error(path: &Path, frames: u64, error: McapError) -> RecordError {
    let path = path.to_owned();
    let source = match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    };
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            RecordError::DiskFull { path, frames }
        }
        _ => RecordError::Write {
            path,
            frames,
            source,
        },
    }
}

fn attach(
    mcap: &mut Mcap,
    name: &str,
    media_type: &str,
    data: &[u8],
    log_time_ns: u64,
) -> McapResult<()> {
    // The open chunk is closed first, so that attachments and messages keep their order.
    mcap.attach(&Attachment {
        log_time: log_time_ns,
        create_time: log_time_ns,
        name: name.to_owned(),
        media_type: media_type.to_owned(),
        data: data.into(),
    })
}

fn missing_before(previous: Option<u64>, sequence: u64) -> u64 {
    previous.map_or(0, |previous| {
        sequence.saturating_sub(previous).saturating_sub(1)
    })
}

fn inverse(rows: [[f64; 3]; 3]) -> Option<Matrix3<f64>> {
    Matrix3::from_rows(&rows.map(RowVector3::from)).try_inverse()
}

/// Wall clock minus monotonic clock.
fn wall_offset_ns() -> u64 {
    let monotonic = Duration::from_nanos(monotonic_ns());
    let wall = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or(monotonic);
    u64::try_from(wall.saturating_sub(monotonic).as_nanos()).unwrap_or(0)
}
