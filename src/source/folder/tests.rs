use super::*;
use crate::image::frame::{Picture, PixelFormat};
use crate::image::picture_file::{read_picture, write_png};
use crate::image::png::PngError;
use image::{DynamicImage, GrayImage, ImageBuffer, ImageFormat, Luma, LumaA, Rgb, RgbImage, Rgba};

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

/// Result of [`read_frame`] for the image as a PNG file.
fn through_png(picture: DynamicImage) -> Frame {
    let mut png = io::Cursor::new(Vec::new());
    picture
        .write_to(&mut png, ImageFormat::Png)
        .expect("encodes");
    let folder = folder(&[("x.png", png.get_ref())]);
    let mut frame = Frame::empty();
    read_frame(&folder.path().join("x.png"), None, &mut frame).expect("read");
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

/// The checksum of a PNG chunk.
fn crc32(content: &[u8]) -> u32 {
    let of_byte = |byte: u32| {
        (0..8).fold(byte, |crc, _| {
            (crc >> 1) ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 }
        })
    };
    let add = |crc: u32, byte: &u8| of_byte((crc ^ u32::from(*byte)) & 255) ^ (crc >> 8);
    !content.iter().fold(u32::MAX, add)
}

/// A grey image of 16 bits per sample as a PNG file, optionally with the original number of bits.
fn deep(samples: &[u16], stated_bits: Option<u8>) -> Vec<u8> {
    let mut png = io::Cursor::new(Vec::new());
    let image: ImageBuffer<Luma<u16>, _> =
        ImageBuffer::from_raw(samples.len() as u32, 1, samples.to_vec()).expect("size");
    DynamicImage::from(image)
        .write_to(&mut png, ImageFormat::Png)
        .expect("encodes");
    let mut png = png.into_inner();
    if let Some(bits) = stated_bits {
        // After the header: the signature's 8 bytes and a chunk of 13.
        let crc = crc32(&[b's', b'B', b'I', b'T', bits]);
        let chunk = [&[0, 0, 0, 1], b"sBIT", &[bits][..], &crc.to_be_bytes()].concat();
        png.splice(33..33, chunk);
    }
    png
}

#[test]
fn samples_that_use_fewer_bits_are_not_read_as_black() {
    for (samples, stated, n_bits, read) in [
        // 10, 12 and 14 bits unscaled; the number stated in the file does not matter.
        (&[0, 511, 1023][..], None, Some(10), &[0, 127, 255][..]),
        (&[0, 511, 1023], Some(10), Some(10), &[0, 127, 255]),
        (&[0, 1000, 4095], None, Some(12), &[0, 62, 255]),
        (&[0, 1000, 4095], Some(12), Some(12), &[0, 62, 255]),
        // The brightest sample is below the end of the range.
        (&[0, 300, 700], Some(12), Some(12), &[0, 19, 44]),
        (&[0, 5001, 16383], None, Some(14), &[0, 78, 255]),
        // Scaled to 16 bits, as required.
        (&[0, 257 * 9, 257 * 15], None, Some(16), &[0, 9, 15]),
        (&[0, 64 * 70, 64 * 255], None, Some(16), &[0, 17, 64]),
        (
            &[0, 1023 << 6, 511 << 6],
            Some(10),
            Some(16),
            &[0, 255, 127],
        ),
        (&[0, 40_000, 65_535], None, Some(16), &[0, 156, 255]),
    ] {
        let png = Png::read(&deep(samples, stated)).expect("a PNG file");
        assert_eq!(png.n_bits(), n_bits, "{samples:?}");
        assert_eq!(png.colours(png.n_bits()), read, "{samples:?}");
    }
    assert_eq!(
        Png::read(&deep(&[0, 0], None))
            .expect("a PNG file")
            .n_bits(),
        None
    );
}

#[test]
fn all_pictures_of_a_folder_are_reduced_alike() {
    // 12 bits, of which the first images use fewer.
    let files: Vec<_> = (0..40_u16)
        .map(|i| (format!("{i}.png"), deep(&[0, 400, 400 + 90 * i], None)))
        .collect();
    let files: Vec<_> = files
        .iter()
        .map(|(name, png)| (&name[..], &png[..]))
        .collect();
    let folder = folder(&files);
    let mut pictures = Pictures::open(folder.path(), 30.0).expect("opens");
    assert_eq!(pictures.n_bits(), Some(12));
    let mut frame = Frame::empty();
    for i in 0..40 {
        assert_eq!(pictures.next(&mut frame).expect("read"), Next::Frame);
        let expected = (400.0 + 90.0 * f64::from(i)) / 4095.0 * 255.0;
        assert_eq!(frame.bytes, [0, 25, expected.round() as u8], "{i}");
    }
}

#[test]
fn a_damaged_picture_is_passed_over_and_keeps_its_number() {
    let good = write_png(&picture());
    let jpeg = jpeg(SIZE);
    let cut = [&jpeg[..jpeg.len() - 4], &[0xff, 0xd9]].concat();
    let files = [
        ("1.png", &good[..good.len() / 2]),
        ("2.png", &good),
        ("3.jpg", &cut),
        ("4.jpg", &jpeg),
        ("5.png", b"hello"),
    ];
    let folder_of = folder(&files);
    let mut pictures = Pictures::open(folder_of.path(), 10.0).expect("some can be read");
    assert_eq!(pictures.info().size, SIZE);
    let mut frame = Frame::empty();
    for number in [1, 3] {
        assert_eq!(pictures.next(&mut frame).expect("read"), Next::Frame);
        assert_eq!(
            (frame.sequence, frame.stamp_ns),
            (number, number * 100_000_000)
        );
    }
    assert_eq!(pictures.next(&mut frame).expect("the end"), Next::End);
    assert_eq!(pictures.n_damaged(), 3);

    let none = folder(&[files[0], files[2], files[4]]);
    let error = Pictures::open(none.path(), 10.0).expect_err("none can be read");
    assert!(matches!(error, FolderError::NoneReadable { count: 3, .. }));
    let line = error.to_string();
    assert!(line.contains("1.png") && !line.contains('\n'), "{line}");
}

#[test]
fn a_png_header_may_not_claim_everything() {
    let whole = write_png(&picture());
    for (width, height) in [(100_000_u32, 100_000_u32), (16_384, 16_384), (8_000, 8_000)] {
        let mut png = whole.clone();
        png[16..20].copy_from_slice(&width.to_be_bytes());
        png[20..24].copy_from_slice(&height.to_be_bytes());
        let crc = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&crc.to_be_bytes());
        let error = Png::read(&png).map(|_| ()).expect_err("too large");
        assert!(matches!(error, PngError::TooLarge { .. }), "{error}");
    }
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
        // The checksum of the last chunk, which has no pixels, may be missing.
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
    assert!(matches!(error, FolderError::NoPictures { .. }));
    let missing = empty.path().join("missing");
    let error = Pictures::open(&missing, DEFAULT_RATE_HZ).expect_err("missing");
    assert!(matches!(error, FolderError::Folder { .. }));
    for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = Pictures::open(empty.path(), rate_hz).expect_err("rate");
        assert!(matches!(error, FolderError::Rate { .. }));
    }
    let text = folder(&[("x.png", b"hello")]);
    let error = Pictures::open(text.path(), DEFAULT_RATE_HZ).expect_err("text");
    assert!(matches!(
        error,
        FolderError::Picture(PictureError::Format { .. })
    ));
}
