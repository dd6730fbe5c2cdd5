//! A frame as it came from its source, and its decoding into colour planes.
//!
//! Frames travel through the program in the format in which they were captured: a recording keeps those bytes, and a frame
//! that is passed over is never decoded. [`decode`] turns one into a [`Picture`], three planes that the algorithms read.

use imgproc::Size;

/// How the bytes of a [`Frame`] are laid out. Rows follow each other without padding; planes follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// One byte of luma a pixel.
    Grey,
    /// Red, green, blue, a byte each.
    Rgb,
    /// 4:2:2, two pixels in four bytes: Y U Y V.
    Yuyv,
    /// 4:2:2, two pixels in four bytes: U Y V Y.
    Uyvy,
    /// 4:2:0, a luma plane, then a plane of U V pairs.
    Nv12,
    /// 4:2:0, three planes: Y, U, V; chroma is rounded up to whole samples at odd sizes.
    I420,
    /// 4:2:2, three planes: Y, U, V; chroma is rounded up to whole samples at odd widths.
    I422,
    /// 4:4:4, three planes: Y, U, V.
    I444,
    /// A JPEG picture, with or without its Huffman tables (MJPEG cameras omit them).
    Jpeg,
}

/// One frame in the format of its source. The buffer is reused from frame to frame.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Number of the frame in its source, from 0.
    pub sequence: u64,
    /// Moment of exposure: `CLOCK_MONOTONIC` for a camera, time since the first frame otherwise.
    pub stamp_ns: u64,
    /// Layout of `bytes`.
    pub format: PixelFormat,
    /// Whether luma and chroma use 0 to 255 instead of 16 to 235 and 16 to 240. Says nothing for `Grey`, `Rgb` and `Jpeg`.
    pub full_range: bool,
    /// Size of the picture.
    pub size: Size,
    /// The pixels.
    pub bytes: Vec<u8>,
}

/// A colour picture as three planes of equal size, full range.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Size of each plane.
    pub size: Size,
    /// Red, 0 to 255.
    pub red: Vec<u8>,
    /// Green, 0 to 255.
    pub green: Vec<u8>,
    /// Blue, 0 to 255.
    pub blue: Vec<u8>,
}
