//! What was written to a camera, and what stood there before, which is put back at the end.
//!
//! It is also kept in a small file while the program runs. A program that is killed, or whose machine loses its power, leaves the
//! file behind, and the next one that uses the camera puts back what stands there; otherwise the automatics would stay off for good, and
//! every later run would find them "fixed already".
//!
//! The file is locked as long as its program lives, so that nobody mistakes a living one's for a leftover.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::camera::controls::{Change, SETTINGS};
use crate::camera::v4l2::Device;

/// What was written to a camera, and what stood there before.
#[derive(Debug, Default)]
pub(crate) struct Written {
    /// What stood there, in the order in which it was overwritten.
    before: Vec<Change>,
    file: Option<StateFile>,
}

/// The file that outlives a killed program.
#[derive(Debug)]
struct StateFile {
    path: PathBuf,
    file: File,
}

/// What the file says.
#[derive(Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct State {
    /// The camera's name and port, for people.
    camera: String,
    /// What stood there before overcam came.
    before: Vec<Change>,
}

/// Where the files are: as systemd says, of root's programs below `/run`, of others below `$XDG_STATE_HOME`.
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
    /// Keeps what is overwritten in a file of `folder` from now on, and puts back what a killed program left there of the same
    /// camera. Returns how many values were put back.
    ///
    /// # Errors
    ///
    /// When the file cannot be made, or belongs to a program that is still running.
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

    /// Writes to the camera, and remembers what was there.
    pub(crate) fn write(&mut self, device: &Device, change: Change) -> io::Result<()> {
        let before = device.control_value(change.id);
        let is_first = self.before.iter().all(|written| written.id != change.id);
        if let Ok(value) = before
            && is_first
        {
            let id = change.id;
            self.before.push(Change { id, value });
            // First in the file: a program may be killed between any two steps.
            self.save();
        }
        device.set_control(change.id, change.value)
    }

    /// Puts the automatics back on that make the picture bright or dark.
    pub(crate) fn undo_brightness(&mut self, device: &Device) {
        let (taken, kept) = part_brightness(&self.before);
        self.before = kept;
        put_back(device, taken);
        self.save();
    }

    /// Puts everything back. The file goes when that is done.
    pub(crate) fn undo(&mut self, device: &Device) {
        put_back(device, std::mem::take(&mut self.before));
        if let Some(file) = self.file.take() {
            _ = fs::remove_file(&file.path);
        }
    }

    /// A disk that is full costs a killed program's successor the values, and this run nothing.
    fn save(&mut self) {
        if let Some(file) = &mut self.file {
            let camera = file.camera();
            let before = self.before.clone();
            _ = file.write(&State { camera, before });
        }
    }
}

/// The automatics that were on and make the picture bright or dark, and the rest.
fn part_brightness(before: &[Change]) -> (Vec<Change>, Vec<Change>) {
    before.iter().copied().partition(|written| {
        let mut settings = SETTINGS.iter().filter(|setting| setting.is_brightness);
        settings.any(|setting| setting.automatic == written.id && setting.off != written.value)
    })
}

/// The last first, so that automatics come after what they decide. A camera that is gone or answers no more is not asked again, since
/// each request to it may take seconds.
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
    /// Opens the file of a camera, which is made where there is none, and locks it.
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

    /// What it says; nothing if it says nothing that can be read.
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

/// A camera's name and port as part of a file's name.
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
        let (taken, kept) = part_brightness(&before);
        assert_eq!(taken, [before[1], before[2]]);
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
