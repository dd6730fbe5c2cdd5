//! The location of a service in shared memory, and its access rights.
//!
//! The default is the place that iceoryx2 uses for all programs, so that any subscriber finds it.
//! iceoryx2 creates the directories there for the first user alone; here they are created like
//! `/tmp`: everyone may add files, but only the owner may change them. If files of another user
//! block it nevertheless, this user's own place is used. With a group, it is a directory that only
//! its members can enter.

use std::fs::{self, Permissions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use iceoryx2::prelude::Config;
use rustix::fs::Access;
use rustix::process::{getegid, geteuid, getgroups};

use super::{PublishError, SHARED_MEMORY};

/// Maximum time that the publisher waits for a subscriber of another user that has not opened its
/// files to the group yet. A subscriber that never does blocks it this long once, and again at
/// later retries.
const UNADMITTED_TIMEOUT: Duration = Duration::from_millis(30);
/// Younger files in shared memory may belong to a service that is being created.
const SWEEP_AGE: Duration = Duration::from_secs(60);

/// A place in shared memory.
#[derive(Debug, Clone)]
pub(super) struct Place {
    pub(super) config: Config,
    pub(super) kind: Kind,
}

/// Intended users of a place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Kind {
    /// Any program of this user, and of root.
    Default,
    /// Programs of this user that look there.
    User,
    /// Members of a group.
    Group,
}

impl Place {
    /// The place that iceoryx2 uses for all programs. `Err`: the user who blocks it.
    pub(super) fn default() -> Result<Self, String> {
        let config = Config::default();
        for directory in directories(&config) {
            open_to_everybody(&directory)
                .and_then(|()| may_use(&directory))
                .map_err(|error| belongs(&directory, &error))?;
        }
        Ok(Self {
            config,
            kind: Kind::Default,
        })
    }

    /// This user's own place. `Err`: the user who blocks it.
    pub(super) fn of_user() -> Result<Self, String> {
        let uid = geteuid().as_raw();
        let config = scene::user_config(uid).map_err(|error| error.to_string())?;
        let [root, ..] = directories(&config);
        match fs::DirBuilder::new().mode(0o700).create(&root) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                return Err(belongs(&root, &error));
            }
            _ => {}
        }
        match fs::symlink_metadata(&root) {
            Ok(found) if found.is_dir() && found.uid() == uid && found.mode() & 0o022 == 0 => {}
            Ok(_) => return Err(belongs(&root, &io::ErrorKind::PermissionDenied.into())),
            Err(error) => return Err(belongs(&root, &error)),
        }
        Ok(Self {
            config,
            kind: Kind::User,
        })
    }

    /// The place of a group, given by name or number.
    pub(super) fn of_group(group: &str) -> Result<Self, PublishError> {
        let failed = |reason: String| PublishError::Group {
            group: group.to_owned(),
            reason,
        };
        let root = scene::group_directory(group).map_err(|error| failed(error.to_string()))?;
        let gid = group_id(group).map_err(failed)?;
        let member = geteuid().is_root()
            || getegid().as_raw() == gid
            || getgroups().is_ok_and(|groups| groups.iter().any(|group| group.as_raw() == gid));
        if !member {
            return Err(failed(
                "this user is not a member of it; see with `id`, add it with `sudo usermod -aG`, and log in again".to_owned(),
            ));
        }
        // From the outside in, so that the inner ones are inaccessible to others from the start.
        for directory in [root.clone(), root.join("nodes"), root.join("services")] {
            open_to_group(&directory, gid).map_err(|error| {
                failed(format!("{}; have it removed", belongs(&directory, &error)))
            })?;
        }
        let mut config = scene::group_config(group).map_err(|error| failed(error.to_string()))?;
        config.global.creation_timeout = UNADMITTED_TIMEOUT;
        Ok(Self {
            config,
            kind: Kind::Group,
        })
    }

    /// The directory of the place.
    pub(super) fn root(&self) -> PathBuf {
        let [root, ..] = directories(&self.config);
        root
    }

    /// Removes this user's remains of services that no longer exist. The last subscriber removes a
    /// service, but if it is another user it cannot remove all of it.
    pub(super) fn sweep(&self) {
        let [_, _, services] = directories(&self.config);
        let in_use = fs::read_dir(&services).is_ok_and(|mut files| files.next().is_some());
        if self.kind != Kind::Group || in_use {
            return;
        }
        let prefix = self.config.global.prefix.to_string();
        let uid = geteuid().as_raw();
        for entry in fs::read_dir(SHARED_MEMORY)
            .into_iter()
            .flatten()
            .filter_map(Result::ok)
        {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Ok(found) = entry.metadata() else {
                continue;
            };
            // Another service of this user may be starting.
            let old = found
                .modified()
                .is_ok_and(|written| written.elapsed().is_ok_and(|age| age > SWEEP_AGE));
            let of_a_service = [".data", ".dynamic", ".connection", ".event_mgmt"]
                .iter()
                .any(|suffix| name.ends_with(suffix));
            if name.starts_with(&prefix) && of_a_service && found.uid() == uid && old {
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    /// Lets members of the group access the files created so far; no effect elsewhere.
    pub(super) fn admit(&self) {
        // Files not admitted yet are admitted the next time.
        let _ = scene::admit(&self.config);
    }
}

/// The directory of the place, and its subdirectories.
fn directories(config: &Config) -> [PathBuf; 3] {
    let global = &config.global;
    [*global.root_path(), global.node_dir(), global.service_dir()]
        .map(|path| PathBuf::from(path.to_string()))
}

/// Creates a directory in which everyone may create files, unless it exists.
fn open_to_everybody(directory: &Path) -> io::Result<()> {
    match fs::create_dir(directory) {
        // Not with the mode immediately: the umask would be subtracted from it.
        Ok(()) => fs::set_permissions(directory, Permissions::from_mode(0o1777)),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        Err(error) => Err(error),
    }
}

/// Creates a directory in which members of the group may create files, or checks that it is one.
fn open_to_group(directory: &Path, gid: u32) -> io::Result<()> {
    match fs::DirBuilder::new().mode(0o700).create(directory) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    let found = fs::symlink_metadata(directory)?;
    if !found.is_dir() {
        return Err(io::ErrorKind::NotADirectory.into());
    }
    if found.gid() == gid && found.mode() & 0o7777 == 0o2770 {
        return Ok(());
    }
    if found.uid() != geteuid().as_raw() {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    chown(directory, None, Some(gid))?;
    fs::set_permissions(directory, Permissions::from_mode(0o2770))
}

fn may_use(directory: &Path) -> io::Result<()> {
    rustix::fs::access(
        directory,
        Access::READ_OK | Access::WRITE_OK | Access::EXEC_OK,
    )?;
    Ok(())
}

/// What is wrong with a directory.
fn belongs(directory: &Path, error: &io::Error) -> String {
    let owner = match fs::symlink_metadata(directory) {
        Ok(found) => format!("belongs to user {}", user_name(found.uid())),
        Err(_) => "cannot be made".to_owned(),
    };
    format!("{} {owner}: {error}", directory.display())
}

/// The user's name if it is in the machine's own list, otherwise the number.
pub(crate) fn user_name(uid: u32) -> String {
    let users = fs::read_to_string("/etc/passwd").unwrap_or_default();
    let name = users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(uid)).then(|| name.to_owned())
    });
    name.unwrap_or_else(|| uid.to_string())
}

/// The number of a group. Groups that are not in the machine's own list (LDAP and the like) are
/// resolved with `getent`.
fn group_id(group: &str) -> Result<u32, String> {
    let of_line = |line: &str| {
        let mut fields = line.split(':');
        let found = fields.next() == Some(group);
        found.then(|| fields.nth(1)?.parse().ok()).flatten()
    };
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    if let Some(gid) = groups.lines().find_map(of_line) {
        return Ok(gid);
    }
    if let Ok(gid) = group.parse() {
        return Ok(gid);
    }
    let asked = Command::new("getent").args(["group", "--", group]).output();
    let answer = asked.map(|asked| asked.stdout).unwrap_or_default();
    String::from_utf8_lossy(&answer)
        .lines()
        .find_map(of_line)
        .ok_or_else(|| {
            "there is no such group; make it with `sudo groupadd`, or give a group's number"
                .to_owned()
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_directory_for_everybody_is_like_tmp_whatever_the_umask() {
        let folder = tempfile::tempdir().expect("a folder");
        let directory = folder.path().join("services");
        open_to_everybody(&directory).expect("made");
        let mode = |path: &Path| fs::metadata(path).expect("it is there").mode() & 0o7777;
        assert_eq!(mode(&directory), 0o1777);
        // Existing directories are not changed.
        fs::set_permissions(&directory, Permissions::from_mode(0o750)).expect("ours");
        open_to_everybody(&directory).expect("there");
        assert_eq!(mode(&directory), 0o750);
    }

    #[test]
    fn a_directory_of_a_group_is_closed_to_others() {
        let folder = tempfile::tempdir().expect("a folder");
        let directory = folder.path().join("robots");
        let gid = getegid().as_raw();
        for _ in 0..2 {
            open_to_group(&directory, gid).expect("made, or there");
            let found = fs::metadata(&directory).expect("it is there");
            assert_eq!((found.mode() & 0o7777, found.gid()), (0o2770, gid));
            fs::set_permissions(&directory, Permissions::from_mode(0o777)).expect("ours");
        }
        let file = folder.path().join("file");
        fs::write(&file, b"").expect("written");
        assert!(open_to_group(&file, gid).is_err());
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path(), &link).expect("linked");
        assert!(open_to_group(&link, gid).is_err());
    }

    #[test]
    fn groups_are_known_by_name_and_number() {
        assert_eq!(group_id("root"), Ok(0));
        assert_eq!(group_id("4711"), Ok(4711));
        assert!(group_id("no-such-group-here").is_err_and(|line| line.contains("groupadd")));
        assert_eq!(user_name(0), "root");
    }
}
