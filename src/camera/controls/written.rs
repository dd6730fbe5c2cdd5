//! Values written to a camera, and the original values, which are restored on exit.
//!
//! While the program runs, the original values are also stored in a small file. If the program is
//! killed, or the machine loses power, the file remains, and the next program that uses the camera
//! restores the values. Otherwise the automatics would stay off forever, and every later run would
//! report them as "fixed already".
//!
//! The file is locked while its program runs, so that a file in use is not mistaken for a leftover.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::camera::controls::{Change, SETTINGS};
use crate::camera::v4l2::Device;

/// Values written to a camera, and the original ones.
#[derive(Debug, Default)]
pub(crate) struct Written {
    /// The original values, in the order in which they were overwritten.
    before: Vec<Change>,
    file: Option<StateFile>,
}

/// The file that survives a killed program.
#[derive(Debug)]
struct StateFile {
    path: PathBuf,
    file: File,
}

/// Content of the file.
#[derive(Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct State {
    /// The camera's name and port, for human readers.
    camera: String,
    /// Original values.
    before: Vec<Change>,
}

/// Folder of the files: the one given by systemd; otherwise for root below `/run`, for other users
/// below `$XDG_STATE_HOME`.
#[must_use]
pub(crate) fn state_folder() -> Option<PathBuf> {
    let folder = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    if let Some(folder) = folder("STATE_DIRECTORY") {
        return Some(folder.into());
    }
    let base = if rustix::process::geteuid().is_root() {
        PathBuf::from("/run")
    } else if let Some(state) = folder("XDG_STATE_HOME") {
        state.into()
    } else {
        PathBuf::from(folder("HOME")?).join(".local/state")
    };
    Some(base.join("overcam"))
}

impl Written {
    /// From now on, stores overwritten values in a file of `folder`. Also restores the values of
    /// the same camera left there by a killed program, and returns their number.
    ///
    /// # Errors
    ///
    /// If the file cannot be created, or belongs to a running program.
    pub(crate) fn keep_in(
        &mut self,
        folder: &Path,
        camera: &str,
        device: &Device,
    ) -> io::Result<usize> {
        let mut file = StateFile::open(folder, camera)?;
        let left_over = file.read();
        let n_left_over = left_over.before.len();
        put_back(device, left_over.before);
        file.write(&State::default())?;
        self.file = Some(file);
        Ok(n_left_over)
    }

    /// Writes to the camera, and stores the original value.
    pub(crate) fn write(&mut self, device: &Device, change: Change) -> io::Result<()> {
        let before = device.control_value(change.id);
        let is_first = self.before.iter().all(|written| written.id != change.id);
        if let Ok(value) = before
            && is_first
        {
            let id = change.id;
            self.before.push(Change { id, value });
            // Saved first, because the program may be killed between any two steps.
            self.save();
        }
        device.set_control(change.id, change.value)
    }

    /// Restores the automatics that affect brightness.
    pub(crate) fn undo_brightness(&mut self, device: &Device) {
        let (brightness, kept) = part_brightness(&self.before);
        self.before = kept;
        put_back(device, brightness);
        self.save();
    }

    /// Restores everything, then removes the file.
    pub(crate) fn undo(&mut self, device: &Device) {
        put_back(device, std::mem::take(&mut self.before));
        if let Some(file) = self.file.take() {
            _ = fs::remove_file(&file.path);
        }
    }

    /// Errors are ignored: on a full disk, the only loss is that the values cannot be restored
    /// after a kill.
    fn save(&mut self) {
        if let Some(file) = &mut self.file {
            let camera = file.camera();
            let before = self.before.clone();
            _ = file.write(&State { camera, before });
        }
    }
}

/// Splits off the automatics that were on and affect brightness.
fn part_brightness(before: &[Change]) -> (Vec<Change>, Vec<Change>) {
    before.iter().copied().partition(|written| {
        let mut settings = SETTINGS.iter().filter(|setting| setting.is_brightness);
        settings.any(|setting| setting.automatic == written.id && setting.off != written.value)
    })
}

/// In reverse order, so that automatics come after the values they control. After a camera is gone
/// or does not respond, no further requests are sent, since each may take seconds.
fn put_back(device: &Device, before: Vec<Change>) {
    for change in before.into_iter().rev() {
        let result = device.set_control(change.id, change.value);
        let error = result.err().and_then(|error| error.raw_os_error());
        if matches!(
            error,
            Some(libc::ENODEV | libc::EIO | libc::ETIMEDOUT | libc::EPIPE | libc::ENXIO)
        ) {
            break;
        }
    }
}

impl StateFile {
    /// Opens the file of a camera, creates it if needed, and locks it.
    fn open(folder: &Path, camera: &str) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let path = folder.join(format!("camera-{}.toml", file_name(camera)));
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)?;
        file.try_lock()?;
        Ok(Self { path, file })
    }

    /// Content of the file; empty if unreadable.
    fn read(&mut self) -> State {
        let mut text = String::new();
        let read = self.file.read_to_string(&mut text);
        read.ok()
            .and_then(|_| toml::from_str(&text).ok())
            .unwrap_or_default()
    }

    fn write(&mut self, state: &State) -> io::Result<()> {
        let text = toml::to_string(state).map_err(io::Error::other)?;
        self.file.seek(SeekFrom::Start(0))?;
        self.file.set_len(0)?;
        self.file.write_all(text.as_bytes())?;
        self.file.sync_data()
    }

    fn camera(&self) -> String {
        let name = self.path.file_stem().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }
}

/// The name and port of a camera as part of a file name.
fn file_name(camera: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.');
    camera
        .chars()
        .map(|c| if is_plain(c) { c } else { '_' })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::controls::{
        AUTO_WHITE_BALANCE, AUTOGAIN, EXPOSURE_AUTO, EXPOSURE_AUTO_PRIORITY, GAIN,
    };

    const CAMERA: &str = "Some Camera: 4K usb-0000:00:14.0-1";

    #[test]
    fn a_file_keeps_what_was_there_and_belongs_to_one_program_at_a_time() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path().join("overcam");
        let mut file = StateFile::open(&folder, CAMERA).expect("made");
        assert_eq!(file.read(), State::default());
        let state = State {
            camera: file.camera(),
            before: vec![
                Change {
                    id: 9963794,
                    value: 1,
                },
                Change { id: 1, value: -7 },
            ],
        };
        file.write(&state).expect("written");
        assert!(StateFile::open(&folder, CAMERA).is_err(), "in use");
        assert!(StateFile::open(&folder, "another").is_ok());
        // Killed.
        drop(file);
        let mut file = StateFile::open(&folder, CAMERA).expect("free again");
        assert_eq!(file.read(), state);
        file.write(&State::default()).expect("shorter");
        drop(file);
        let mut file = StateFile::open(&folder, CAMERA).expect("free again");
        assert!(file.read().before.is_empty());
    }

    #[test]
    fn brightness_is_given_back_without_the_rest() {
        let change = |(id, value)| Change { id, value };
        let before = [
            (EXPOSURE_AUTO_PRIORITY, 1),
            (EXPOSURE_AUTO, 3),
            (AUTOGAIN, 1),
            (AUTO_WHITE_BALANCE, 1),
            (GAIN, 12),
        ]
        .map(change);
        let (brightness, kept) = part_brightness(&before);
        assert_eq!(brightness, [before[1], before[2]]);
        assert_eq!(kept, [before[0], before[3], before[4]]);
    }

    #[test]
    fn a_file_of_anything_else_says_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        for text in ["\0\0\0", "before = 7", "[[before]]\nid = \"x\""] {
            let path = StateFile::open(folder.path(), CAMERA).expect("made").path;
            fs::write(path, text).expect("written");
            let mut file = StateFile::open(folder.path(), CAMERA).expect("opened");
            assert_eq!(file.read(), State::default(), "{text}");
        }
    }
}
