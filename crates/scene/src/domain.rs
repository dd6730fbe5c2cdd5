//! Where a subscriber finds overcam in shared memory, and how it gives overcam access to its own
//! files there.
//!
//! There are three places, each with a directory for the files of iceoryx2 and a prefix for its
//! shared memory:
//!
//! * the default of iceoryx2, `/tmp/iceoryx2`, if one user runs everything;
//! * `/dev/shm/overcam.UID`, where overcam publishes if another user's files block the first;
//! * `/dev/shm/overcam-GROUP` for `overcam --group GROUP`, which only members of the group can
//!   enter.
//!
//! iceoryx2 gives access to the files it creates only to their owner. In a group's place, each side
//! therefore has to open its files to the group. overcam does so itself; a subscriber calls
//! [`admit`] once it has its ports.

extern crate std;

use std::format;
use std::fs::{self, DirEntry, Permissions};
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};

use iceoryx2::prelude::{Config, FileName, MessagingPattern, PortFactory, ServiceName, ipc};
use iceoryx2::service::Service;
use iceoryx2::service::service_hash::ServiceHash;

/// Environment variable that names the group of `overcam --group GROUP` for [`config`].
pub const GROUP_VARIABLE: &str = "OVERCAM_GROUP";

/// Where Linux keeps shared memory.
const SHARED_MEMORY: &str = "/dev/shm";

/// The configuration with which a subscriber currently finds the service `name` (`NAME/scene`).
///
/// If the environment variable [`GROUP_VARIABLE`] is set, it is that of the group. Otherwise it is
/// that of the user if overcam publishes there, else that of iceoryx2. Call this again while
/// waiting for the service.
///
/// # Errors
///
/// [`io::ErrorKind::NotFound`] while overcam has not created the group's directory yet. Any error
/// that keeps this user from reading it, usually that the user is not a member of the group.
pub fn config(name: &ServiceName) -> io::Result<Config> {
    match std::env::var(GROUP_VARIABLE) {
        Ok(group) if !group.is_empty() => group_config(&group),
        _ => Ok(own_config(name)),
    }
}

/// The configuration for the place of a group.
///
/// # Errors
///
/// As for [`config`].
pub fn group_config(group: &str) -> io::Result<Config> {
    let directory = group_directory(group)?;
    let metadata = fs::symlink_metadata(&directory)?;
    // A non-member who can write there could publish scenes in overcam's name.
    if !metadata.is_dir() || metadata.mode() & 0o007 != 0 {
        return Err(io::Error::other(format!(
            "{} is no directory of a group",
            directory.display()
        )));
    }
    fs::read_dir(&directory)?;
    configured(&directory, &format!("ovc{:08x}_", fnv1a(group)))
}

/// Distinguishes groups in the names of shared memory, which has no directories, and keeps the
/// paths of sockets short.
fn fnv1a(text: &str) -> u32 {
    let mix = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    text.bytes().fold(0x811c_9dc5, mix)
}

/// The directory of a group's place.
///
/// # Errors
///
/// [`io::ErrorKind::InvalidInput`]: the name cannot be a group's.
pub fn group_directory(group: &str) -> io::Result<PathBuf> {
    let possible = |byte: u8| byte.is_ascii_alphanumeric() || b"_-.$".contains(&byte);
    if group.is_empty() || group.len() > 32 || !group.bytes().all(possible) {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("{group:?} cannot be the name of a group"),
        ));
    }
    Ok(Path::new(SHARED_MEMORY).join(format!("overcam-{group}")))
}

/// The configuration for the place of one user, whether or not its directory exists.
///
/// # Errors
///
/// Never, on Linux.
pub fn user_config(uid: u32) -> io::Result<Config> {
    let directory = Path::new(SHARED_MEMORY).join(format!("overcam.{uid}"));
    configured(&directory, &format!("ovu{uid}_"))
}

/// The file by which new subscribers find a service.
#[must_use]
pub fn static_file(config: &Config, name: &ServiceName, pattern: MessagingPattern) -> PathBuf {
    let hash = ServiceHash::new::<<ipc::Service as Service>::ServiceNameHasher>(name, pattern);
    let global = &config.global;
    Path::new(&global.service_dir().to_string()).join(format!(
        "{}{hash}{}",
        global.prefix, global.service.static_config_storage_suffix
    ))
}

/// Whether new subscribers still find the opened service. If its files were removed while it was in
/// use, overcam publishes it again. A subscriber that receives nothing for a second should check
/// this and open the service again.
#[must_use]
pub fn is_current<S: Service>(service: &impl PortFactory<Service = S>, config: &Config) -> bool {
    let pattern = MessagingPattern::PublishSubscribe;
    match S::details(service.name(), config, pattern) {
        Ok(Some(details)) => {
            details.static_details.unique_service_id() == service.unique_service_id()
                && details.dynamic_details.is_some()
        }
        Ok(None) => false,
        Err(_) => static_file(config, service.name(), pattern).exists(),
    }
}

/// Gives the group access to what this user has opened in the group's place; does nothing
/// elsewhere. Call this once the ports exist: until then overcam cannot send to them, unless it
/// runs as root.
///
/// Members can then read and write the shared memory that passes on messages, but only read the
/// scenes themselves.
///
/// # Errors
///
/// If the directory cannot be read.
pub fn admit(config: &Config) -> io::Result<()> {
    let root = config.global.root_path().to_string();
    let Some(directory) = Path::new(&root).to_str().filter(|path| is_of_a_group(path)) else {
        return Ok(());
    };
    let group = fs::metadata(directory)?.gid();
    let uid = own_uid()?;
    let prefix = config.global.prefix.to_string();
    let mut files = std::vec::Vec::new();
    for (folder, prefix) in [
        (Path::new(SHARED_MEMORY), prefix.as_str()),
        (Path::new(directory), prefix.as_str()),
        (&Path::new(directory).join("services"), ""),
    ] {
        let entries = fs::read_dir(folder).into_iter().flatten();
        let named = |entry: &DirEntry| {
            let name = entry.file_name();
            name.as_encoded_bytes().starts_with(prefix.as_bytes())
        };
        files.extend(entries.filter_map(Result::ok).filter(named));
    }
    // After the files: a port has its tag before its connections.
    let tags = PortTags::read(Path::new(directory));
    for file in &files {
        // A file that somebody else has just removed needs nothing.
        let _ = admit_to(file, uid, group, &tags);
    }
    Ok(())
}

/// Opens one file to the group. Removes it instead if it is an unused connection that only its
/// owner can remove.
fn admit_to(entry: &DirEntry, uid: u32, group: u32, tags: &PortTags) -> io::Result<()> {
    let path = entry.path();
    let metadata = fs::symlink_metadata(&path)?;
    let kind = metadata.file_type();
    if metadata.uid() != uid || !(kind.is_file() || kind.is_socket()) {
        return Ok(());
    }
    let name = path.to_string_lossy();
    if name.ends_with(".connection") && tags.is_stale(&name) {
        return fs::remove_file(&path);
    }
    // Other modes mark files that are still being written.
    let mode = match metadata.mode() & 0o777 {
        0o400 => 0o440,
        0o600 if name.ends_with(".data") => 0o640,
        0o600 => 0o660,
        0o666 if name.ends_with(".global_mgmt") => 0o660,
        _ => return Ok(()),
    };
    chown(&path, None, Some(group))?;
    fs::set_permissions(&path, Permissions::from_mode(mode))
}

/// The ports of all programs in one place: each has a file in its program's directory while it
/// exists.
struct PortTags(String);

impl PortTags {
    fn read(directory: &Path) -> Self {
        let mut names = String::new();
        let nodes = fs::read_dir(directory.join("nodes")).into_iter().flatten();
        for node in nodes.filter_map(Result::ok) {
            let files = fs::read_dir(node.path()).into_iter().flatten();
            for file in files.filter_map(Result::ok) {
                names.push_str(&file.file_name().to_string_lossy());
                names.push('\n');
            }
        }
        Self(names)
    }

    /// Whether the receiver of a connection, the last number in its name, is gone.
    fn is_stale(&self, connection: &str) -> bool {
        let number = connection
            .strip_suffix(".connection")
            .and_then(|name| name.rsplit('_').next());
        number.is_some_and(|number| !self.0.contains(&format!("_{number}.port_tag")))
    }
}

fn own_config(name: &ServiceName) -> Config {
    let default = Config::default();
    let Ok(uid) = own_uid() else {
        return default;
    };
    let Ok(own) = user_config(uid) else {
        return default;
    };
    let file = |config| static_file(config, name, MessagingPattern::PublishSubscribe);
    let owner = |config| fs::metadata(file(config)).map(|metadata| metadata.uid());
    match (owner(&own), owner(&default)) {
        (Ok(_), _) => own,
        // Not readable: this user's overcam will be in the other place.
        (_, Ok(owner)) if owner != uid && uid != 0 => own,
        _ => default,
    }
}

fn configured(directory: &Path, prefix: &str) -> io::Result<Config> {
    let invalid = |_| io::Error::from(io::ErrorKind::InvalidInput);
    let path = directory.to_string_lossy();
    let mut config = Config::default();
    config
        .global
        .set_root_path(&path.as_ref().try_into().map_err(invalid)?);
    config.global.prefix = FileName::try_from(prefix).map_err(invalid)?;
    Ok(config)
}

fn is_of_a_group(root_path: &str) -> bool {
    root_path
        .strip_prefix(SHARED_MEMORY)
        .is_some_and(|rest| rest.starts_with("/overcam-"))
}

fn own_uid() -> io::Result<u32> {
    fs::metadata("/proc/self").map(|metadata| metadata.uid())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_no_group_can_have_are_refused() {
        let longest = "g".repeat(32);
        for group in ["robots", "domain-users", "1000", "a.b", longest.as_str()] {
            let directory = group_directory(group).expect("it is possible");
            assert_eq!(
                directory,
                Path::new("/dev/shm").join(format!("overcam-{group}"))
            );
        }
        let too_long = "g".repeat(33);
        for group in ["", "a/b", "..", "two words", "caf\u{e9}", too_long.as_str()] {
            if group == ".." {
                continue; // overcam-.. is an ordinary name
            }
            let error = group_directory(group).expect_err("it is not possible");
            assert_eq!(error.kind(), io::ErrorKind::InvalidInput, "{group}");
        }
    }

    #[test]
    fn a_socket_in_the_place_of_the_longest_group_has_a_possible_path() {
        let group = group_directory(&"g".repeat(32)).expect("it is possible");
        let prefix = format!("ovc{:08x}_", fnv1a("robots"));
        assert_eq!(prefix, "ovc15c89ec4_");
        let socket = group.join(format!("{prefix}{}.event", u128::MAX >> 16));
        assert!(socket.as_os_str().len() <= 107, "{}", socket.display());
    }

    #[test]
    fn a_connection_is_stale_when_its_receiver_has_no_tag() {
        let tags = PortTags(String::from("ovc7_12.port_tag\novc7_345.port_tag\n"));
        assert!(!tags.is_stale("/dev/shm/ovc7_abc_9_345.connection"));
        assert!(tags.is_stale("/dev/shm/ovc7_abc_12_9.connection"));
        assert!(tags.is_stale("/dev/shm/ovc7_abc_9_45.connection"));
        assert!(!tags.is_stale("/dev/shm/ovc7_abc_9_45.data"));
    }
}
