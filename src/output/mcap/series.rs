//! A recording in several files of limited size: `run.mcap`, `run-2.mcap`, `run-3.mcap` and so on.
//!
//! Each file is complete: settings, markers, calibration, region, the current background and its
//! own index. Frame numbers and the clock offset continue across files, so that together the files
//! contain every frame once. A replay of a later file starts with the background of the run at that
//! point, rounded to whole grey levels. Tracks restart with new numbers, and so do the estimates of
//! illumination and motion: apart from that, the results equal those of the run after a second or
//! two.
//!
//! A new file starts when a limit is reached. To have the background at that point, the recorder
//! [requests](Series::is_due) it a few frames earlier, and the new file starts with the frame that
//! [has it](Slot::floor_in_use). If none arrives, the last known background is used.
//!
//! The numbers have no leading zeros: natural order, as in `ls -v` and file managers, is
//! chronological. An existing file is never overwritten: a series does not start among files of an
//! older one, and skips a number that is used later.

use std::fs;
use std::path::{Path, PathBuf};

use crate::background::model::BackgroundModel;
use crate::output::foxglove::image_message::ImageMode;
use crate::output::mcap::provenance::Provenance;
use crate::output::mcap::record::{RecordError, Recorder, Start, Summary};
use crate::run::slot::{Slot, SourceInfo};

/// Number of frames after which a new file starts without the requested background: more than are
/// in the program at a time.
const TIMEOUT_FRAMES: u32 = 64;

/// Maximum number of frames between request and arrival of the background, for which space is kept
/// in the file.
const FRAMES_AHEAD: u64 = 20;

/// Limits of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Limits {
    /// Maximum file size in bytes. A file has at least one frame.
    pub bytes: Option<u64>,
    /// Maximum time between the first and the last frame of a file.
    pub duration_ns: Option<u64>,
}

/// Writes a recording, in as many files as required by its limits.
pub struct Series {
    path: PathBuf,
    start: Start,
    limits: Limits,
    /// `None` after an error.
    recorder: Option<Recorder>,
    /// Number of the current file.
    number: u32,
    n_files: u32,
    first_stamp_ns: Option<u64>,
    /// Frames since a limit was nearly reached.
    due_for: Option<u32>,
    /// The current background, if a later file may need it.
    floor: Option<BackgroundModel>,
    /// Content of the previous files.
    finished: Summary,
}

/// A completed file and its successor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NextFile {
    /// The completed file.
    pub finished: PathBuf,
    /// Its content.
    pub summary: Summary,
    /// The new file.
    pub path: PathBuf,
}

impl Series {
    /// Creates the first file.
    ///
    /// # Errors
    ///
    /// [`RecordError`] if it, or with limits a numbered one in the same folder, already exists, or
    /// if it cannot be created.
    pub fn create(
        path: &Path,
        info: &SourceInfo,
        provenance: &Provenance,
        mode: ImageMode,
        limits: Limits,
    ) -> Result<Self, RecordError> {
        if limits != Limits::default()
            && let Some(path) = numbered_file(path)
        {
            return Err(RecordError::Exists { path });
        }
        let start = Start::new(info.clone(), provenance.clone(), mode);
        Ok(Self {
            recorder: Some(Recorder::start_file(path, &start, None)?),
            path: path.to_owned(),
            start,
            limits,
            number: 1,
            n_files: 1,
            first_stamp_ns: None,
            due_for: None,
            floor: None,
            finished: Summary::default(),
        })
    }

    /// Whether a limit is so close that a slot with the current background is needed to start a new
    /// file.
    #[must_use]
    pub fn is_due(&self, slot: &Slot) -> bool {
        self.is_too_large_with(FRAMES_AHEAD) || self.is_too_long(slot)
    }

    /// Writes one frame like [`Recorder::write`], into a new file if one is due; then returns
    /// information about it.
    ///
    /// # Errors
    ///
    /// Same as [`Recorder::write`]. Failure to complete a file or to create the next one is final.
    ///
    /// # Panics
    ///
    /// Same as [`Recorder::write`].
    pub fn write(&mut self, slot: &mut Slot) -> Result<Option<NextFile>, RecordError> {
        let floor_in_use = slot.floor_in_use.take();
        let next_file = if self.is_time_for_the_next(slot, floor_in_use.is_some()) {
            Some(self.begin_next(floor_in_use, slot)?)
        } else {
            None
        };
        let Some(recorder) = &mut self.recorder else {
            return Err(RecordError::Stopped {
                path: self.path.clone(),
            });
        };
        recorder.write(slot)?;
        self.first_stamp_ns.get_or_insert(slot.frame.stamp_ns);
        if self.limits != Limits::default()
            && let Some(background) = &slot.background
        {
            self.floor = Some(background.clone());
        }
        Ok(next_file)
    }

    /// The content of all files so far, without data since the last flush.
    #[must_use]
    pub fn written(&self) -> Summary {
        let newest = self.recorder.as_ref().map(Recorder::written);
        sum(self.finished, newest.unwrap_or_default())
    }

    /// Number of files.
    #[must_use]
    pub fn n_files(&self) -> u32 {
        self.n_files
    }

    /// The newest file.
    #[must_use]
    pub fn newest(&self) -> PathBuf {
        numbered(&self.path, self.number)
    }

    /// Completes the last file. Returns the sum of all.
    ///
    /// # Errors
    ///
    /// Same as [`Recorder::finish`].
    pub fn finish(self) -> Result<Summary, RecordError> {
        let Some(recorder) = self.recorder else {
            return Err(RecordError::Stopped { path: self.path });
        };
        Ok(sum(self.finished, recorder.finish()?))
    }

    fn is_time_for_the_next(&mut self, slot: &Slot, has_floor: bool) -> bool {
        // Not before the first frame of a file.
        if self.first_stamp_ns.is_none() {
            return false;
        }
        if !self.is_due(slot) {
            self.due_for = None;
            return false;
        }
        let due_for = self.due_for.map_or(0, |frames| frames + 1);
        self.due_for = Some(due_for);
        self.is_too_large_with(1) || has_floor || due_for >= TIMEOUT_FRAMES
    }

    fn begin_next(
        &mut self,
        floor_in_use: Option<BackgroundModel>,
        slot: &Slot,
    ) -> Result<NextFile, RecordError> {
        let Some(recorder) = self.recorder.take() else {
            return Err(RecordError::Stopped {
                path: self.path.clone(),
            });
        };
        let finished = self.newest();
        let before = recorder.continuation();
        let written = recorder.written();
        let summary = recorder.finish().inspect_err(|_| {
            self.finished = sum(self.finished, written);
        })?;
        self.finished = sum(self.finished, summary);
        if let Some(floor) = floor_in_use {
            self.floor = Some(floor);
        }
        // A background in the slot is written with the frame.
        let floor = self.floor.as_ref().filter(|_| slot.background.is_none());
        let recorder = loop {
            self.number += 1;
            let path = self.newest();
            let continued = before.with_floor(floor, slot.frame.stamp_ns);
            match Recorder::start_file(&path, &self.start, Some(&continued)) {
                Err(RecordError::Exists { .. }) if self.number < u32::MAX => {}
                result => break result?,
            }
        };
        self.recorder = Some(recorder);
        self.n_files += 1;
        (self.first_stamp_ns, self.due_for) = (None, None);
        Ok(NextFile {
            finished,
            summary,
            path: self.newest(),
        })
    }

    fn is_too_large_with(&self, more_frames: u64) -> bool {
        self.limits
            .bytes
            .zip(self.recorder.as_ref())
            .is_some_and(|(max, recorder)| recorder.bytes_at_most(more_frames) > max)
    }

    fn is_too_long(&self, slot: &Slot) -> bool {
        let stamp_ns = slot.frame.stamp_ns;
        self.limits
            .duration_ns
            .zip(self.first_stamp_ns)
            .is_some_and(|(max, first)| stamp_ns.saturating_sub(first) >= max)
    }
}

fn sum(one: Summary, other: Summary) -> Summary {
    Summary {
        frames: one.frames + other.frames,
        skipped: one.skipped + other.skipped,
        missing: one.missing + other.missing,
        bytes: one.bytes + other.bytes,
    }
}

/// `run.mcap`, `run-2.mcap`, `run-3.mcap`.
fn numbered(path: &Path, number: u32) -> PathBuf {
    if number < 2 {
        return path.to_owned();
    }
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{number}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// A file next to `path` that may belong to an older series.
fn numbered_file(path: &Path) -> Option<PathBuf> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut numbers: Vec<u32> = fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| number_of(path, Path::new(&entry.ok()?.file_name())))
        .collect();
    numbers.sort_unstable();
    numbers.first().map(|&number| numbered(path, number))
}

/// The number of a file name in the series that starts with `path`.
fn number_of(path: &Path, name: &Path) -> Option<u32> {
    let stem = path.file_stem()?.to_str()?;
    let number = name.file_stem()?.to_str()?.strip_prefix(stem)?;
    let number: u32 = number.strip_prefix('-')?.parse().ok()?;
    (number >= 2 && numbered(path, number).file_name() == name.file_name()).then_some(number)
}

/// Estimated size of a minute of recording, before the first frame is known.
#[must_use]
pub fn size_estimate(info: &SourceInfo, mode: ImageMode) -> String {
    let jpeg = |quality| info.size.area() as f64 * jpeg_bytes_per_px(quality);
    let rate = |frame_bytes: f64| match info.rate_hz {
        Some(rate_hz) => format!("{} MB a minute", megabytes(60.0 * rate_hz * frame_bytes)),
        None => format!("{} MB a frame", megabytes(frame_bytes)),
    };
    let stored = mode.stored_format(info.format, info.size);
    match (stored.frame_bytes(info.size), mode) {
        (Some(raw), _) => {
            let raw = raw as f64;
            format!(
                "at most {}, less by what can be compressed; --record-jpeg 90 takes about {}",
                rate(raw),
                rate(jpeg(90).min(raw))
            )
        }
        (None, ImageMode::Jpeg { quality }) if info.format.frame_bytes(info.size).is_some() => {
            format!("about {}", rate(jpeg(quality)))
        }
        (None, _) => format!("about {}, as the source compresses", rate(jpeg(90))),
    }
}

/// Megabytes with two digits, or whole from 100 on.
fn megabytes(bytes: f64) -> String {
    let megabytes = bytes / 1e6;
    let decimals = [10.0, 1.0, 0.1]
        .iter()
        .filter(|&&min| megabytes < min)
        .count();
    format!("{megabytes:.decimals$}")
}

/// Measured on the demo floor, whose noise is that of a small camera.
fn jpeg_bytes_per_px(quality: u8) -> f64 {
    match quality {
        0..=40 => 0.07,
        41..=60 => 0.10,
        61..=80 => 0.12,
        81..=87 => 0.16,
        88..=92 => 0.23,
        93..=96 => 0.42,
        _ => 1.5,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::frame::PixelFormat;
    use imgproc::Size;

    #[test]
    fn the_size_of_a_recording_is_estimated_from_its_frames() {
        let info = |format, rate_hz| SourceInfo {
            name: "camera".to_owned(),
            size: Size {
                width: 640,
                height: 480,
            },
            format,
            rate_hz,
            live: true,
            controls: None,
        };
        let jpeg = ImageMode::Jpeg { quality: 90 };
        let cases = [
            (
                size_estimate(&info(PixelFormat::Yuyv, Some(30.0)), ImageMode::Lossless),
                "at most 1106 MB a minute, less by what can be compressed; --record-jpeg 90 takes about 127 MB a minute",
            ),
            (
                size_estimate(&info(PixelFormat::Yuyv, Some(30.0)), jpeg),
                "about 127 MB a minute",
            ),
            (
                size_estimate(&info(PixelFormat::Grey, None), ImageMode::Lossless),
                "at most 0.31 MB a frame, less by what can be compressed; --record-jpeg 90 takes about 0.071 MB a frame",
            ),
            (
                size_estimate(&info(PixelFormat::Jpeg, Some(30.0)), ImageMode::Lossless),
                "about 127 MB a minute, as the source compresses",
            ),
        ];
        for (text, expected) in cases {
            assert_eq!(text, expected);
        }
    }

    #[test]
    fn names_are_numbered_before_their_ending() {
        let name = |path, number| numbered(Path::new(path), number);
        assert_eq!(name("a/run.mcap", 1), Path::new("a/run.mcap"));
        assert_eq!(name("a/run.mcap", 12), Path::new("a/run-12.mcap"));
        assert_eq!(name("run", 2), Path::new("run-2"));
        assert_eq!(name("run-2.mcap", 2), Path::new("run-2-2.mcap"));
        let number = |name: &str| number_of(Path::new("a/run.mcap"), Path::new(name));
        assert_eq!(number("run-2.mcap"), Some(2));
        assert_eq!(number("run-10.mcap"), Some(10));
        for stranger in [
            "run.mcap",
            "run-1.mcap",
            "run-02.mcap",
            "run-2.png",
            "run-2",
            "run-+2.mcap",
        ] {
            assert_eq!(number(stranger), None, "{stranger}");
        }
    }
}
