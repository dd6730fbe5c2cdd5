//! Picture files: a folder of PNG and JPEG files as a source, single pictures, and PNG for recordings.
//!
//! The files of a folder are taken in natural order of their names (`img2` before `img10`). What a file is, its first bytes
//! say, not its name. JPEG files travel on as they are; of PNG files, grey ones become [`PixelFormat::Grey`] frames and all
//! others [`PixelFormat::Rgb`]; 16 bits a sample are reduced to 8 and an alpha channel is dropped. Files of a folder may differ in
//! format but not in size.
//!
//! Deliberately absent: the orientation in a JPEG file's Exif data. A ceiling camera's pictures are wanted as the sensor saw
//! them, and a folder in which it differs from file to file would be no fixed camera.

use std::cmp::Ordering;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::{fs, io};

use image::codecs::png::PngEncoder;
use image::{DynamicImage, ExtendedColorType, ImageEncoder, ImageFormat, ImageReader};
use imgproc::Size;

use crate::frame::{DecodeError, Frame, MAX_SIDE, Picture, PixelFormat, decode};
use crate::jpeg::{self, JpegError};
use crate::slot::{Next, SourceInfo};

/// Frames per second of a folder when the user states none. Pictures carry no clock, and stamps need one.
pub const DEFAULT_RATE_HZ: f64 = 30.0;

/// First bytes of every PNG file.
pub(crate) const PNG_SIGNATURE: &[u8] = b"\x89PNG";

/// Why a picture file or a folder of them cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The folder cannot be listed.
    #[error("{}: the folder cannot be listed: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The folder has no picture files.
    #[error("{}: no pictures in this folder: it needs files ending in .png, .jpg or .jpeg", path.display())]
    NoPictures {
        /// The folder.
        path: PathBuf,
    },
    /// A frame rate that gives no stamps.
    #[error("a rate of {rate_hz} frames/s is not possible: it must be above 0")]
    Rate {
        /// What was asked for.
        rate_hz: f64,
    },
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The file is neither PNG nor JPEG.
    #[error("{}: neither a PNG nor a JPEG file", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// A damaged PNG file.
    #[error("{}: damaged PNG file: {reason}", path.display())]
    Png {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        reason: String,
    },
    /// A damaged JPEG file.
    #[error("{}: {source}", path.display())]
    Jpeg {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: JpegError,
    },
    /// A file whose pixels cannot be decoded.
    #[error("{}: {source}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: DecodeError,
    },
    /// A picture of another size than the folder's first.
    #[error(
        "{}: {}x{} pixels, but the folder's first picture has {}x{}: all must have one size",
        path.display(), found.width, found.height, expected.width, expected.height
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Size of the first picture.
        expected: Size,
        /// Size of this one.
        found: Size,
    },
}

/// A folder of picture files.
#[derive(Debug)]
pub struct Pictures {
    info: SourceInfo,
    rate_hz: f64,
    /// In the order in which they are read.
    files: Vec<PathBuf>,
    /// Number of the next file.
    next: usize,
}

impl Pictures {
    /// Lists a folder and reads its first picture, which sets the size of all. Stamps are counted from 0 at `rate_hz` frames a
    /// second.
    ///
    /// # Errors
    ///
    /// [`PictureError`] when there is no picture, the first one cannot be read, or the rate is not above 0.
    pub fn open(folder: &Path, rate_hz: f64) -> Result<Self, PictureError> {
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return Err(PictureError::Rate { rate_hz });
        }
        let files = list(folder)?;
        let Some(first) = files.first() else {
            return Err(PictureError::NoPictures {
                path: folder.to_owned(),
            });
        };
        let mut frame = Frame::empty();
        read_frame(first, &mut frame)?;
        Ok(Self {
            info: SourceInfo {
                name: folder.display().to_string(),
                size: frame.size,
                format: frame.format,
                rate_hz: Some(rate_hz),
                live: false,
                controls: None,
            },
            rate_hz,
            files,
            next: 0,
        })
    }

    /// What is known of the pictures; the format is the first one's.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        self.info.clone()
    }

    /// Reads the next picture.
    ///
    /// # Errors
    ///
    /// [`PictureError`] when the file cannot be read, is damaged or has another size than the first.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Next, PictureError> {
        let Some(path) = self.files.get(self.next) else {
            return Ok(Next::End);
        };
        read_frame(path, frame)?;
        if frame.size != self.info.size {
            return Err(PictureError::Size {
                path: path.clone(),
                expected: self.info.size,
                found: frame.size,
            });
        }
        frame.sequence = self.next as u64;
        frame.stamp_ns = (self.next as f64 * 1e9 / self.rate_hz).round() as u64;
        self.next += 1;
        Ok(Next::Frame)
    }
}

/// Reads and decodes a PNG or JPEG file.
///
/// # Errors
///
/// [`PictureError`] when the file cannot be read or is damaged.
pub fn read_picture(path: &Path) -> Result<Picture, PictureError> {
    let mut frame = Frame::empty();
    read_frame(path, &mut frame)?;
    let mut picture = Picture::new(frame.size);
    decode(&frame, &mut picture).map_err(|source| PictureError::Decode {
        path: path.to_owned(),
        source,
    })?;
    Ok(picture)
}

/// The picture as a PNG file.
///
/// # Panics
///
/// If the picture is empty or its planes do not have its size.
#[must_use]
pub fn write_png(picture: &Picture) -> Vec<u8> {
    let Size { width, height } = picture.size;
    let channels = picture.red.iter().zip(&picture.green).zip(&picture.blue);
    let interleaved: Vec<u8> = channels
        .flat_map(|((&red, &green), &blue)| [red, green, blue])
        .collect();
    let mut png = Vec::new();
    let written = PngEncoder::new(&mut png).write_image(
        &interleaved,
        width as u32,
        height as u32,
        ExtendedColorType::Rgb8,
    );
    if let Err(error) = written {
        panic!("a picture of {width}x{height} pixels cannot become a PNG file: {error}");
    }
    png
}

/// Fills format, size and bytes of a frame from a file.
fn read_frame(path: &Path, frame: &mut Frame) -> Result<(), PictureError> {
    let file = fs::read(path).map_err(|source| PictureError::Read {
        path: path.to_owned(),
        source,
    })?;
    frame.full_range = true;
    frame.bytes.clear();
    if file.starts_with(&[0xff, 0xd8]) {
        frame.size = jpeg::size(&file).map_err(|source| PictureError::Jpeg {
            path: path.to_owned(),
            source,
        })?;
        frame.format = PixelFormat::Jpeg;
        frame.bytes.extend_from_slice(&file);
        return Ok(());
    }
    if !file.starts_with(PNG_SIGNATURE) {
        return Err(PictureError::Format {
            path: path.to_owned(),
        });
    }
    let picture = decode_png(&file).map_err(|error| PictureError::Png {
        path: path.to_owned(),
        reason: error.to_string(),
    })?;
    frame.size = Size {
        width: picture.width() as usize,
        height: picture.height() as usize,
    };
    if picture.color().has_color() {
        frame.format = PixelFormat::Rgb;
        frame.bytes.extend_from_slice(&picture.into_rgb8());
    } else {
        frame.format = PixelFormat::Grey;
        frame.bytes.extend_from_slice(&picture.into_luma8());
    }
    Ok(())
}

pub(crate) fn decode_png(file: &[u8]) -> image::ImageResult<DynamicImage> {
    let mut reader = ImageReader::with_format(io::Cursor::new(file), ImageFormat::Png);
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    reader.limits(limits);
    reader.decode()
}

/// The folder's picture files in natural order of their names. Hidden files are left out: some systems put a `._img1.png` that is
/// no picture beside each `img1.png`.
fn list(folder: &Path) -> Result<Vec<PathBuf>, PictureError> {
    let failed = |source| PictureError::Folder {
        path: folder.to_owned(),
        source,
    };
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        let is_picture = ["png", "jpg", "jpeg"]
            .iter()
            .any(|&known| extension == known);
        if is_picture && !file_name(&path).as_encoded_bytes().starts_with(b".") {
            files.push(path);
        }
    }
    files.sort_by(|a, b| {
        let (a, b) = (file_name(a), file_name(b));
        natural_order(a.as_encoded_bytes(), b.as_encoded_bytes()).then_with(|| a.cmp(b))
    });
    Ok(files)
}

fn file_name(path: &Path) -> &OsStr {
    path.file_name().unwrap_or_default()
}

/// Compares names as people count: runs of digits by their value, everything else byte by byte.
fn natural_order(mut a: &[u8], mut b: &[u8]) -> Ordering {
    fn split_digits(name: &[u8]) -> (&[u8], &[u8]) {
        let n = name.iter().take_while(|byte| byte.is_ascii_digit()).count();
        name.split_at(n)
    }
    fn without_zeros(number: &[u8]) -> &[u8] {
        let zeros = number.iter().take_while(|&&digit| digit == b'0').count();
        &number[zeros..]
    }
    while let (Some(&first_a), Some(&first_b)) = (a.first(), b.first()) {
        if first_a.is_ascii_digit() && first_b.is_ascii_digit() {
            let (number_a, rest_a) = split_digits(a);
            let (number_b, rest_b) = split_digits(b);
            let (value_a, value_b) = (without_zeros(number_a), without_zeros(number_b));
            // Without leading zeros, the longer number is the larger.
            let order = value_a.len().cmp(&value_b.len()).then(value_a.cmp(value_b));
            if order.is_ne() {
                return order;
            }
            (a, b) = (rest_a, rest_b);
        } else if first_a != first_b {
            return first_a.cmp(&first_b);
        } else {
            (a, b) = (&a[1..], &b[1..]);
        }
    }
    a.len().cmp(&b.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, ImageBuffer, LumaA, Rgb, RgbImage, Rgba};

    const SIZE: Size = Size {
        width: 5,
        height: 3,
    };

    fn picture() -> Picture {
        let mut picture = Picture::new(SIZE);
        for i in 0..SIZE.area() {
            picture.red[i] = 17 * i as u8;
            picture.green[i] = 255 - 5 * i as u8;
            picture.blue[i] = 3;
        }
        picture
    }

    fn jpeg(size: Size) -> Vec<u8> {
        let mut jpeg = Vec::new();
        jpeg_encoder::Encoder::new(&mut jpeg, 90)
            .encode(
                &vec![90; size.area()],
                size.width as u16,
                size.height as u16,
                jpeg_encoder::ColorType::Luma,
            )
            .expect("encodes");
        jpeg
    }

    fn folder(files: &[(&str, &[u8])]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, bytes) in files {
            fs::write(folder.path().join(name), bytes).expect("written");
        }
        folder
    }

    fn names(folder: &Path) -> Vec<String> {
        let files = list(folder).expect("listed");
        files
            .iter()
            .map(|path| file_name(path).to_string_lossy().into_owned())
            .collect()
    }

    #[test]
    fn a_picture_survives_png() {
        let folder = folder(&[("floor.png", &write_png(&picture()))]);
        let read = read_picture(&folder.path().join("floor.png")).expect("read");
        assert_eq!(read, picture());
    }

    #[test]
    fn names_count_as_people_do() {
        let folder = folder(&[
            ("img10.png", b""),
            ("img2.JPG", b""),
            ("img02.png", b""),
            ("img1.jpeg", b""),
            ("a.png", b""),
            ("._a.png", b""),
            ("notes.txt", b""),
            ("png", b""),
        ]);
        assert_eq!(
            names(folder.path()),
            ["a.png", "img1.jpeg", "img2.JPG", "img02.png", "img10.png"]
        );
    }

    #[test]
    fn natural_order_is_by_value() {
        for (smaller, larger) in [
            ("img2", "img10"),
            ("img2", "img2b"),
            ("9", "10"),
            ("a9b1", "a9b02"),
            ("x99999999999999999999998", "x99999999999999999999999"),
            ("a", "b1"),
            ("img009", "img10"),
        ] {
            let (a, b) = (smaller.as_bytes(), larger.as_bytes());
            assert_eq!(natural_order(a, b), Ordering::Less, "{smaller} {larger}");
            assert_eq!(natural_order(b, a), Ordering::Greater);
        }
        assert_eq!(natural_order(b"img007", b"img7"), Ordering::Equal);
    }

    #[test]
    fn formats_may_be_mixed() {
        let jpeg = jpeg(SIZE);
        let folder = folder(&[("1.png", &write_png(&picture())), ("2.jpg", &jpeg)]);
        let mut pictures = Pictures::open(folder.path(), 4.0).expect("opens");
        assert_eq!(pictures.info().size, SIZE);
        assert_eq!(pictures.info().format, PixelFormat::Rgb);
        let mut frame = Frame::empty();
        assert_eq!(pictures.next(&mut frame).expect("first"), Next::Frame);
        assert_eq!((frame.sequence, frame.stamp_ns), (0, 0));
        assert_eq!(frame.format, PixelFormat::Rgb);
        assert_eq!(frame.bytes[..6], [0, 255, 3, 17, 250, 3]);
        assert_eq!(pictures.next(&mut frame).expect("second"), Next::Frame);
        assert_eq!((frame.sequence, frame.stamp_ns), (1, 250_000_000));
        assert_eq!(frame.format, PixelFormat::Jpeg);
        assert_eq!(frame.bytes, jpeg);
        assert_eq!(pictures.next(&mut frame).expect("end"), Next::End);
        assert_eq!(pictures.next(&mut frame).expect("end"), Next::End);
    }

    /// What [`read_frame`] makes of the picture as a PNG file.
    fn through_png(picture: DynamicImage) -> Frame {
        let mut png = io::Cursor::new(Vec::new());
        picture
            .write_to(&mut png, ImageFormat::Png)
            .expect("encodes");
        let folder = folder(&[("x.png", png.get_ref())]);
        let mut frame = Frame::empty();
        read_frame(&folder.path().join("x.png"), &mut frame).expect("read");
        frame
    }

    #[test]
    fn depth_and_alpha_are_reduced() {
        let grey = through_png(
            GrayImage::from_raw(2, 1, vec![7, 200])
                .expect("size")
                .into(),
        );
        assert_eq!((grey.format, grey.bytes), (PixelFormat::Grey, vec![7, 200]));
        let alpha: ImageBuffer<LumaA<u8>, _> =
            ImageBuffer::from_raw(2, 1, vec![7, 0, 200, 90]).expect("size");
        let grey = through_png(alpha.into());
        assert_eq!((grey.format, grey.bytes), (PixelFormat::Grey, vec![7, 200]));
        let alpha: ImageBuffer<Rgba<u8>, _> =
            ImageBuffer::from_raw(1, 1, vec![1, 2, 3, 0]).expect("size");
        let rgb = through_png(alpha.into());
        assert_eq!((rgb.format, rgb.bytes), (PixelFormat::Rgb, vec![1, 2, 3]));
        let deep: ImageBuffer<Rgb<u16>, _> =
            ImageBuffer::from_raw(1, 1, vec![0, 257 * 100, 65535]).expect("size");
        let rgb = through_png(deep.into());
        assert_eq!(
            (rgb.format, rgb.bytes),
            (PixelFormat::Rgb, vec![0, 100, 255])
        );
    }

    #[test]
    fn another_size_is_an_error_with_both() {
        let large = jpeg(Size {
            width: 8,
            height: 8,
        });
        let folder = folder(&[("1.png", &write_png(&picture())), ("2.jpg", &large)]);
        let mut pictures = Pictures::open(folder.path(), DEFAULT_RATE_HZ).expect("opens");
        let mut frame = Frame::empty();
        pictures.next(&mut frame).expect("first");
        let error = pictures.next(&mut frame).expect_err("size").to_string();
        assert!(
            error.contains("2.jpg: 8x8") && error.contains("5x3"),
            "{error}"
        );
    }

    #[test]
    fn every_truncated_file_is_one_clear_line() {
        let large = RgbImage::from_fn(40, 30, |x, y| Rgb([(x * 6) as u8, (y * 8) as u8, 9]));
        let mut png = io::Cursor::new(Vec::new());
        large.write_to(&mut png, ImageFormat::Png).expect("encodes");
        for (name, whole) in [("x.png", png.into_inner()), ("x.jpg", jpeg(SIZE))] {
            // The checksum of the last chunk, which carries no pixels, may be missing.
            for end in (0..whole.len() - 12).step_by(7) {
                let folder = folder(&[(name, &whole[..end])]);
                let error = read_picture(&folder.path().join(name)).expect_err("cut");
                let error = error.to_string();
                assert!(
                    error.contains(name) && !error.contains('\n'),
                    "{end}: {error}"
                );
            }
        }
    }

    #[test]
    fn unusable_folders_say_why() {
        let empty = folder(&[("notes.txt", b"")]);
        let error = Pictures::open(empty.path(), DEFAULT_RATE_HZ).expect_err("empty");
        assert!(matches!(error, PictureError::NoPictures { .. }));
        let missing = empty.path().join("missing");
        let error = Pictures::open(&missing, DEFAULT_RATE_HZ).expect_err("missing");
        assert!(matches!(error, PictureError::Folder { .. }));
        for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let error = Pictures::open(empty.path(), rate_hz).expect_err("rate");
            assert!(matches!(error, PictureError::Rate { .. }));
        }
        let text = folder(&[("x.png", b"hello")]);
        let error = Pictures::open(text.path(), DEFAULT_RATE_HZ).expect_err("text");
        assert!(matches!(error, PictureError::Format { .. }));
    }
}
