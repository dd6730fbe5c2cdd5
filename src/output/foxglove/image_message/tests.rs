use super::*;

fn info(format: PixelFormat, size: Size) -> SourceInfo {
    SourceInfo {
        name: "test".to_owned(),
        size,
        format,
        rate_hz: None,
        live: false,
        controls: None,
    }
}

/// A frame whose bytes all differ from their neighbours.
fn frame(format: PixelFormat, width: usize, height: usize) -> Frame {
    let size = Size { width, height };
    let n_bytes = format.frame_bytes(size).expect("the format is raw");
    Frame {
        format,
        size,
        full_range: true,
        bytes: (0..n_bytes).map(|i| (i * 37 % 251) as u8).collect(),
        ..Frame::empty()
    }
}

fn round_trip(mode: ImageMode, announced: PixelFormat, frame: &Frame) -> Frame {
    let mut encoder = ImageEncoder::new(mode, &info(announced, frame.size));
    let mut message = vec![0xaa; 7];
    encoder
        .encode(frame, Timestamp::new(1, 2), &mut message)
        .expect("the frame can be stored");
    let mut read = Frame {
        full_range: frame.full_range,
        ..Frame::empty()
    };
    decode_message(
        encoder.schema(),
        message.into(),
        &mut Known::default(),
        &mut read,
    )
    .expect("the message can be read");
    read
}

fn colours(frame: &Frame) -> Picture {
    let mut picture = Picture::new(frame.size);
    decode(frame, &mut picture).expect("the frame has colours");
    picture
}

#[test]
fn formats_that_foxglove_knows_keep_their_bytes() {
    for format in [
        PixelFormat::Grey,
        PixelFormat::Rgb,
        PixelFormat::Yuyv,
        PixelFormat::Uyvy,
        PixelFormat::Nv12,
    ] {
        let frame = frame(format, 6, 4);
        let read = round_trip(ImageMode::Lossless, format, &frame);
        assert_eq!(
            (read.format, read.size, read.bytes),
            (format, frame.size, frame.bytes)
        );
    }
}

#[test]
fn other_formats_and_odd_sizes_keep_their_colours() {
    for (format, width, height) in [
        (PixelFormat::I420, 6, 4),
        (PixelFormat::I422, 6, 4),
        (PixelFormat::I444, 5, 3),
        (PixelFormat::Yuyv, 5, 4),
        (PixelFormat::Nv12, 6, 3),
    ] {
        for full_range in [false, true] {
            let frame = Frame {
                full_range,
                ..frame(format, width, height)
            };
            let read = round_trip(ImageMode::Lossless, format, &frame);
            assert_eq!(read.format, PixelFormat::Rgb);
            assert_eq!(colours(&read), colours(&frame), "{format:?}");
        }
    }
}

#[test]
fn a_topic_keeps_its_schema_when_formats_are_mixed() {
    let raw = frame(PixelFormat::Rgb, 16, 8);
    let jpeg = round_trip(
        ImageMode::Jpeg { quality: 90 },
        PixelFormat::Rgb,
        &raw.clone(),
    );
    assert_eq!(jpeg.format, PixelFormat::Jpeg);

    let raw_among_jpeg = round_trip(ImageMode::Lossless, PixelFormat::Jpeg, &raw);
    assert_eq!(raw_among_jpeg.bytes, raw.bytes);
    let jpeg_among_raw = round_trip(ImageMode::Lossless, PixelFormat::Rgb, &jpeg);
    assert_eq!(jpeg_among_raw.format, PixelFormat::Rgb);
    assert_eq!(colours(&jpeg_among_raw), colours(&jpeg));
    let jpeg_among_jpeg = round_trip(ImageMode::Jpeg { quality: 5 }, PixelFormat::Jpeg, &jpeg);
    assert_eq!(
        jpeg_among_jpeg.bytes, jpeg.bytes,
        "it is not compressed twice"
    );
}

#[test]
fn padding_of_rows_is_removed() {
    let image = RawImage {
        width: 2,
        height: 2,
        encoding: "8UC1".to_owned(),
        step: 3,
        data: Bytes::from_static(&[1, 2, 99, 3, 4]),
        ..RawImage::default()
    };
    let mut read = Frame::empty();
    decode_raw(&image, &mut read).expect("the last row needs no padding");
    assert_eq!(read.bytes, [1, 2, 3, 4]);
}

#[test]
fn a_compressed_image_is_what_its_bytes_are() {
    let raw = frame(PixelFormat::Rgb, 16, 8);
    let jpeg = round_trip(ImageMode::Jpeg { quality: 90 }, PixelFormat::Rgb, &raw).bytes;
    let mut read = Frame::empty();
    let mut decode = |format: &str, data: &[u8]| {
        let image = CompressedImage {
            format: format.to_owned(),
            data: Bytes::copy_from_slice(data),
            ..CompressedImage::default()
        };
        decode_compressed(&image, &mut Known::default(), &mut read).map(|()| read.format)
    };
    for format in [
        "jpeg",
        "JPG",
        "image/jpeg",
        "rgb8; jpeg compressed bgr8",
        "",
        "png",
    ] {
        let read = decode(format, &jpeg).expect("it is JPEG");
        assert_eq!(read, PixelFormat::Jpeg, "{format}");
    }
    let png = write_png(&Picture::new(raw.size));
    for format in ["png", "PNG", "mono8; png compressed mono8"] {
        assert_eq!(
            decode(format, &png).expect("it is PNG"),
            PixelFormat::Rgb,
            "{format}"
        );
    }
    let error = decode("webp", b"RIFF....WEBP").expect_err("not read");
    assert!(error.to_string().contains("`webp`"), "{error}");
    let cut = [&jpeg[..jpeg.len() / 2], &[0xff, 0xd9]].concat();
    decode("jpeg", &cut).expect_err("cut off");
}

#[test]
fn images_that_do_not_fit_are_refused() {
    let image = |encoding: &str, width, height, step, n_bytes: usize| RawImage {
        width,
        height,
        encoding: encoding.to_owned(),
        step,
        data: vec![0; n_bytes].into(),
        ..RawImage::default()
    };
    let mut read = Frame::empty();
    let mut refuse = |image: RawImage| match decode_raw(&image, &mut read) {
        Err(error) => error,
        Ok(()) => panic!("{image:?} was read"),
    };
    for (encoding, width, height) in [
        ("bgr8", 2, 2),
        ("mono8", 0, 2),
        ("mono8", 2, 0),
        ("yuyv", 3, 2),
        ("nv12", 2, 3),
    ] {
        let error = refuse(image(encoding, width, height, 100, 1000));
        assert!(matches!(error, ImageError::Encoding { .. }), "{error}");
    }
    let error = refuse(image("mono8", 100_000, 100_000, 100_000, 1000));
    assert!(matches!(error, ImageError::TooLarge { .. }), "{error}");
    for (encoding, step, n_bytes, needed) in [
        ("rgb8", 6, 11, 12),
        ("rgb8", 5, 12, 12),
        ("rgb8", 0, 12, 12),
        ("nv12", 2, 5, 6),
        ("mono8", u32::MAX, 4, u64::from(u32::MAX) + 2),
    ] {
        match refuse(image(encoding, 2, 2, step, n_bytes)) {
            ImageError::ByteCount { expected, found } => {
                assert_eq!(
                    (expected, found),
                    (needed, n_bytes),
                    "{encoding}, step {step}"
                );
            }
            error => panic!("{error}"),
        }
    }
    let short = Frame {
        bytes: vec![0; 7],
        ..frame(PixelFormat::Yuyv, 2, 2)
    };
    let mut encoder = ImageEncoder::new(ImageMode::Lossless, &info(short.format, short.size));
    let error = encoder.encode(&short, Timestamp::new(0, 0), &mut Vec::new());
    assert!(matches!(
        error,
        Err(ImageError::ByteCount {
            expected: 8,
            found: 7
        })
    ));
}
