//! The kernel's video interface (V4L2): structures, calls and mapped buffers, as safe functions.
//!
//! The only file of the project with `unsafe`. It only wraps the kernel interface; decisions are in
//! [`crate::camera`]. It contains only what memory-mapped streaming needs: single-planar capture
//! and controls with a single integer value, no outputs, no requests.
//!
//! Source: Linux Media Subsystem Documentation, part "Video for Linux API".
#![allow(unsafe_code)]

mod abi;

use std::fmt;
use std::fs::{File, OpenOptions};
use std::io;
use std::ops::Range;
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::ptr;
use std::time::Duration;

use imgproc::Size;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

use abi::*;
pub(crate) use abi::{
    CAP_CAPTURE, CAP_CAPTURE_PLANES, CAP_METADATA, CAP_OUTPUT, CAP_STREAMING, FourCc, Fraction,
    PixFormat,
};

/// Maximum number of entries read from a kernel list: a driver whose list never ends must not hang
/// the program.
const MAX_LISTED: u32 = 256;

/// Performs an ioctl, and repeats it if interrupted by a signal.
fn call<T>(fd: RawFd, request: &Request<T>, argument: &mut T) -> io::Result<()> {
    loop {
        // SAFETY: the request number contains the size of T, so the kernel accesses no more than
        // this many bytes at the address, which `argument` borrows exclusively. All types used here
        // are valid for any bytes. The only one that contains an address is `ExtendedControls`,
        // which only `call_control` creates.
        let status = unsafe { libc::ioctl(fd, request.number, ptr::from_mut(argument)) };
        if status == 0 {
            return Ok(());
        }
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
}

/// Performs a request on one control and returns its value.
///
/// The older single-control requests are intended for user controls only; exposure and focus are
/// camera controls.
fn call_control(
    fd: RawFd,
    request: &Request<ExtendedControls>,
    id: u32,
    value: i32,
) -> io::Result<i32> {
    let mut control = ExtendedControl {
        id,
        value,
        ..ExtendedControl::default()
    };
    let mut controls = ExtendedControls {
        class: id & CONTROL_CLASS_MASK,
        count: 1,
        error_index: 0,
        request_fd: 0,
        reserved: 0,
        // The kernel writes `count` controls there during the request; `control` lives longer.
        controls: ptr::from_mut(&mut control),
    };
    call(fd, request, &mut controls)?;
    Ok(control.value)
}

/// Identity and capabilities of a node.
#[derive(Debug, Clone)]
pub(crate) struct Card {
    pub(crate) name: String,
    pub(crate) driver: String,
    /// The port: `usb-0000:00:14.0-2`.
    pub(crate) bus: String,
    /// `CAP_` flags of this node.
    pub(crate) capabilities: u32,
}

/// A size that a camera offers, or a range of sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sizes {
    One(Size),
    Grid { min: Size, max: Size, step: Size },
}

/// A frame interval that a camera offers, or a range of intervals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Intervals {
    One(Fraction),
    Range {
        shortest: Fraction,
        longest: Fraction,
    },
}

/// Range and value of a control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ControlRange {
    pub(crate) min: i32,
    pub(crate) max: i32,
    /// Step between values, starting at the minimum; at least 1.
    pub(crate) step: i32,
    pub(crate) is_writable: bool,
}

impl fmt::Display for Sizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = |size: &Size| format!("{}x{}", size.width, size.height);
        match self {
            Self::One(size) => write!(f, "{}", text(size)),
            Self::Grid { min, max, step } => {
                write!(f, "{} to {}", text(min), text(max))?;
                match (step.width, step.height) {
                    (0 | 1, 0 | 1) => Ok(()),
                    _ => write!(f, " in steps of {}", text(step)),
                }
            }
        }
    }
}

impl Fraction {
    /// Frames per second for this frame interval.
    pub(crate) fn rate_hz(self) -> f64 {
        f64::from(self.denominator) / f64::from(self.numerator)
    }
}

/// Frames per second.
impl fmt::Display for Intervals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // At most two decimals, without trailing zeros: 29.97, 30.
        let text = |interval: &Fraction| ((interval.rate_hz() * 100.0).round() / 100.0).to_string();
        match self {
            Self::One(interval) => f.write_str(&text(interval)),
            Self::Range { shortest, longest } => {
                write!(f, "{} to {}", text(longest), text(shortest))
            }
        }
    }
}

/// An open node.
#[derive(Debug)]
pub(crate) struct Device {
    file: File,
}

impl Device {
    /// Opens a node without blocking. Fails with [`io::ErrorKind::InvalidInput`] if the file is not
    /// a character device.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        // Checked first: opening a pipe would block, and a folder cannot be opened for writing.
        if !path.metadata()?.file_type().is_char_device() {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path)?;
        Ok(Self { file })
    }

    fn fd(&self) -> RawFd {
        self.file.as_raw_fd()
    }

    pub(crate) fn card(&self) -> io::Result<Card> {
        let text = |bytes: &[u8]| {
            let end = bytes.iter().position(|&byte| byte == 0);
            String::from_utf8_lossy(&bytes[..end.unwrap_or(bytes.len())]).into_owned()
        };
        let mut found = Capability::default();
        call(self.fd(), &QUERYCAP, &mut found)?;
        Ok(Card {
            name: text(&found.card),
            driver: text(&found.driver),
            bus: text(&found.bus_info),
            capabilities: match found.capabilities & CAP_DEVICE_CAPS {
                0 => found.capabilities,
                _ => found.device_caps,
            },
        })
    }

    /// The formats that the camera offers; empty if it does not state them.
    pub(crate) fn formats(&self) -> Vec<FourCc> {
        self.list(&ENUM_FMT, |index| FormatDescription {
            index,
            kind: TYPE_VIDEO_CAPTURE,
            ..FormatDescription::default()
        })
        .map(|found| found.pixel_format)
        .collect()
    }

    /// The sizes that the camera offers for a format; empty if it does not state them.
    pub(crate) fn sizes(&self, pixel_format: FourCc) -> Vec<Sizes> {
        self.list(&ENUM_FRAMESIZES, |index| FrameSizeEntry {
            index,
            pixel_format,
            ..FrameSizeEntry::default()
        })
        .map(|found| {
            let [a, b, c, d, e, f] = found.numbers.map(|number| number as usize);
            let size = |width, height| Size { width, height };
            match found.kind {
                KIND_DISCRETE => Sizes::One(size(a, b)),
                _ => Sizes::Grid {
                    min: size(a, d),
                    max: size(b, e),
                    step: size(c, f),
                },
            }
        })
        .collect()
    }

    /// The frame intervals that the camera offers for a format and size; empty if it does not state
    /// them.
    pub(crate) fn intervals(&self, pixel_format: FourCc, size: Size) -> Vec<Intervals> {
        self.list(&ENUM_FRAMEINTERVALS, |index| FrameIntervalEntry {
            index,
            pixel_format,
            width: size.width as u32,
            height: size.height as u32,
            ..FrameIntervalEntry::default()
        })
        .map(|found| {
            let [shortest, longest, _] = found.intervals;
            match found.kind {
                KIND_DISCRETE => Intervals::One(shortest),
                _ => Intervals::Range { shortest, longest },
            }
        })
        .collect()
    }

    /// The entries of a kernel list, up to its end.
    fn list<T: Copy>(
        &self,
        request: &Request<T>,
        entry: impl Fn(u32) -> T,
    ) -> impl Iterator<Item = T> {
        (0..MAX_LISTED).map_while(move |index| {
            let mut entry = entry(index);
            call(self.fd(), request, &mut entry).ok().map(|()| entry)
        })
    }

    /// Requests a format and a size. The camera may silently change them; returns the actual ones.
    pub(crate) fn set_format(&self, pixel_format: FourCc, size: Size) -> io::Result<PixFormat> {
        let mut format = Format {
            kind: TYPE_VIDEO_CAPTURE,
            ..Format::default()
        };
        format.pix.width = size.width as u32;
        format.pix.height = size.height as u32;
        format.pix.pixel_format = pixel_format;
        format.pix.field = FIELD_NONE;
        call(self.fd(), &S_FMT, &mut format)?;
        Ok(format.pix)
    }

    /// Requests a frame interval, and returns the one stated by the camera; `None` if it does not
    /// support this.
    pub(crate) fn set_interval(&self, interval: Fraction) -> Option<Fraction> {
        let mut wanted = StreamParameters {
            kind: TYPE_VIDEO_CAPTURE,
            time_per_frame: interval,
            ..StreamParameters::default()
        };
        // Not every driver allows the rate to be set, and some state it nevertheless: the answer
        // counts.
        _ = call(self.fd(), &S_PARM, &mut wanted);
        let mut found = StreamParameters {
            kind: TYPE_VIDEO_CAPTURE,
            ..StreamParameters::default()
        };
        call(self.fd(), &G_PARM, &mut found).ok()?;
        let Fraction {
            numerator,
            denominator,
        } = found.time_per_frame;
        let is_known = found.capability & CAP_TIME_PER_FRAME != 0;
        (is_known && numerator > 0 && denominator > 0).then_some(found.time_per_frame)
    }

    /// Range and value of a control; `None` if the camera does not have it.
    pub(crate) fn control(&self, id: u32) -> Option<ControlRange> {
        let mut found = ControlQuery {
            id,
            ..ControlQuery::default()
        };
        call(self.fd(), &QUERYCTRL, &mut found).ok()?;
        (found.flags & CONTROL_DISABLED == 0).then_some(ControlRange {
            min: found.minimum,
            max: found.maximum,
            step: found.step.max(1),
            is_writable: found.flags & CONTROL_READ_ONLY == 0,
        })
    }

    pub(crate) fn control_value(&self, id: u32) -> io::Result<i32> {
        call_control(self.fd(), &G_EXT_CTRLS, id, 0)
    }

    /// Sets a control. The camera may use another value, which only reading it back shows.
    pub(crate) fn set_control(&self, id: u32, value: i32) -> io::Result<()> {
        call_control(self.fd(), &S_EXT_CTRLS, id, value).map(drop)
    }
}

/// A kernel buffer mapped into memory.
#[derive(Debug)]
struct Mapping {
    start: *mut u8,
    length: usize,
}

// SAFETY: a mapping belongs to the process, not to a thread, and is accessible only through its
// `Mapping`.
unsafe impl Send for Mapping {}

impl Mapping {
    fn new(file: impl AsFd, buffer: &Buffer) -> io::Result<Self> {
        let length = buffer.length as usize;
        let (access, shared) = (ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED);
        let offset = u64::from(buffer.offset);
        // SAFETY: a new mapping at an address chosen by the kernel touches no memory in use.
        let start = unsafe { mmap(ptr::null_mut(), length, access, shared, file, offset) }?;
        Ok(Self {
            start: start.cast(),
            length,
        })
    }

    /// Appends the bytes of `range` to `out`.
    ///
    /// # Panics
    ///
    /// If the range is not within the mapping.
    fn append_to(&self, range: Range<usize>, out: &mut Vec<u8>) {
        assert!(range.start <= range.end && range.end <= self.length);
        let n = range.len();
        out.reserve(n);
        // SAFETY: the source is within the mapping, as asserted, and the destination within the
        // space just reserved, after the bytes in use; they do not overlap. No reference to the
        // mapping is made, because some drivers (v4l2loopback) let another program write to a
        // buffer that we own at the moment; the bytes copied then are valid, whatever they are.
        unsafe {
            ptr::copy_nonoverlapping(
                self.start.add(range.start),
                out.as_mut_ptr().add(out.len()),
                n,
            );
            out.set_len(out.len() + n);
        }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: exactly this memory was mapped by `new` and is unmapped once; there are no
        // references to it.
        let _ = unsafe { munmap(self.start.cast(), self.length) };
    }
}

/// A dequeued buffer, to be queued again.
#[derive(Debug)]
pub(crate) struct Filled {
    index: usize,
    /// Bytes written by the camera, at most the buffer's length.
    pub(crate) bytes_used: usize,
    /// The driver's frame count, which wraps around.
    pub(crate) sequence: u32,
    /// The kernel's time stamp, if it is on the clock of
    /// [`monotonic_ns`](crate::clock::monotonic_ns).
    pub(crate) stamp_ns: Option<u64>,
    /// The driver reports that the content is damaged.
    pub(crate) is_faulty: bool,
}

/// Result of [`Stream::wait`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ready {
    /// Timeout.
    No,
    /// A buffer is available.
    Buffer,
    /// The camera has failed or is gone; dequeuing a buffer returns the error.
    Failed,
}

/// A camera with mapped capture buffers. Dropping it stops the camera.
#[derive(Debug)]
pub(crate) struct Stream {
    // Before the device, so that mappings are dropped before the file is closed.
    mappings: Vec<Mapping>,
    device: Device,
}

/// A request that failed.
#[derive(Debug)]
pub(crate) struct FailedCall {
    pub(crate) call: &'static str,
    pub(crate) source: io::Error,
}

impl Stream {
    /// Maps buffers and queues them. The camera may provide more or fewer than requested.
    pub(crate) fn new(device: Device, n_buffers: u32) -> Result<Self, FailedCall> {
        let failed = |call| move |source| FailedCall { call, source };
        let mut buffers = RequestBuffers {
            count: n_buffers,
            kind: TYPE_VIDEO_CAPTURE,
            memory: MEMORY_MMAP,
            ..RequestBuffers::default()
        };
        call(device.fd(), &REQBUFS, &mut buffers).map_err(failed("VIDIOC_REQBUFS"))?;
        let mut stream = Self {
            mappings: Vec::new(),
            device,
        };
        for index in 0..buffers.count {
            let mut buffer = capture_buffer(index);
            call(stream.device.fd(), &QUERYBUF, &mut buffer).map_err(failed("VIDIOC_QUERYBUF"))?;
            let mapping = Mapping::new(&stream.device.file, &buffer).map_err(failed("mmap"))?;
            stream.mappings.push(mapping);
            stream
                .queue(index as usize)
                .map_err(failed("VIDIOC_QBUF"))?;
        }
        Ok(stream)
    }

    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    pub(crate) fn start(&mut self) -> Result<(), FailedCall> {
        let mut kind = TYPE_VIDEO_CAPTURE as libc::c_int;
        call(self.device.fd(), &STREAMON, &mut kind).map_err(|source| FailedCall {
            call: "VIDIOC_STREAMON",
            source,
        })
    }

    /// Waits for a buffer. A signal ends the wait early.
    pub(crate) fn wait(&self, timeout: Duration) -> io::Result<Ready> {
        let timeout = Timespec::try_from(timeout).ok();
        let mut asked = [PollFd::new(&self.device.file, PollFlags::IN)];
        match poll(&mut asked, timeout.as_ref()) {
            Err(Errno::INTR) => return Ok(Ready::No),
            result => result?,
        };
        let found = asked[0].revents();
        Ok(if found.is_empty() {
            Ready::No
        } else if found.intersects(PollFlags::ERR | PollFlags::HUP | PollFlags::NVAL) {
            Ready::Failed
        } else {
            Ready::Buffer
        })
    }

    /// Dequeues a filled buffer; `None` if there is none.
    pub(crate) fn take(&mut self) -> io::Result<Option<Filled>> {
        let mut buffer = capture_buffer(0);
        match call(self.device.fd(), &DQBUF, &mut buffer) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            Err(error) => return Err(error),
        }
        let index = buffer.index as usize;
        let Some(mapping) = self.mappings.get(index) else {
            return Err(io::Error::other(format!(
                "the driver returned buffer {index} of {}",
                self.mappings.len()
            )));
        };
        let is_monotonic = buffer.flags & BUFFER_CLOCK_MASK == BUFFER_CLOCK_MONOTONIC;
        Ok(Some(Filled {
            index,
            bytes_used: mapping.length.min(buffer.bytes_used as usize),
            sequence: buffer.sequence,
            stamp_ns: is_monotonic.then(|| stamp_ns(buffer.timestamp_s, buffer.timestamp_us)),
            is_faulty: buffer.flags & BUFFER_ERROR != 0,
        }))
    }

    /// Appends bytes of a filled buffer to `out`.
    ///
    /// # Panics
    ///
    /// If the range exceeds the buffer.
    pub(crate) fn append_to(&self, filled: &Filled, range: Range<usize>, out: &mut Vec<u8>) {
        self.mappings[filled.index].append_to(range, out);
    }

    /// Queues a buffer again.
    pub(crate) fn give_back(&mut self, filled: Filled) -> Result<(), FailedCall> {
        self.queue(filled.index).map_err(|source| FailedCall {
            call: "VIDIOC_QBUF",
            source,
        })
    }

    fn queue(&self, index: usize) -> io::Result<()> {
        call(self.device.fd(), &QBUF, &mut capture_buffer(index as u32))
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let mut kind = TYPE_VIDEO_CAPTURE as libc::c_int;
        // Fails if the camera is gone or was never started; then there is nothing to stop.
        _ = call(self.device.fd(), &STREAMOFF, &mut kind);
    }
}

fn capture_buffer(index: u32) -> Buffer {
    Buffer {
        index,
        kind: TYPE_VIDEO_CAPTURE,
        memory: MEMORY_MMAP,
        ..Buffer::default()
    }
}

/// Seconds and microseconds as nanoseconds; wraps around where the driver's clock does.
fn stamp_ns(seconds: i64, microseconds: i64) -> u64 {
    (seconds as u64)
        .wrapping_mul(1_000_000_000)
        .wrapping_add((microseconds as u64).wrapping_mul(1000))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_nanoseconds() {
        assert_eq!(stamp_ns(12, 345_678), 12_345_678_000);
        // Invalid values must not panic.
        _ = stamp_ns(i64::MAX, i64::MIN);
    }

    #[test]
    fn sizes_and_rates_read_well() {
        let size = |width, height| Size { width, height };
        let fraction = |numerator, denominator| Fraction {
            numerator,
            denominator,
        };
        assert_eq!(Sizes::One(size(640, 480)).to_string(), "640x480");
        let grid = |step| Sizes::Grid {
            min: size(16, 8),
            max: size(64, 32),
            step,
        };
        assert_eq!(grid(size(1, 1)).to_string(), "16x8 to 64x32");
        assert_eq!(
            grid(size(2, 4)).to_string(),
            "16x8 to 64x32 in steps of 2x4"
        );
        assert_eq!(Intervals::One(fraction(1001, 30_000)).to_string(), "29.97");
        let range = Intervals::Range {
            shortest: fraction(1, 60),
            longest: fraction(2, 1),
        };
        assert_eq!(range.to_string(), "0.5 to 60");
    }

    #[test]
    fn what_is_no_camera_is_an_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("video0");
        std::fs::write(&file, b"").expect("written");
        for path in [folder.path(), &file] {
            let error = Device::open(path).expect_err("no device");
            assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
        }
        let missing = Device::open(&folder.path().join("none")).expect_err("missing");
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        // A character device other than video.
        let null = Device::open(Path::new("/dev/null")).expect("opens");
        assert!(null.card().is_err());
        assert!(null.formats().is_empty());
        let gain = 0x0098_0913;
        assert_eq!(null.control(gain), None);
        assert!(null.control_value(gain).is_err() && null.set_control(gain, 0).is_err());
    }

    #[test]
    fn bytes_of_a_mapping_are_appended() {
        let mut file = tempfile::tempfile().expect("a file");
        io::Write::write_all(&mut file, b"abcdefgh").expect("written");
        let buffer = Buffer {
            length: 8,
            ..Buffer::default()
        };
        let mapping = Mapping::new(&file, &buffer).expect("mapped");
        let mut out = b"x".to_vec();
        mapping.append_to(2..5, &mut out);
        mapping.append_to(7..8, &mut out);
        mapping.append_to(8..8, &mut out);
        assert_eq!(out, b"xcdeh");
    }

    #[test]
    #[should_panic(expected = "range.end <= self.length")]
    fn bytes_beyond_a_mapping_are_refused() {
        let mut file = tempfile::tempfile().expect("a file");
        io::Write::write_all(&mut file, b"abcdefgh").expect("written");
        let buffer = Buffer {
            length: 8,
            ..Buffer::default()
        };
        let mapping = Mapping::new(&file, &buffer).expect("mapped");
        mapping.append_to(2..9, &mut Vec::new());
    }
}
