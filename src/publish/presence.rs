//! Whether newcomers can still find what is published: the files of iceoryx2 may be removed while they are in use.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use iceoryx2::prelude::{Config, MessagingPattern, ServiceName};

use super::SHARED_MEMORY;

/// Files that were there when the service was opened.
#[derive(Debug)]
pub(super) struct Presence(Vec<(PathBuf, Identity)>);

/// Tells a file from another one of the same name. The number alone may be given again; with the moment it was written it is not.
type Identity = (u64, u64, Option<SystemTime>);

impl Presence {
    /// What is there for the service `name` of the node `node`, and in shared memory under one of the `numbers`.
    pub(super) fn of(config: &Config, name: &ServiceName, node: u128, numbers: &[u128]) -> Self {
        let global = &config.global;
        let (prefix, nodes) = (global.prefix.to_string(), global.node_dir().to_string());
        let patterns = [MessagingPattern::PublishSubscribe, MessagingPattern::Event];
        let mut files: Vec<PathBuf> = patterns
            .map(|pattern| scene::static_file(config, name, pattern))
            .into();
        // Whoever looks for dead programs looks at these.
        for suffix in ["", "_owner_lock", "_context"] {
            let file = format!("{prefix}{node}{}{suffix}", global.node.monitor_suffix);
            files.push(Path::new(&nodes).join(file));
        }
        let ends: Vec<String> = numbers.iter().map(|number| format!("_{number}.")).collect();
        let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten();
        files.extend(entries.filter_map(Result::ok).filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            let ours = name.starts_with(&prefix) && ends.iter().any(|end| name.contains(end));
            (ours && !name.ends_with(".connection")).then(|| entry.path())
        }));
        Self(
            files
                .into_iter()
                .filter_map(|file| Some((identity(&file)?, file)))
                .map(|(identity, file)| (file, identity))
                .collect(),
        )
    }

    /// A file that is missing, or is another one now. Takes a few microseconds.
    pub(super) fn missing(&self) -> Option<&Path> {
        self.0
            .iter()
            .find(|(file, known)| identity(file).as_ref() != Some(known))
            .map(|(file, _)| file.as_path())
    }
}

fn identity(file: &Path) -> Option<Identity> {
    let found = fs::symlink_metadata(file).ok()?;
    // Shared memory is written to all the time, and its numbers are not given again.
    let written = (!file.starts_with(SHARED_MEMORY)).then(|| found.modified().ok());
    Some((found.dev(), found.ino(), written.flatten()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_was_removed_or_replaced_is_missing() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut config = Config::default();
        let root = folder.path().to_str().expect("text");
        config
            .global
            .set_root_path(&root.try_into().expect("a path"));
        let name = ServiceName::new("present/scene").expect("a name");
        let file = scene::static_file(&config, &name, MessagingPattern::Event);
        fs::create_dir_all(file.parent().expect("a folder")).expect("made");
        fs::write(&file, b"one").expect("written");
        let presence = Presence::of(&config, &name, 1, &[]);
        assert_eq!(presence.0.len(), 1, "what is not there is not missed");
        assert_eq!(presence.missing(), None);
        let other = folder.path().join("other");
        fs::write(&other, b"two").expect("written");
        fs::rename(&other, &file).expect("replaced");
        assert_eq!(presence.missing(), Some(file.as_path()));
        fs::remove_file(&file).expect("removed");
        assert_eq!(presence.missing(), Some(file.as_path()));
    }
}
