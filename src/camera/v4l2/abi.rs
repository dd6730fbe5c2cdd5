//! Structures and request numbers of `linux/videodev2.h` on 64-bit machines.
//!
//! Unions are declared as the single member used here, so no union has to be read. Sizes, relevant
//! offsets and request numbers are checked against the kernel's at compile time.
#![deny(unsafe_code)]

use std::marker::PhantomData;
use std::mem::{offset_of, size_of};

/// Four-character code of a pixel format.
pub(crate) type FourCc = [u8; 4];

/// `device_caps`: video capture (single-planar, multi-planar), video output, metadata capture,
/// streaming.
pub(crate) const CAP_CAPTURE: u32 = 0x0000_0001;
pub(crate) const CAP_CAPTURE_PLANES: u32 = 0x0000_1000;
pub(crate) const CAP_OUTPUT: u32 = 0x0000_0002 | 0x0000_2000;
pub(crate) const CAP_METADATA: u32 = 0x0080_0000;
pub(crate) const CAP_STREAMING: u32 = 0x0400_0000;
/// `capabilities`: the member `device_caps` is valid.
pub(super) const CAP_DEVICE_CAPS: u32 = 0x8000_0000;

pub(super) const TYPE_VIDEO_CAPTURE: u32 = 1;
pub(super) const MEMORY_MMAP: u32 = 1;
pub(super) const FIELD_NONE: u32 = 1;
/// Set in a stream parameter's `capability` if its `timeperframe` is valid.
pub(super) const CAP_TIME_PER_FRAME: u32 = 0x1000;
pub(super) const KIND_DISCRETE: u32 = 1;

/// The class bits of a control id.
pub(super) const CONTROL_CLASS_MASK: u32 = 0x0fff_0000;
pub(super) const CONTROL_DISABLED: u32 = 0x0001;
pub(super) const CONTROL_READ_ONLY: u32 = 0x0004;

pub(super) const BUFFER_ERROR: u32 = 0x0000_0040;
pub(super) const BUFFER_CLOCK_MASK: u32 = 0x0000_e000;
pub(super) const BUFFER_CLOCK_MONOTONIC: u32 = 0x0000_2000;

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct Capability {
    pub(super) driver: [u8; 16],
    pub(super) card: [u8; 32],
    pub(super) bus_info: [u8; 32],
    pub(super) version: u32,
    pub(super) capabilities: u32,
    pub(super) device_caps: u32,
    pub(super) reserved: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct FormatDescription {
    pub(super) index: u32,
    pub(super) kind: u32,
    pub(super) flags: u32,
    pub(super) description: [u8; 32],
    pub(super) pixel_format: FourCc,
    pub(super) mbus_code: u32,
    pub(super) reserved: [u32; 3],
}

/// Format of the frames that a camera delivers.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PixFormat {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) pixel_format: FourCc,
    pub(crate) field: u32,
    /// Stride of the first plane, in bytes.
    pub(crate) bytes_per_line: u32,
    /// Buffer size in bytes; for a compressed format the maximum for one image.
    pub(crate) size_image: u32,
    pub(crate) colorspace: u32,
    pub(crate) private: u32,
    pub(crate) flags: u32,
    pub(crate) ycbcr_encoding: u32,
    pub(crate) quantization: u32,
    pub(crate) transfer_function: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct Format {
    pub(super) kind: u32,
    pub(super) padding: u32,
    pub(super) pix: PixFormat,
    pub(super) rest: [u64; 19],
}

/// Seconds as a fraction, as used by the kernel for frame intervals.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Fraction {
    pub(crate) numerator: u32,
    pub(crate) denominator: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct StreamParameters {
    pub(super) kind: u32,
    pub(super) capability: u32,
    pub(super) capture_mode: u32,
    pub(super) time_per_frame: Fraction,
    pub(super) rest: [[u32; 23]; 2],
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct FrameSizeEntry {
    pub(super) index: u32,
    pub(super) pixel_format: FourCc,
    pub(super) kind: u32,
    /// Discrete: width and height. Otherwise minimum, maximum and step of the width, then of the
    /// height.
    pub(super) numbers: [u32; 6],
    pub(super) reserved: [u32; 2],
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct FrameIntervalEntry {
    pub(super) index: u32,
    pub(super) pixel_format: FourCc,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) kind: u32,
    /// Discrete: only the first is valid. Otherwise shortest, longest and step.
    pub(super) intervals: [Fraction; 3],
    pub(super) reserved: [u32; 2],
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct RequestBuffers {
    pub(super) count: u32,
    pub(super) kind: u32,
    pub(super) memory: u32,
    pub(super) capabilities: u32,
    pub(super) flags: [u8; 4],
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct Buffer {
    pub(super) index: u32,
    pub(super) kind: u32,
    pub(super) bytes_used: u32,
    pub(super) flags: u32,
    pub(super) field: u32,
    pub(super) timestamp_s: i64,
    pub(super) timestamp_us: i64,
    pub(super) timecode: [u32; 4],
    pub(super) sequence: u32,
    pub(super) memory: u32,
    pub(super) offset: u32,
    pub(super) rest_of_union: u32,
    pub(super) length: u32,
    pub(super) reserved: [u32; 2],
}

/// Type and range of a control.
#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct ControlQuery {
    pub(super) id: u32,
    pub(super) kind: u32,
    pub(super) name: [u8; 32],
    pub(super) minimum: i32,
    pub(super) maximum: i32,
    pub(super) step: i32,
    pub(super) default: i32,
    pub(super) flags: u32,
    pub(super) reserved: [u32; 2],
}

/// Packed by the kernel: its union of eight bytes is not aligned to eight.
#[repr(C)]
#[derive(Clone, Copy, Default)]
pub(super) struct ExtendedControl {
    pub(super) id: u32,
    pub(super) size: u32,
    pub(super) reserved: u32,
    pub(super) value: i32,
    pub(super) rest_of_union: u32,
}

#[repr(C)]
pub(super) struct ExtendedControls {
    pub(super) class: u32,
    pub(super) count: u32,
    pub(super) error_index: u32,
    pub(super) request_fd: i32,
    pub(super) reserved: u32,
    pub(super) controls: *mut ExtendedControl,
}

/// A request number and the type of its argument.
pub(super) struct Request<T> {
    pub(super) number: libc::Ioctl,
    pub(super) argument: PhantomData<T>,
}

/// The kernel's `_IOC`: direction, size of the argument, letter `V`, number.
const fn request<T>(direction: u32, number: u32) -> Request<T> {
    let size = size_of::<T>() as u32;
    let number = (direction << 30) | (size << 16) | ((b'V' as u32) << 8) | number;
    Request {
        number: number as libc::Ioctl,
        argument: PhantomData,
    }
}

pub(super) const WRITE: u32 = 1;
pub(super) const READ: u32 = 2;
pub(super) const READ_WRITE: u32 = 3;
pub(super) const QUERYCAP: Request<Capability> = request(READ, 0);
pub(super) const ENUM_FMT: Request<FormatDescription> = request(READ_WRITE, 2);
pub(super) const S_FMT: Request<Format> = request(READ_WRITE, 5);
pub(super) const REQBUFS: Request<RequestBuffers> = request(READ_WRITE, 8);
pub(super) const QUERYBUF: Request<Buffer> = request(READ_WRITE, 9);
pub(super) const QBUF: Request<Buffer> = request(READ_WRITE, 15);
pub(super) const DQBUF: Request<Buffer> = request(READ_WRITE, 17);
pub(super) const STREAMON: Request<libc::c_int> = request(WRITE, 18);
pub(super) const STREAMOFF: Request<libc::c_int> = request(WRITE, 19);
pub(super) const G_PARM: Request<StreamParameters> = request(READ_WRITE, 21);
pub(super) const S_PARM: Request<StreamParameters> = request(READ_WRITE, 22);
pub(super) const QUERYCTRL: Request<ControlQuery> = request(READ_WRITE, 36);
pub(super) const G_EXT_CTRLS: Request<ExtendedControls> = request(READ_WRITE, 71);
pub(super) const S_EXT_CTRLS: Request<ExtendedControls> = request(READ_WRITE, 72);
pub(super) const ENUM_FRAMESIZES: Request<FrameSizeEntry> = request(READ_WRITE, 74);
pub(super) const ENUM_FRAMEINTERVALS: Request<FrameIntervalEntry> = request(READ_WRITE, 75);

// Values from a C compiler for linux/videodev2.h on a 64-bit machine. The request numbers contain
// the sizes.
const _: () = {
    assert!(QUERYCAP.number as u32 == 0x8068_5600);
    assert!(ENUM_FMT.number as u32 == 0xc040_5602);
    assert!(S_FMT.number as u32 == 0xc0d0_5605);
    assert!(REQBUFS.number as u32 == 0xc014_5608);
    assert!(QUERYBUF.number as u32 == 0xc058_5609);
    assert!(QBUF.number as u32 == 0xc058_560f);
    assert!(DQBUF.number as u32 == 0xc058_5611);
    assert!(STREAMON.number as u32 == 0x4004_5612);
    assert!(STREAMOFF.number as u32 == 0x4004_5613);
    assert!(G_PARM.number as u32 == 0xc0cc_5615);
    assert!(S_PARM.number as u32 == 0xc0cc_5616);
    assert!(QUERYCTRL.number as u32 == 0xc044_5624);
    assert!(G_EXT_CTRLS.number as u32 == 0xc020_5647);
    assert!(S_EXT_CTRLS.number as u32 == 0xc020_5648);
    assert!(ENUM_FRAMESIZES.number as u32 == 0xc02c_564a);
    assert!(ENUM_FRAMEINTERVALS.number as u32 == 0xc034_564b);
    assert!(size_of::<PixFormat>() == 48);
    assert!(size_of::<ExtendedControl>() == 20);
    assert!(offset_of!(ExtendedControl, value) == 12);
    assert!(offset_of!(ExtendedControls, controls) == 24);
    assert!(offset_of!(Format, pix) == 8);
    assert!(offset_of!(Buffer, timestamp_s) == 24);
    assert!(offset_of!(Buffer, sequence) == 56);
    assert!(offset_of!(Buffer, memory) == 60);
    assert!(offset_of!(Buffer, offset) == 64);
    assert!(offset_of!(Buffer, length) == 72);
};
