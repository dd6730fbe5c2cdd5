//! Checks whether newcomers can still find the service: the files of iceoryx2 may be removed while
//! they are in use.

use std::fs::{self, Permissions};
use std::io;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use iceoryx2::prelude::{Config, MessagingPattern, ServiceName};

use super::SHARED_MEMORY;

/// Required files, with their identity when the service was opened. A file may have been removed
/// before the identity was read.
#[derive(Debug)]
pub(super) struct Presence {
    descriptions: Vec<Description>,
    others: Vec<(PathBuf, Option<Identity>)>,
}

/// The file by which newcomers find a service. It never changes, so it can be restored. The last
/// participant to leave a service removes it by name, and thereby possibly that of a newer service:
/// this happens with subscribers that were connected when everything was removed.
#[derive(Debug)]
struct Description {
    file: PathBuf,
    identity: Option<Identity>,
    mode: u32,
    text: Vec<u8>,
}

/// State of the files.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// All exist.
    Whole,
    /// This one was missing and has been restored; connected participants are not affected.
    PutBack(PathBuf),
    /// This one is missing or has been replaced: newcomers find nothing, or another service.
    Missing(PathBuf),
}

/// Distinguishes a file from another one of the same name. Inode numbers may be reused, but not
/// together with the modification time.
type Identity = (u64, u64, Option<SystemTime>);

impl Presence {
    /// The files required for the service `name` and the node `node`, and those in shared memory
    /// with one of the `numbers`.
    pub(super) fn of(config: &Config, name: &ServiceName, node: u128, numbers: &[u128]) -> Self {
        let global = &config.global;
        let (prefix, nodes) = (global.prefix.to_string(), global.node_dir().to_string());
        let patterns = [MessagingPattern::PublishSubscribe, MessagingPattern::Event];
        let descriptions = patterns
            .map(|pattern| Description::read(scene::static_file(config, name, pattern)))
            .into();
        // These files are used to detect dead programs.
        let mut files: Vec<PathBuf> = ["", "_owner_lock", "_context"]
            .map(|suffix| format!("{prefix}{node}{}{suffix}", global.node.monitor_suffix))
            .map(|file| Path::new(&nodes).join(file))
            .into();
        let ends: Vec<String> = numbers.iter().map(|number| format!("_{number}.")).collect();
        let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten();
        files.extend(entries.filter_map(Result::ok).filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            let ours = name.starts_with(&prefix) && ends.iter().any(|end| name.contains(end));
            (ours && !name.ends_with(".connection")).then(|| entry.path())
        }));
        let others = files.into_iter().map(|file| (identity(&file), file));
        Self {
            descriptions,
            others: others.map(|(identity, file)| (file, identity)).collect(),
        }
    }

    /// Checks all files and restores what can be restored. Takes a few microseconds if nothing is
    /// missing.
    pub(super) fn look(&mut self) -> Found {
        for (file, known) in &self.others {
            if known.is_none() || identity(file) != *known {
                return Found::Missing(file.clone());
            }
        }
        for description in &mut self.descriptions {
            let found = identity(&description.file);
            if description.identity.is_some() && found == description.identity {
                continue;
            }
            // An existing file belongs to another program that has taken the place meanwhile.
            return if description.identity.is_some()
                && found.is_none()
                && description.put_back().is_ok()
            {
                Found::PutBack(description.file.clone())
            } else {
                Found::Missing(description.file.clone())
            };
        }
        Found::Whole
    }
}

impl Description {
    fn read(file: PathBuf) -> Self {
        let (identity, mode) = (
            identity(&file),
            fs::metadata(&file).map(|found| found.mode()),
        );
        let text = fs::read(&file);
        Self {
            identity: identity.filter(|_| text.is_ok()),
            mode: mode.unwrap_or_default() & 0o777,
            text: text.unwrap_or_default(),
            file,
        }
    }

    /// Atomically, because the mode of a partly written file marks its service as not ready.
    fn put_back(&mut self) -> io::Result<()> {
        let new = self
            .file
            .with_extension(format!("new-{}", std::process::id()));
        let written = fs::write(&new, &self.text)
            .and_then(|()| fs::set_permissions(&new, Permissions::from_mode(self.mode)))
            // Without overwriting a file created meanwhile.
            .and_then(|()| fs::hard_link(&new, &self.file));
        let _ = fs::remove_file(&new);
        written?;
        self.identity = identity(&self.file);
        Ok(())
    }
}

fn identity(file: &Path) -> Option<Identity> {
    let found = fs::symlink_metadata(file).ok()?;
    // Shared memory is written to all the time, and its inode numbers are not reused.
    let written = (!file.starts_with(SHARED_MEMORY)).then(|| found.modified().ok());
    Some((found.dev(), found.ino(), written.flatten()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_restored_or_reported() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut config = Config::default();
        let root = folder.path().to_str().expect("text");
        config
            .global
            .set_root_path(&root.try_into().expect("a path"));
        let name = ServiceName::new("present/scene").expect("a name");
        let presence = || Presence::of(&config, &name, 1, &[]);
        let described = presence().descriptions.into_iter().map(|d| d.file);
        let files: Vec<PathBuf> = described
            .chain(presence().others.into_iter().map(|(file, _)| file))
            .collect();
        for file in &files {
            assert!(
                matches!(presence().look(), Found::Missing(_)),
                "not all are there"
            );
            fs::create_dir_all(file.parent().expect("a folder")).expect("made");
            fs::write(file, b"one").expect("written");
            fs::set_permissions(file, Permissions::from_mode(0o440)).expect("ours");
        }
        let mut presence = presence();
        assert_eq!(presence.look(), Found::Whole);

        fs::remove_file(&files[1]).expect("removed");
        assert_eq!(presence.look(), Found::PutBack(files[1].clone()));
        let found = fs::metadata(&files[1]).expect("it is there");
        assert_eq!((found.mode() & 0o777, found.len()), (0o440, 3));
        assert_eq!(presence.look(), Found::Whole);
        let services = files[1].parent().expect("a folder");
        assert_eq!(fs::read_dir(services).expect("listed").count(), 2);

        // A file of another program is not touched.
        let other = folder.path().join("other");
        fs::write(&other, b"two").expect("written");
        fs::rename(&other, &files[0]).expect("replaced");
        assert_eq!(presence.look(), Found::Missing(files[0].clone()));
        assert_eq!(fs::read(&files[0]).expect("read"), b"two");

        fs::remove_file(&files[3]).expect("removed");
        assert_eq!(presence.look(), Found::Missing(files[3].clone()));
    }
}
