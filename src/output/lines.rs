//! Lines for standard output, written by a thread of its own: a reader that stops reading blocks
//! neither positions nor a stop.
//!
//! Lines are passed in a fixed number of buffers: full ones to the writing thread, empty ones back.
//! If no buffer is empty, the reader is behind by all of them. [`Lines::print`] documents what
//! happens to a line then.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Maximum number of lines that the reader may be behind: a second or two with a camera.
const BUFFERS: usize = 32;
/// Maximum wait for the reader before the stop flag is checked.
const POLL: Duration = Duration::from_millis(100);
/// After this many polls without a line read since the stop, the reader is considered gone.
const SILENT_POLLS: u32 = 3;
/// Minimum time between two reports of dropped lines.
const REPORT_PERIOD: Duration = Duration::from_secs(10);

/// The writer to standard output.
#[derive(Debug)]
pub(crate) struct Lines {
    /// `None` after the last line.
    to_write: Option<SyncSender<Vec<u8>>>,
    written: Receiver<Vec<u8>>,
    /// Buffers that are not in use.
    empty: Vec<Vec<u8>>,
    /// `None` after its result has been returned.
    thread: Option<JoinHandle<io::Result<()>>>,
    /// Wait for the reader.
    wait: bool,
    /// Waiting for the reader was in vain.
    unread: bool,
    n_left_out: u64,
    /// Time of the last report of dropped lines, and their number then.
    reported: Option<(Instant, u64)>,
}

impl Lines {
    /// Starts to write to `out`, each line immediately. `wait` determines what happens to a line if
    /// the reader is behind.
    ///
    /// # Errors
    ///
    /// If the thread cannot start.
    pub(crate) fn start(out: impl Write + Send + 'static, wait: bool) -> io::Result<Self> {
        let (to_write, full) = sync_channel(BUFFERS);
        let (back, written) = sync_channel(BUFFERS);
        let thread = thread::Builder::new()
            .name("lines".to_owned())
            .spawn(move || write_all(out, &full, &back))?;
        Ok(Self {
            to_write: Some(to_write),
            written,
            empty: vec![Vec::new(); BUFFERS],
            thread: Some(thread),
            wait,
            unread: false,
            n_left_out: 0,
            reported: None,
        })
    }

    /// Prints what `write` puts into a buffer. If the reader is behind, this waits for it as long
    /// as `stop` is not set. Without waiting, or if it is in vain, the line is dropped and counted.
    ///
    /// # Errors
    ///
    /// The error that occurred when this or an earlier line was written.
    pub(crate) fn print(
        &mut self,
        stop: &AtomicBool,
        write: impl FnOnce(&mut Vec<u8>) -> io::Result<()>,
    ) -> io::Result<()> {
        let Some(mut line) = self.empty_buffer(stop) else {
            self.n_left_out += 1;
            return Ok(());
        };
        line.clear();
        write(&mut line)?;
        match &self.to_write {
            Some(to_write) if to_write.send(line).is_ok() => Ok(()),
            // The thread ends early only with an error.
            _ => self.result(),
        }
    }

    fn empty_buffer(&mut self, stop: &AtomicBool) -> Option<Vec<u8>> {
        self.empty.extend(self.written.try_iter());
        if let Some(line) = self.empty.pop() {
            self.unread = false;
            return Some(line);
        }
        if !self.wait || self.unread {
            return match self.written.try_recv() {
                Ok(line) => Some(line),
                Err(TryRecvError::Empty) => None,
                // Sending it will fail and return the error.
                Err(TryRecvError::Disconnected) => Some(Vec::new()),
            };
        }
        let line = self.wait_for_reader(stop);
        self.unread = line.is_none();
        line.map(Result::unwrap_or_default)
    }

    /// A buffer that was written, or an error if the thread has ended; `None` if `stop` is set and
    /// the reader is gone.
    fn wait_for_reader(&self, stop: &AtomicBool) -> Option<Result<Vec<u8>, RecvTimeoutError>> {
        let mut silent_polls = 0;
        while silent_polls < SILENT_POLLS {
            match self.written.recv_timeout(POLL) {
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => silent_polls += 1,
                Err(RecvTimeoutError::Timeout) => {}
                done => return Some(done),
            }
        }
        None
    }

    /// A message about dropped lines, if one is due.
    pub(crate) fn report(&mut self) -> Option<String> {
        let (is_due, n_reported) = match self.reported {
            Some((at, n_reported)) => (at.elapsed() >= REPORT_PERIOD, n_reported),
            None => (true, 0),
        };
        if self.n_left_out == n_reported || !is_due {
            return None;
        }
        self.reported = Some((Instant::now(), self.n_left_out));
        Some(format!(
            "standard output is not read in time: lines are left out, {} so far",
            self.n_left_out
        ))
    }

    /// Waits until all lines are read, or until `stop` is set and the reader is gone. Returns the
    /// number of dropped lines.
    ///
    /// # Errors
    ///
    /// The error that occurred when a line was written.
    pub(crate) fn finish(&mut self, stop: &AtomicBool) -> io::Result<u64> {
        self.to_write = None;
        loop {
            match self.wait_for_reader(stop) {
                Some(Ok(line)) => self.empty.push(line),
                // It has written the last line.
                Some(Err(_)) => return self.result().map(|()| self.n_left_out),
                None => return Ok(self.n_left_out + (BUFFERS - self.empty.len()) as u64),
            }
        }
    }

    /// The result of the writing thread after its end.
    fn result(&mut self) -> io::Result<()> {
        let result = self.thread.take().map_or(Ok(Ok(())), JoinHandle::join);
        result.unwrap_or_else(|_| Err(io::Error::other("the thread that writes it has ended")))
    }
}

/// A writer for whole lines to standard output: waits for the reader as long as `stop` is not set.
#[derive(Debug)]
pub(crate) struct StoppableWriter<'a> {
    lines: Lines,
    stop: &'a AtomicBool,
}

impl<'a> StoppableWriter<'a> {
    /// Starts to write to `out`.
    ///
    /// # Errors
    ///
    /// If the thread cannot start.
    pub(crate) fn start(
        out: impl Write + Send + 'static,
        stop: &'a AtomicBool,
    ) -> io::Result<Self> {
        Lines::start(out, true).map(|lines| Self { lines, stop })
    }

    /// Waits until everything is read, or until `stop` is set and the reader is gone.
    ///
    /// # Errors
    ///
    /// The error that occurred when a line was written.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.lines.finish(self.stop).map(drop)
    }
}

impl Write for StoppableWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lines.print(self.stop, |line| line.write_all(bytes))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        // The thread flushes after each line.
        Ok(())
    }
}

fn write_all(
    mut out: impl Write,
    full: &Receiver<Vec<u8>>,
    back: &SyncSender<Vec<u8>>,
) -> io::Result<()> {
    for line in full {
        out.write_all(&line)?;
        out.flush()?;
        // The channel has room for all buffers.
        drop(back.try_send(line));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes the number of bytes it is allowed to, then waits for the next permission.
    struct Reader {
        allowed: Receiver<usize>,
        left: usize,
        read: SyncSender<Vec<u8>>,
    }

    impl Write for Reader {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            while self.left == 0 {
                self.left = self.allowed.recv().map_err(|_| io::ErrorKind::BrokenPipe)?;
            }
            let n = bytes.len().min(self.left);
            self.left -= n;
            drop(self.read.send(bytes[..n].to_vec()));
            Ok(n)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Lines, the sender of permissions, and the bytes written.
    fn lines(wait: bool) -> (Lines, SyncSender<usize>, Receiver<Vec<u8>>) {
        let (allow, allowed) = sync_channel(1000);
        let (read, bytes) = sync_channel(1000);
        let reader = Reader {
            allowed,
            left: 0,
            read,
        };
        let lines = Lines::start(reader, wait).expect("a thread can start");
        (lines, allow, bytes)
    }

    fn print(lines: &mut Lines, stop: &AtomicBool, n: usize) -> io::Result<()> {
        lines.print(stop, |line| writeln!(line, "{n:03}"))
    }

    fn text(bytes: &Receiver<Vec<u8>>) -> String {
        String::from_utf8(bytes.iter().flatten().collect()).expect("it is text")
    }

    #[test]
    fn without_waiting_a_reader_that_stops_costs_lines_and_nothing_else() {
        let (mut lines, allow, bytes) = lines(false);
        let stop = AtomicBool::new(false);
        for n in 0..100 {
            print(&mut lines, &stop, n).expect("nothing fails");
        }
        let n_left_out = 100 - BUFFERS;
        let message = lines.report().expect("a message");
        assert!(
            message.ends_with(&format!("{n_left_out} so far")),
            "{message}"
        );
        assert_eq!(lines.report(), None);
        allow.send(10_000).expect("the thread lives");
        assert_eq!(
            lines.finish(&stop).expect("nothing fails"),
            n_left_out as u64
        );
        let expected: String = (0..BUFFERS).map(|n| format!("{n:03}\n")).collect();
        drop(lines);
        assert_eq!(text(&bytes), expected);
    }

    #[test]
    fn waiting_loses_nothing_and_a_stop_ends_it() {
        let (mut lines, allow, bytes) = lines(true);
        let stop = AtomicBool::new(false);
        let slowly = thread::spawn(move || {
            for _ in 0..100 {
                allow.send(2).expect("the thread lives");
                allow.send(2).expect("the thread lives");
                thread::sleep(Duration::from_millis(1));
            }
            allow
        });
        for n in 0..100 {
            print(&mut lines, &stop, n).expect("nothing fails");
        }
        // From here on there is no reader.
        let allow = slowly.join().expect("it ends");
        while bytes.try_iter().count() > 0 || lines.empty.len() < BUFFERS {
            lines.empty.extend(lines.written.try_iter());
        }
        for n in 0..BUFFERS {
            print(&mut lines, &stop, n).expect("nothing fails");
        }
        stop.store(true, Ordering::Relaxed);
        for n in 0..5 {
            print(&mut lines, &stop, n).expect("nothing fails");
        }
        let n_missing = lines.finish(&stop).expect("nothing fails");
        assert_eq!(n_missing, BUFFERS as u64 + 5);
        drop(allow);
    }

    #[test]
    fn a_reader_that_goes_is_an_error_for_the_next_line_or_the_end() {
        for wait in [false, true] {
            let (mut lines, allow, _bytes) = lines(wait);
            let stop = AtomicBool::new(false);
            let printed = (0..BUFFERS).try_for_each(|n| print(&mut lines, &stop, n));
            printed.expect("all have room");
            drop(allow);
            let result = print(&mut lines, &stop, 0).and_then(|()| lines.finish(&stop));
            let error = result.expect_err("the pipe is broken");
            assert_eq!(error.kind(), io::ErrorKind::BrokenPipe);
        }
    }
}
