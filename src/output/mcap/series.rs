//! A recording in several files, where one would grow too large: `run.mcap`, `run-2.mcap`, `run-3.mcap` and so on.
//!
//! Each file is complete: settings, markers, calibration, region, the floor in use and its own index. Frame numbers and the offset of
//! the clock go on from file to file, so that the files one after the other hold every frame once. A replay of a later file begins with
//! the floor as the run had it there, rounded to whole grey levels. Tracks begin anew in it, with new numbers, and so does what
//! was learned of the light and of motions: after a second or two the results are those of the run but for that.
//!
//! A new file begins where a limit is reached. To know the floor there, the recorder [asks](Series::is_due) for it a few frames before
//! and takes the frame that [brings it](Slot::floor_in_use). Where none comes, the floor that was in use last has to do.
//!
//! The numbers have no leading zeros: natural order, that of `ls -v` and of file managers, is the order of time. A file that exists is
//! never overwritten: a series does not start among files of an older one, and leaves out a number that is taken later.

use std::fs;
use std::path::{Path, PathBuf};

use crate::background::model::BackgroundModel;
use crate::output::foxglove::image_message::ImageMode;
use crate::output::mcap::provenance::Provenance;
use crate::output::mcap::record::{RecordError, Recorder, Start, Summary};
use crate::run::slot::{Slot, SourceInfo};

/// Frames after which a new file begins without a floor that was asked for: more than are under way in the program.
const PATIENCE_FRAMES: u32 = 64;

/// Frames that may come between asking for a floor and getting it, for which room is kept in the file.
const FRAMES_AHEAD: u64 = 20;

/// When a new file begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Limits {
    /// Largest file, bytes. A file has one frame at least.
    pub bytes: Option<u64>,
    /// Longest time between the first and the last frame of a file.
    pub duration_ns: Option<u64>,
}

/// Writes a recording, in as many files as its limits ask for.
pub struct Series {
    path: PathBuf,
    start: Start,
    limits: Limits,
    /// `None` after an error.
    recorder: Option<Recorder>,
    /// Of the file that is being written.
    number: u32,
    n_files: u32,
    first_stamp_ns: Option<u64>,
    /// Frames since a limit was nearly reached.
    due_for: Option<u32>,
    /// The floor in use, where a later file may need it.
    floor: Option<BackgroundModel>,
    /// What the files before hold.
    finished: Summary,
}

/// A file that is complete, and the one after it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NextFile {
    /// The complete file.
    pub finished: PathBuf,
    /// What it holds.
    pub summary: Summary,
    /// The new file.
    pub path: PathBuf,
}

impl Series {
    /// Creates the first file.
    ///
    /// # Errors
    ///
    /// [`RecordError`] when it, or with limits a numbered one beside it, exists already, and when it cannot be created.
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

    /// Whether a limit is so near that a slot with the floor in use is wanted, of which a new file will begin.
    #[must_use]
    pub fn is_due(&self, slot: &Slot) -> bool {
        self.is_too_large_with(FRAMES_AHEAD) || self.is_too_long(slot)
    }

    /// Writes one frame, as [`Recorder::write`] does, into a new file if it is time for one; then what is said of that.
    ///
    /// # Errors
    ///
    /// As [`Recorder::write`] has them. That a file cannot be completed, or the next one not be created, is final.
    ///
    /// # Panics
    ///
    /// As [`Recorder::write`] does.
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

    /// What all files hold as they are. What came since the last flush is not in it yet.
    #[must_use]
    pub fn written(&self) -> Summary {
        let newest = self.recorder.as_ref().map(Recorder::written);
        sum(self.finished, newest.unwrap_or_default())
    }

    /// How many files there are.
    #[must_use]
    pub fn n_files(&self) -> u32 {
        self.n_files
    }

    /// The newest file.
    #[must_use]
    pub fn newest(&self) -> PathBuf {
        numbered(&self.path, self.number)
    }

    /// Completes the last file. The sum of all.
    ///
    /// # Errors
    ///
    /// As [`Recorder::finish`] has them.
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
        self.is_too_large_with(1) || has_floor || due_for >= PATIENCE_FRAMES
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
        // One that comes with the frame is written with it.
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

/// A file beside `path` that may belong to an older series.
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

/// The number that a file's name has in the series that starts with `path`.
fn number_of(path: &Path, name: &Path) -> Option<u32> {
    let stem = path.file_stem()?.to_str()?;
    let number = name.file_stem()?.to_str()?.strip_prefix(stem)?;
    let number: u32 = number.strip_prefix('-')?.parse().ok()?;
    (number >= 2 && numbered(path, number).file_name() == name.file_name()).then_some(number)
}

/// What a minute of a recording will take, before the first frame is known.
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

/// Two digits or, from 100 on, whole megabytes.
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
    fn the_size_of_a_recording_is_told_from_its_frames() {
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
        for (said, expected) in cases {
            assert_eq!(said, expected);
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
