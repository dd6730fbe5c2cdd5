//! Conversion of frames to Foxglove image messages, and back.
//!
//! `foxglove.RawImage` has encodings for grey, RGB, YUYV, UYVY and NV12, so such frames are stored
//! byte by byte. It has none for planar 4:2:0, 4:2:2 and 4:4:4: those are stored as the RGB that
//! the pipeline computes from them ([`decode`]), so that a replay uses exactly the same colours.
//! `foxglove.CompressedImage` holds JPEG images as made by the camera.
//!
//! A topic has one schema, determined by the format that the source announces. A frame of the other
//! kind (a folder may mix PNG and JPEG files) is converted without loss: a JPEG image among raw
//! ones becomes RGB, a raw one among JPEG images becomes a PNG.
//!
//! Names of compressed formats vary between programs (`jpeg`, `JPEG`, `image/jpeg`, `rgb8; jpeg
//! compressed bgr8`), so the format is detected from the first bytes.
//!
//! Deliberately absent: Foxglove's other encodings (BGR, alpha, Bayer, 16 bit, float). No frame of
//! overcam has them.

use std::error::Error;

use foxglove::bytes::Bytes;
use foxglove::messages::{CompressedImage, RawImage, Timestamp};
use foxglove::{Decode, Encode};
use imgproc::Size;

use crate::image::frame::{DecodeError, Frame, Picture, PixelFormat, decode};
use crate::image::jpeg::{self, JpegError};
use crate::image::limits::{AREA_MAX, MAX_SIDE, size_is_possible};
use crate::image::picture_file::{png_picture, write_png};
use crate::image::png::{self, Png, PngError};
use crate::run::slot::SourceInfo;

/// Coordinate frame of an image message: pixels of the camera image.
pub(crate) const IMAGE_FRAME: &str = "image";

/// How a recording stores raw frames. Images that arrive as JPEG are stored unchanged in both
/// modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageMode {
    /// A replay uses exactly the same colours.
    Lossless,
    /// Much smaller; a replay uses slightly different colours.
    Jpeg {
        /// 1 to 100; other values are clamped.
        quality: u8,
    },
}

/// The message type of an image topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ImageSchema {
    /// `foxglove.RawImage`
    Raw,
    /// `foxglove.CompressedImage`
    Compressed,
}

/// Reasons why a frame cannot be stored as a message, or a message cannot be read as a frame.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The colours of the frame cannot be computed.
    #[error(transparent)]
    Colours(#[from] DecodeError),
    /// The message cannot be parsed.
    #[error("the message is damaged: {0}")]
    Message(Box<dyn Error + Send + Sync>),
    /// The PNG image in the message cannot be decoded.
    #[error(transparent)]
    Picture(#[from] PngError),
    /// The JPEG image in the message cannot be decoded.
    #[error(transparent)]
    ReadJpeg(#[from] JpegError),
    /// The frame cannot be compressed.
    #[error("it cannot be written as JPEG: {0}")]
    WriteJpeg(#[from] jpeg_encoder::EncodingError),
    /// JPEG images have at most 65535 rows and columns.
    #[error("{width}x{height} pixels are too many for JPEG (65535x65535); record without JPEG")]
    TooLargeForJpeg {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// The number of bytes does not match the size of the image.
    #[error("it has {found} bytes, its size and layout need {expected}")]
    ByteCount {
        /// Number of bytes for size and format.
        expected: u64,
        /// Actual number of bytes.
        found: usize,
    },
    /// An unsupported encoding of `RawImage`.
    #[error(
        "cannot read a {width}x{height} image in the encoding `{encoding}` (mono8, rgb8, and in even sizes yuv422_yuy2, \
         uyvy and nv12 are read)"
    )]
    Encoding {
        /// Encoding given in the message.
        encoding: String,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// The size in the message is above the limit.
    #[error(
        "it claims {width}x{height} pixels; sides must be 1 to {MAX_SIDE}, and no more than {AREA_MAX} in all"
    )]
    TooLarge {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// An unsupported compressed image.
    #[error(
        "cannot read an image in the format `{0}`, whose bytes are neither those of a JPEG nor of a PNG file"
    )]
    Format(String),
}

impl ImageMode {
    /// Format of frames after recording and replay.
    pub(crate) fn stored_format(self, format: PixelFormat, size: Size) -> PixelFormat {
        match self {
            _ if format == PixelFormat::Jpeg => PixelFormat::Jpeg,
            Self::Jpeg { .. } => PixelFormat::Jpeg,
            Self::Lossless if raw_encoding(format, size).is_some() => format,
            Self::Lossless => PixelFormat::Rgb,
        }
    }

    /// The message type for the frames of a source.
    pub(crate) fn schema(self, info: &SourceInfo) -> ImageSchema {
        match self.stored_format(info.format, info.size) {
            PixelFormat::Jpeg => ImageSchema::Compressed,
            _ => ImageSchema::Raw,
        }
    }
}

/// Encodes frames as messages of one schema, with reused buffers.
pub(crate) struct ImageEncoder {
    mode: ImageMode,
    schema: ImageSchema,
    picture: Picture,
    rgb: Vec<u8>,
}

impl ImageEncoder {
    /// An encoder for the frames of `info`.
    pub(crate) fn new(mode: ImageMode, info: &SourceInfo) -> Self {
        Self {
            mode,
            schema: mode.schema(info),
            picture: Picture::new(info.size),
            rgb: Vec::new(),
        }
    }

    /// The schema of all messages.
    pub(crate) fn schema(&self) -> ImageSchema {
        self.schema
    }

    /// Replaces `message` by the protobuf message of a frame.
    pub(crate) fn encode(
        &mut self,
        frame: &Frame,
        timestamp: Timestamp,
        message: &mut Vec<u8>,
    ) -> Result<(), ImageError> {
        let (data, format) = match (self.schema, self.mode, frame.format) {
            (ImageSchema::Raw, _, _) => return self.encode_raw(frame, timestamp, message),
            (ImageSchema::Compressed, _, PixelFormat::Jpeg) => {
                (Bytes::copy_from_slice(&frame.bytes), "jpeg")
            }
            (ImageSchema::Compressed, ImageMode::Jpeg { quality }, _) => {
                (self.jpeg(frame, quality)?.into(), "jpeg")
            }
            (ImageSchema::Compressed, ImageMode::Lossless, _) => {
                decode(frame, &mut self.picture)?;
                (write_png(&self.picture).into(), "png")
            }
        };
        let image = CompressedImage {
            timestamp: Some(timestamp),
            frame_id: IMAGE_FRAME.to_owned(),
            data,
            format: format.to_owned(),
        };
        encode_message(&image, message);
        Ok(())
    }

    fn encode_raw(
        &mut self,
        frame: &Frame,
        timestamp: Timestamp,
        message: &mut Vec<u8>,
    ) -> Result<(), ImageError> {
        let size = frame.size;
        let (encoding, step, data) = match raw_encoding(frame.format, size) {
            Some((encoding, step)) => {
                check_byte_count(step as u64 * plane_rows(frame.format, size), frame)?;
                (encoding, step, &frame.bytes)
            }
            None => {
                decode(frame, &mut self.picture)?;
                interleave(&self.picture, &mut self.rgb);
                ("rgb8", 3 * size.width, &self.rgb)
            }
        };
        let image = RawImage {
            timestamp: Some(timestamp),
            frame_id: IMAGE_FRAME.to_owned(),
            width: size.width as u32,
            height: size.height as u32,
            encoding: encoding.to_owned(),
            step: step as u32,
            data: Bytes::copy_from_slice(data),
        };
        encode_message(&image, message);
        Ok(())
    }

    fn jpeg(&mut self, frame: &Frame, quality: u8) -> Result<Vec<u8>, ImageError> {
        let Size { width, height } = frame.size;
        let (Ok(columns), Ok(rows)) = (u16::try_from(width), u16::try_from(height)) else {
            return Err(ImageError::TooLargeForJpeg { width, height });
        };
        let mut jpeg = Vec::new();
        let encoder = jpeg_encoder::Encoder::new(&mut jpeg, quality.clamp(1, 100));
        if frame.format == PixelFormat::Grey {
            encoder.encode(&frame.bytes, columns, rows, jpeg_encoder::ColorType::Luma)?;
        } else {
            decode(frame, &mut self.picture)?;
            interleave(&self.picture, &mut self.rgb);
            encoder.encode(&self.rgb, columns, rows, jpeg_encoder::ColorType::Rgb)?;
        }
        Ok(jpeg)
    }
}

/// Replaces `buffer` by the protobuf form of a message.
pub(crate) fn encode_message<T: Encode>(message: &T, buffer: &mut Vec<u8>) {
    buffer.clear();
    message
        .encode(buffer)
        .expect("a vector grows to hold any message");
}

/// Properties known before an image is read.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Known {
    /// Size of the JPEG images in a recording made by overcam, so that they need not be parsed.
    pub(crate) jpeg_size: Option<Size>,
    /// Number of bits in use in samples of 16 bits. If unknown, the first such image determines it.
    pub(crate) n_bits: Option<u8>,
}

/// Decodes a message into size, format and bytes of `frame`; its other fields are unchanged.
pub(crate) fn decode_message(
    schema: ImageSchema,
    message: Bytes,
    known: &mut Known,
    frame: &mut Frame,
) -> Result<(), ImageError> {
    match schema {
        ImageSchema::Raw => decode_raw(&read_message(message)?, frame),
        ImageSchema::Compressed => decode_compressed(&read_message(message)?, known, frame),
    }
}

/// The timestamp in a message, in nanoseconds; `None` if there is none.
pub(crate) fn time_of_message(
    schema: ImageSchema,
    message: Bytes,
) -> Result<Option<u64>, ImageError> {
    let timestamp = match schema {
        ImageSchema::Raw => read_message::<RawImage>(message)?.timestamp,
        ImageSchema::Compressed => read_message::<CompressedImage>(message)?.timestamp,
    };
    Ok(timestamp.map(|t| t.total_nanos()).filter(|&ns| ns > 0))
}

/// The message type of a topic, if it is supported.
pub(crate) fn image_schema(name: &str, encoding: &str) -> Option<ImageSchema> {
    match (name, encoding) {
        ("foxglove.RawImage", "protobuf") => Some(ImageSchema::Raw),
        ("foxglove.CompressedImage", "protobuf") => Some(ImageSchema::Compressed),
        _ => None,
    }
}

fn read_message<T: Decode<Error: Send + Sync + 'static>>(message: Bytes) -> Result<T, ImageError> {
    T::decode(message).map_err(|error| ImageError::Message(error.into()))
}

fn decode_raw(image: &RawImage, frame: &mut Frame) -> Result<(), ImageError> {
    let size = Size {
        width: image.width as usize,
        height: image.height as usize,
    };
    if !size_is_possible(size) && size.area() > 0 {
        return Err(ImageError::TooLarge {
            width: image.width,
            height: image.height,
        });
    }
    let format = match image.encoding.to_lowercase().as_str() {
        "mono8" | "8uc1" => PixelFormat::Grey,
        "rgb8" => PixelFormat::Rgb,
        "yuv422_yuy2" | "yuyv" => PixelFormat::Yuyv,
        "yuv422" | "uyvy" => PixelFormat::Uyvy,
        "nv12" => PixelFormat::Nv12,
        _ => return Err(unreadable_encoding(image)),
    };
    let Some((_, row_bytes)) = raw_encoding(format, size).filter(|_| size.area() > 0) else {
        return Err(unreadable_encoding(image));
    };
    let rows = plane_rows(format, size);
    let step = u64::from(image.step);
    let expected = step * (rows - 1) + row_bytes as u64;
    if step < row_bytes as u64 || (image.data.len() as u64) < expected {
        return Err(ImageError::ByteCount {
            expected: expected.max(row_bytes as u64 * rows),
            found: image.data.len(),
        });
    }
    frame.size = size;
    frame.format = format;
    frame.bytes.clear();
    let padded_rows = image.data.chunks(image.step as usize).take(rows as usize);
    for row in padded_rows {
        frame.bytes.extend_from_slice(&row[..row_bytes]);
    }
    Ok(())
}

fn decode_compressed(
    image: &CompressedImage,
    known: &mut Known,
    frame: &mut Frame,
) -> Result<(), ImageError> {
    let data = &image.data;
    let own_size = known.jpeg_size.filter(|_| image.format == "jpeg");
    if own_size.is_some() || data.starts_with(&[0xff, 0xd8]) {
        frame.size = match own_size {
            Some(size) => size,
            None => jpeg::size(data)?,
        };
        frame.format = PixelFormat::Jpeg;
        frame.bytes.clear();
        frame.bytes.extend_from_slice(data);
    } else if data.starts_with(png::SIGNATURE) {
        let png = Png::read(data)?;
        known.n_bits = known.n_bits.or_else(|| png.n_bits());
        let picture = png_picture(&png, known.n_bits);
        frame.size = picture.size;
        frame.format = PixelFormat::Rgb;
        interleave(&picture, &mut frame.bytes);
    } else {
        return Err(ImageError::Format(image.format.clone()));
    }
    Ok(())
}

fn interleave(picture: &Picture, rgb: &mut Vec<u8>) {
    rgb.resize(3 * picture.size.area(), 0);
    let planes = picture.red.iter().zip(&picture.green).zip(&picture.blue);
    for (pixel, ((red, green), blue)) in rgb.chunks_exact_mut(3).zip(planes) {
        pixel.copy_from_slice(&[*red, *green, *blue]);
    }
}

/// Foxglove's name for a format, and its bytes per row, if `RawImage` supports it at this size:
/// subsampled formats need even sizes.
fn raw_encoding(format: PixelFormat, size: Size) -> Option<(&'static str, usize)> {
    let Size { width, height } = size;
    let (even_width, even_height) = (width.is_multiple_of(2), height.is_multiple_of(2));
    match format {
        PixelFormat::Grey => Some(("mono8", width)),
        PixelFormat::Rgb => Some(("rgb8", 3 * width)),
        PixelFormat::Yuyv if even_width => Some(("yuv422_yuy2", 2 * width)),
        PixelFormat::Uyvy if even_width => Some(("uyvy", 2 * width)),
        PixelFormat::Nv12 if even_width && even_height => Some(("nv12", width)),
        _ => None,
    }
}

/// Total rows of all planes of a format supported by [`raw_encoding`].
fn plane_rows(format: PixelFormat, size: Size) -> u64 {
    let rows = size.height as u64;
    match format {
        PixelFormat::Nv12 => rows + rows / 2,
        _ => rows,
    }
}

fn check_byte_count(expected: u64, frame: &Frame) -> Result<(), ImageError> {
    if frame.bytes.len() as u64 == expected {
        Ok(())
    } else {
        Err(ImageError::ByteCount {
            expected,
            found: frame.bytes.len(),
        })
    }
}

fn unreadable_encoding(image: &RawImage) -> ImageError {
    ImageError::Encoding {
        encoding: image.encoding.clone(),
        width: image.width,
        height: image.height,
    }
}

#[cfg(test)]
mod tests;
