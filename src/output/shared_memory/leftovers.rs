//! Finds the programs behind a service that cannot be opened, and removes the remains of dead ones.
//!
//! iceoryx2 removes the remains of its own version. Remains of another version, and those that
//! survived a power failure because `/tmp` is on a disk while `/dev/shm` is not, block the name of
//! the service permanently.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use iceoryx2::prelude::{
    CallbackProgression, Config, LogLevel, MessagingPattern, Node, NodeState, ServiceName,
    set_log_level,
};
use serde::Deserialize;

use super::place::user_name;
use super::{Ipc, SHARED_MEMORY};

/// The version of iceoryx2 used by this program, as stated in its files.
const ICEORYX2: Version = Version {
    major: 0,
    minor: 10,
    patch: 0,
};

/// The programs behind a service, dead or alive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Programs {
    /// Process number and difference, for a message.
    pub(crate) reason: String,
    /// Whether one of them is alive, as far as can be determined.
    pub(crate) alive: bool,
    /// The files of the service itself.
    files: Vec<PathBuf>,
    /// Node numbers of the dead ones.
    dead: Vec<String>,
}

/// Content of a service's file. Other versions have additional fields.
#[derive(Debug, Default, Deserialize)]
struct StaticFile {
    iceoryx2_version: Option<Version>,
    unique_service_id: Option<Creator>,
    messaging_pattern: Option<Pattern>,
}

#[derive(Debug, Deserialize, PartialEq, Eq, Clone, Copy)]
struct Version {
    major: u32,
    minor: u32,
    patch: u32,
}

#[derive(Debug, Deserialize)]
struct Creator {
    pid: Option<u32>,
}

#[derive(Debug, Deserialize)]
struct Pattern {
    #[serde(rename = "PublishSubscribe")]
    publish_subscribe: Option<Messages>,
}

#[derive(Debug, Deserialize)]
struct Messages {
    message_type_details: Option<MessageTypes>,
}

#[derive(Debug, Deserialize)]
struct MessageTypes {
    payload: Option<Payload>,
}

#[derive(Debug, Deserialize)]
struct Payload {
    type_name: Option<String>,
    size: Option<u64>,
}

/// The programs behind the service `name`; `None` if it has no files.
pub(crate) fn programs(config: &Config, name: &ServiceName) -> Option<Programs> {
    set_log_level(LogLevel::Fatal);
    let files: Vec<PathBuf> = [MessagingPattern::PublishSubscribe, MessagingPattern::Event]
        .map(|pattern| scene::static_file(config, name, pattern))
        .into_iter()
        .filter(|file| fs::symlink_metadata(file).is_ok())
        .collect();
    let first = files.first()?;
    let mut dead = tagged_nodes(config, &files);
    let mut living = Vec::new();
    let _ = Node::<Ipc>::list(config, |state| {
        let number = state.node_id().value().to_string();
        let before = dead.len();
        if !matches!(state, NodeState::Dead(_)) {
            dead.retain(|node| *node != number);
        }
        if dead.len() < before {
            living.push(state.node_id().pid::<Ipc>().ok().map(|pid| pid.value()));
        }
        CallbackProgression::Continue
    });
    let described = fs::read_to_string(first)
        .ok()
        .and_then(|text| toml::from_str::<StaticFile>(&text).ok());
    Some(Programs {
        reason: reason(described.as_ref(), &living, first),
        alive: !living.is_empty(),
        files,
        dead,
    })
}

fn reason(file: Option<&StaticFile>, living: &[Option<i32>], path: &Path) -> String {
    let Some(file) = file else {
        let owner = fs::symlink_metadata(path).map(|metadata| user_name(metadata.uid()));
        return match owner {
            Ok(owner) => format!("{} belongs to user {owner}", path.display()),
            Err(_) => format!("{} cannot be read", path.display()),
        };
    };
    let version = file.iceoryx2_version;
    // Before 0.10 the process number is in the file; since then it is part of the node number.
    let pid = match (version, &file.unique_service_id) {
        (None, Some(Creator { pid: Some(pid) })) => Some(i64::from(*pid)),
        _ => living.iter().flatten().next().map(|&pid| i64::from(pid)),
    };
    let who = match pid {
        Some(pid) if !living.is_empty() => format!("process {pid} has "),
        _ => String::new(),
    };
    let ours = |version: Version| {
        let Version {
            major,
            minor,
            patch,
        } = version;
        format!("iceoryx2 {major}.{minor}.{patch}")
    };
    let theirs = match version {
        Some(version) => ours(version),
        None => "iceoryx2 0.9 or older".to_owned(),
    };
    let payload = file
        .messaging_pattern
        .as_ref()
        .and_then(|pattern| pattern.publish_subscribe.as_ref())
        .and_then(|messages| messages.message_type_details.as_ref())
        .and_then(|types| types.payload.as_ref());
    let scene = match payload {
        Some(Payload {
            type_name: Some(name),
            size: Some(size),
        }) => format!(" and scene `{name}` of {size} bytes"),
        _ => String::new(),
    };
    format!(
        "{who}{theirs}{scene}; this overcam has {} and a scene of {} bytes",
        ours(ICEORYX2),
        size_of::<scene::Scene>()
    )
}

/// The numbers of the nodes that have a tag of one of the services.
fn tagged_nodes(config: &Config, files: &[PathBuf]) -> Vec<String> {
    let tags: Vec<String> = files
        .iter()
        .filter_map(|file| Some(format!("{}.service_tag", file.file_stem()?.to_str()?)))
        .collect();
    let folders = fs::read_dir(config.global.node_dir().to_string());
    folders
        .into_iter()
        .flatten()
        .filter_map(Result::ok)
        .filter(|node| tags.iter().any(|tag| node.path().join(tag).exists()))
        .filter_map(|node| node.file_name().into_string().ok())
        .collect()
}

impl Programs {
    /// Removes the remains of dead programs, so that the service can be opened again.
    ///
    /// # Errors
    ///
    /// Files of the service that could not be removed, separated by spaces; usually they belong to
    /// another user.
    pub(crate) fn remove(&self, config: &Config) -> Result<(), String> {
        let prefix = config.global.prefix.to_string();
        let node_dir = PathBuf::from(config.global.node_dir().to_string());
        let mut numbers: Vec<String> = Vec::new();
        for file in &self.files {
            // Before 0.10 the shared memory of a service is named after its file.
            numbers.extend(
                file.file_stem()
                    .and_then(|stem| stem.to_str()?.strip_prefix(&prefix).map(ToOwned::to_owned)),
            );
        }
        for node in &self.dead {
            let folder = node_dir.join(node);
            for tag in names(&folder) {
                let port = tag.strip_suffix(".port_tag");
                numbers.extend(
                    port.and_then(|port| port.strip_prefix(&prefix))
                        .map(ToOwned::to_owned),
                );
            }
            let _ = fs::remove_dir_all(&folder);
            let monitor = format!("{prefix}{node}.");
            remove_matching(&node_dir, |name| name.starts_with(&monitor));
        }
        remove_matching(Path::new(SHARED_MEMORY), |name| {
            let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
            name.starts_with(&prefix)
                && stem
                    .split('_')
                    .any(|part| numbers.iter().any(|n| n == part))
        });
        let left: Vec<String> = self
            .files
            .iter()
            .filter(|file| !removed(file))
            .map(|file| file.display().to_string())
            .collect();
        if left.is_empty() {
            Ok(())
        } else {
            Err(left.join(" "))
        }
    }
}

fn removed(file: &Path) -> bool {
    match fs::remove_file(file) {
        Ok(()) => true,
        Err(error) => error.kind() == io::ErrorKind::NotFound,
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect()
}

fn remove_matching(folder: &Path, matches: impl Fn(&str) -> bool) {
    for name in names(folder) {
        if matches(&name) {
            // Files of other users cannot be removed.
            let _ = fs::remove_file(folder.join(name));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fields written by iceoryx2 0.9 that are read.
    const OLD: &str = "service_hash = \"9bbd\"\nservice_name = \"v/scene\"\nattributes = []\n\
        [unique_service_id]\npid = 26307\nseconds = 3419\nnanoseconds = 79\ncounter = 1\n\
        [messaging_pattern.PublishSubscribe]\nmax_subscribers = 8\n\
        [messaging_pattern.PublishSubscribe.message_type_details.payload]\n\
        variant = \"FixedSize\"\ntype_name = \"S\"\nsize = 8\nalignment = 8\n";

    fn described(text: &str, living: &[Option<i32>]) -> String {
        let file: StaticFile = toml::from_str(text).expect("it is read");
        reason(Some(&file), living, Path::new("file"))
    }

    #[test]
    fn what_differs_is_named() {
        let line = described(OLD, &[None]);
        assert!(
            line.starts_with(
                "process 26307 has iceoryx2 0.9 or older and scene `S` of 8 bytes; this overcam has iceoryx2 0.10.0"
            ),
            "{line}"
        );
        assert!(described(OLD, &[]).starts_with("iceoryx2 0.9 or older and scene"));
        let newer = "[iceoryx2_version]\nmajor = 0\nminor = 11\npatch = 2\n\
            [unique_service_id]\npayload_value = 1\nunique_value = 2\n[messaging_pattern.Event]\nmax_nodes = 20\n";
        let line = described(newer, &[Some(77)]);
        assert!(
            line.starts_with("process 77 has iceoryx2 0.11.2; this"),
            "{line}"
        );
        let unread = reason(None, &[], Path::new("/"));
        assert_eq!(unread, "/ belongs to user root");
    }

    #[test]
    fn the_remains_of_dead_programs_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut config = Config::default();
        let root = folder.path().to_str().expect("text");
        config
            .global
            .set_root_path(&root.try_into().expect("a path"));
        let name = ServiceName::new("leftover/scene").expect("a name");
        assert_eq!(programs(&config, &name), None);

        let file = scene::static_file(&config, &name, MessagingPattern::PublishSubscribe);
        let tag = format!(
            "{}.service_tag",
            file.file_stem().and_then(|s| s.to_str()).expect("text")
        );
        let node = folder.path().join("nodes/17");
        fs::create_dir_all(file.parent().expect("a folder")).expect("made");
        fs::create_dir_all(&node).expect("made");
        fs::create_dir_all(folder.path().join("nodes/18")).expect("made");
        let other = folder.path().join("services/iox2_other.service");
        for (path, text) in [
            (&file, OLD),
            (&other, ""),
            (&node.join(tag), ""),
            (&folder.path().join("nodes/iox2_17.node_monitor"), ""),
            (&folder.path().join("nodes/iox2_18.node_monitor"), ""),
        ] {
            fs::write(path, text).expect("written");
        }
        let found = programs(&config, &name).expect("it has files");
        assert!(!found.alive);
        assert_eq!(found.dead, ["17"]);
        found.remove(&config).expect("all is ours");
        assert_eq!(programs(&config, &name), None);
        let mut left = names(&folder.path().join("nodes"));
        left.sort();
        assert_eq!(left, ["18", "iox2_18.node_monitor"]);
        assert!(other.exists());
    }
}
