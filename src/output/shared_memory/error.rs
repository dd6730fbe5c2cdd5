//! Errors of publishing.

use super::SHARED_MEMORY;

/// Reasons to reject the name of a service.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// There is nothing before the suffix.
    #[error("the name of a service is empty: give one with --service NAME")]
    Empty,
    /// The name is too long.
    #[error("service name `{name}` has {length} characters: at most {max} are possible")]
    TooLong {
        /// The name.
        name: String,
        /// Its length in bytes.
        length: usize,
        /// The maximum length in bytes.
        max: usize,
    },
    /// The name has characters other than visible ASCII.
    #[error(
        "service name {name:?} contains {character:?}: use letters, digits and punctuation of ASCII, without spaces"
    )]
    Character {
        /// The name.
        name: String,
        /// The first invalid character.
        character: char,
    },
    /// The name is reserved by the middleware.
    #[error(
        "service name `{name}` is reserved by iceoryx2: choose one that does not start with `iox2://`"
    )]
    Reserved {
        /// The name.
        name: String,
    },
}

/// Reasons why scenes cannot be published. None of them stops the processing of frames.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The name is invalid for a service.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Another process publishes on this service.
    #[error(
        "service `{service}` is already published by process {pid}: stop that one, or choose another name with --service NAME"
    )]
    Taken {
        /// The service.
        service: String,
        /// The publishing process.
        pid: i32,
    },
    /// A publisher died, and its remains could not be removed.
    #[error(
        "service `{service}` is blocked by a publisher that died: try again, or choose another name with --service NAME"
    )]
    Blocked {
        /// The service.
        service: String,
    },
    /// Subscribers, or another version of the program, keep the service open with a different
    /// layout or different capacities.
    #[error(
        "service `{service}` is in use by programs of another version ({reason}): stop them, or choose another name with --service NAME"
    )]
    Incompatible {
        /// The service.
        service: String,
        /// The programs and the difference.
        reason: String,
    },
    /// Files of ended programs block the service and cannot be removed.
    #[error(
        "service `{service}` is blocked by what programs that ended left behind ({reason}): remove {files}, or choose another name with --service NAME"
    )]
    Leftover {
        /// The service.
        service: String,
        /// The programs.
        reason: String,
        /// The files, separated by spaces.
        files: String,
    },
    /// The files of the middleware belong to another user.
    #[error(
        "service `{service}` cannot be opened ({reason}): run as the user to whom that belongs, have it removed, or use --no-publish"
    )]
    Denied {
        /// The service.
        service: String,
        /// The object to which access is denied.
        reason: String,
    },
    /// The shared place of the group cannot be used.
    #[error("--group {group}: {reason}")]
    Group {
        /// The group as it was given.
        group: String,
        /// What is wrong and what to do.
        reason: String,
    },
    /// Too little shared memory is left. Without this check the program would crash while writing a
    /// scene.
    #[error(
        "service `{service}` needs {needed_kib} KiB in {SHARED_MEMORY} and {free_kib} KiB are free: enlarge it (docker: --shm-size), or use --no-publish"
    )]
    NoRoom {
        /// The service.
        service: String,
        /// Memory that the service may need.
        needed_kib: u64,
        /// Memory available.
        free_kib: u64,
    },
    /// The service could not be opened for another reason.
    #[error("service `{service}` cannot be opened ({reason}): --no-publish does without it")]
    Open {
        /// The service.
        service: String,
        /// The failure, in the middleware's words.
        reason: String,
    },
    /// A leaving program removed a file that newcomers need to find the service; it has been
    /// restored.
    #[error("service `{service}`: {file} had been removed, and is put back")]
    PutBack {
        /// The service.
        service: String,
        /// The file.
        file: String,
    },
    /// The service's files were removed; it has been opened again. No scene was lost that later
    /// subscribers could have received.
    #[error(
        "service `{service}` is published anew: another program had removed {file} (systemd does so when a user logs out: RemoveIPC=no)"
    )]
    Removed {
        /// The service.
        service: String,
        /// One of the removed files.
        file: String,
    },
    /// The service's files were removed, and it cannot be opened again; this is retried every
    /// second.
    #[error("nobody can subscribe any more, since {file} was removed: {reason}")]
    Lost {
        /// One of the removed files.
        file: String,
        /// Why it cannot be opened again.
        reason: String,
    },
    /// One scene did not reach all subscribers; the next one may.
    #[error("scene {sequence} was not published on `{service}` ({reason})")]
    Send {
        /// The service.
        service: String,
        /// Sequence number of the scene's frame.
        sequence: u64,
        /// The failure, in the middleware's words.
        reason: String,
    },
    /// Subscribers could not be connected or woken; they get the next scene later, or not at all.
    #[error("subscribers of `{service}` were not woken ({reason})")]
    Wake {
        /// The service.
        service: String,
        /// The failure, in the middleware's words.
        reason: String,
    },
}
