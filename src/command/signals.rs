//! The signals that stop a command.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::exit;

/// Signals within this time are one: `timeout` and some terminals send theirs to the process and to
/// its group. No person presses Ctrl-C twice as fast.
const ONE: Duration = Duration::from_millis(200);

/// A flag that Ctrl-C, SIGTERM and a closed terminal set. The second of them ends the program
/// immediately, in case the first one has no effect.
///
/// # Errors
///
/// If the operating system has no thread or pipe left.
pub(super) fn stop_flag() -> io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let hang_up = (!ignores(SIGHUP)).then_some(SIGHUP);
    let mut signals = Signals::new([SIGINT, SIGTERM].into_iter().chain(hang_up))?;
    let flag = Arc::clone(&stop);
    thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            let mut first: Option<Instant> = None;
            for _ in signals.forever() {
                let first = *first.get_or_insert_with(Instant::now);
                if flag.swap(true, Ordering::Relaxed) && first.elapsed() > ONE {
                    exit(1);
                }
            }
        })?;
    Ok(stop)
}

/// Whether the program was started with a signal ignored, as `nohup` does; it must then stay
/// ignored.
fn ignores(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
