//! `overcam background`: learns the empty floor and writes it to a file, for runs that start with
//! objects on the floor.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel};

use anyhow::{Context, bail};
use imgproc::Size;

use crate::background::learner::Learner;
use crate::background::model::BackgroundModel;
use crate::cli::{BackgroundArgs, SourceArgs};
use crate::image::frame::{Picture, decode};
use crate::run::capture::{Feed, Orders, joined_unless_blocked, open_source};
use crate::run::log_camera;
use crate::run::slot::{Slot, SourceInfo};
use crate::run::status::{Status, counted, log};
use crate::run::threads::POLL;

/// Learns the background and writes it, unless `stop` is set before. Prints one line about it to
/// `out`.
///
/// # Errors
///
/// The reason for the failure, in one line. An existing file is then left unchanged.
pub fn learn_background(
    args: &BackgroundArgs,
    stop: &Arc<AtomicBool>,
    out: &mut impl Write,
) -> anyhow::Result<()> {
    // Before waiting for frames, which may take minutes.
    let create = || Replacement::create(&args.output).with_context(|| not_written(&args.output));
    let Some((target, learned)) =
        learn_view(&args.source, args.learn, "the empty floor", stop, create)?
    else {
        return Ok(());
    };
    let Learned { floor, seen, .. } = learned;
    let written = target.replace(&floor.to_png());
    written.with_context(|| not_written(&args.output))?;
    let fewer = if seen < args.learn {
        format!(", which are all ({} were asked for)", args.learn)
    } else {
        String::new()
    };
    let noise = floor.median_noise().map_or("unknown".to_owned(), |noise| {
        format!("{noise:.2} grey levels")
    });
    let Size { width, height } = floor.picture.size;
    writeln!(
        out,
        "{}: {width} x {height}, learned from {}{fewer}; median noise {noise}",
        args.output.display(),
        counted(u64::from(seen), "frame")
    )
    .context("standard output")
}

/// The static view of a source.
pub(crate) struct Learned {
    pub(crate) floor: BackgroundModel,
    /// Number of frames used.
    pub(crate) seen: u32,
    /// Name of the source.
    pub(crate) source: String,
}

/// Learns the static view of a source from this many frames; `None` if `stop` was set before.
/// `prepare` is called when the source is open, before waiting for a frame; its result is also
/// returned.
pub(crate) fn learn_view<T>(
    args: &SourceArgs,
    count: u32,
    what: &str,
    stop: &Arc<AtomicBool>,
    prepare: impl FnOnce() -> anyhow::Result<T>,
) -> anyhow::Result<Option<(T, Learned)>> {
    let Some(mut source) = open_source(args, stop)? else {
        return Ok(None);
    };
    let prepared = prepare()?;
    source.start(stop)?;
    if stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let info = source.info();
    log_camera(&source);
    log(format_args!(
        "overcam: learning {what} from {} of {}",
        counted(u64::from(count), "frame"),
        info.name
    ));

    let orders = Orders {
        live: info.live,
        limit: u64::MAX,
        waits: false,
    };
    // There are no messages about a camera if the run does not wait for it.
    let (messages, _) = channel();
    let Feed {
        frames,
        free,
        thread,
        ..
    } = Feed::start(source, orders, stop, messages)?;
    let mut learner = Learner::new(info.size, count);
    let mut status = Status::new(info.live);
    let learned = learn(
        &mut learner,
        (&info, what),
        &frames,
        &free,
        stop,
        &mut status,
    );
    status.clear();
    let stopped = stop.swap(true, Ordering::Relaxed);
    drop((frames, free));
    let captured = joined_unless_blocked(thread, stop)?;
    if !learned? {
        captured?;
        if stopped {
            log(format_args!(
                "overcam: stopped after {}; nothing is written",
                counted(u64::from(learner.seen()), "frame")
            ));
            return Ok(None);
        }
    }
    let seen = learner.seen();
    let Some(floor) = learner.finish() else {
        bail!("{}: there is no frame to learn from", info.name);
    };
    let source = info.name;
    Ok(Some((
        prepared,
        Learned {
            floor,
            seen,
            source,
        },
    )))
}

/// Passes frames to the learner until it has enough (true) or no more arrive, and shows the
/// progress with the name of what is learned.
fn learn(
    learner: &mut Learner,
    (info, what): (&SourceInfo, &str),
    frames: &Receiver<Slot>,
    free: &SyncSender<Slot>,
    stop: &AtomicBool,
    status: &mut Status,
) -> anyhow::Result<bool> {
    let mut picture = Picture::new(info.size);
    loop {
        let slot = match frames.recv_timeout(POLL) {
            Ok(slot) => slot,
            Err(RecvTimeoutError::Timeout) if !stop.load(Ordering::Relaxed) => continue,
            Err(_) => return Ok(false),
        };
        let sequence = slot.frame.sequence;
        let decoded = decode(&slot.frame, &mut picture);
        // A run does not learn from skipped frames either.
        let skipped = slot.skipped;
        drop(free.try_send(slot));
        match decoded {
            _ if skipped => {}
            Ok(()) if learner.add(&picture) => return Ok(true),
            Ok(()) => status.learning(what, learner.seen(), learner.frames()),
            Err(error) => status.report(&format!("frame {sequence} is passed over: {error}")),
        }
        if stop.load(Ordering::Relaxed) {
            return Ok(false);
        }
    }
}

fn not_written(path: &Path) -> String {
    let path = path.display();
    format!("{path} cannot be written; choose a file in a folder that you may write to")
}

/// A new file that replaces an old one only when it is complete. If dropped before, it is removed.
#[derive(Debug)]
struct Replacement {
    path: PathBuf,
    temporary: PathBuf,
    file: File,
}

impl Replacement {
    /// Creates the new file next to the old one.
    fn create(path: &Path) -> io::Result<Self> {
        // A link is kept, and its target is replaced.
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if path.exists() && !path.is_file() {
            return Err(io::Error::other("it is there and is no regular file"));
        }
        let name = path
            .file_name()
            .ok_or_else(|| io::Error::other("it names no file"))?;
        let mut temporary = std::ffi::OsString::from(".");
        temporary.push(name);
        temporary.push(format!(".{}", std::process::id()));
        let temporary = path.with_file_name(temporary);
        Ok(Self {
            file: File::create_new(&temporary)?,
            path,
            temporary,
        })
    }

    /// Replaces the old file by the new one.
    fn replace(mut self, content: &[u8]) -> io::Result<()> {
        self.file.write_all(content)?;
        self.file.sync_all()?;
        fs::rename(&self.temporary, &self.path)
    }
}

impl Drop for Replacement {
    fn drop(&mut self) {
        // After renaming there is nothing to remove.
        let _ = fs::remove_file(&self.temporary);
    }
}
