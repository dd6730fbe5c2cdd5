//! Why scenes cannot be published.

use super::SHARED_MEMORY;

/// Why a name cannot name a service.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// There is nothing in front of the suffix.
    #[error("the name of a service is empty: give one with --service NAME")]
    Empty,
    /// The name does not fit.
    #[error("service name `{name}` has {length} characters: at most {max} are possible")]
    TooLong {
        /// The name.
        name: String,
        /// Its length in bytes.
        length: usize,
        /// The greatest possible length in bytes.
        max: usize,
    },
    /// The name holds something other than visible ASCII characters.
    #[error(
        "service name {name:?} contains {character:?}: use letters, digits and punctuation of ASCII, without spaces"
    )]
    Character {
        /// The name.
        name: String,
        /// The first character that is not possible.
        character: char,
    },
    /// The middleware keeps such names for itself.
    #[error(
        "service name `{name}` is reserved by iceoryx2: choose one that does not start with `iox2://`"
    )]
    Reserved {
        /// The name.
        name: String,
    },
}

/// Why scenes cannot be published. None of them is a reason to stop processing frames.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The name cannot name a service.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Another process publishes on this service.
    #[error(
        "service `{service}` is already published by process {pid}: stop that one, or choose another name with --service NAME"
    )]
    Taken {
        /// The service.
        service: String,
        /// The process that publishes.
        pid: i32,
    },
    /// A publisher died and could not be cleared away.
    #[error(
        "service `{service}` is blocked by a publisher that died: try again, or choose another name with --service NAME"
    )]
    Blocked {
        /// The service.
        service: String,
    },
    /// Subscribers, or another version of the program, keep the service open with another layout or other capacities.
    #[error(
        "service `{service}` is in use by programs of another version ({reason}): stop them, or choose another name with --service NAME"
    )]
    Incompatible {
        /// The service.
        service: String,
        /// Who they are and what differs.
        reason: String,
    },
    /// Files of programs that ended are in the way and cannot be removed.
    #[error(
        "service `{service}` is blocked by what programs that ended left behind ({reason}): remove {files}, or choose another name with --service NAME"
    )]
    Leftover {
        /// The service.
        service: String,
        /// Who they were.
        reason: String,
        /// The files, with spaces in between.
        files: String,
    },
    /// The files of the middleware belong to another user.
    #[error(
        "service `{service}` cannot be opened ({reason}): run as the user to whom that belongs, have it removed, or use --no-publish"
    )]
    Denied {
        /// The service.
        service: String,
        /// What is denied.
        reason: String,
    },
    /// The place that members of a group share cannot be used.
    #[error("--group {group}: {reason}")]
    Group {
        /// The group as it was given.
        group: String,
        /// What is wrong and what to do.
        reason: String,
    },
    /// There is too little shared memory left. Going on would end the program in the middle of a scene.
    #[error(
        "service `{service}` needs {needed_kib} KiB in {SHARED_MEMORY} and {free_kib} KiB are free: enlarge it (docker: --shm-size), or use --no-publish"
    )]
    NoRoom {
        /// The service.
        service: String,
        /// What the service may take.
        needed_kib: u64,
        /// What is left.
        free_kib: u64,
    },
    /// The service could not be opened for another reason.
    #[error("service `{service}` cannot be opened ({reason}): --no-publish does without it")]
    Open {
        /// The service.
        service: String,
        /// What failed, in the middleware's words.
        reason: String,
    },
    /// A program that left removed a file by which newcomers find the service; it is there again.
    #[error("service `{service}`: {file} had been removed, and is put back")]
    PutBack {
        /// The service.
        service: String,
        /// The file.
        file: String,
    },
    /// Somebody removed the service's files; it has been opened anew. No scene was lost that later subscribers could have had.
    #[error(
        "service `{service}` is published anew: another program had removed {file} (systemd does so when a user logs out: RemoveIPC=no)"
    )]
    Removed {
        /// The service.
        service: String,
        /// One of the files that were removed.
        file: String,
    },
    /// Somebody removed the service's files, and it cannot be opened anew; that is tried again every second.
    #[error("nobody can subscribe any more, since {file} was removed: {reason}")]
    Lost {
        /// One of the files that were removed.
        file: String,
        /// Why it cannot be opened anew.
        reason: String,
    },
    /// One scene did not reach all subscribers; the next one may.
    #[error("scene {sequence} was not published on `{service}` ({reason})")]
    Send {
        /// The service.
        service: String,
        /// Number of the scene's frame.
        sequence: u64,
        /// What failed, in the middleware's words.
        reason: String,
    },
    /// Subscribers could not be connected or woken; they see the next scene later, or not at all.
    #[error("subscribers of `{service}` were not woken ({reason})")]
    Wake {
        /// The service.
        service: String,
        /// What failed, in the middleware's words.
        reason: String,
    },
}
