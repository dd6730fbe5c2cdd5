use super::*;
use proptest::prelude::*;

fn stream(bytes: &[u8]) -> Result<Y4m<&[u8]>, Y4mError> {
    Y4m::new("test".to_owned(), bytes)
}

fn header(line: &str) -> Result<Header, Y4mError> {
    parse_header(format!("YUV4MPEG2 {line}\n").as_bytes(), "test")
}

/// All frames, and the error that ended the stream.
fn frames(bytes: &[u8]) -> (Vec<Frame>, Option<Y4mError>) {
    let mut stream = stream(bytes).expect("a header");
    let (mut frames, mut frame) = (Vec::new(), Frame::empty());
    loop {
        match stream.next(&mut frame) {
            Ok(Next::Frame) => frames.push(frame.clone()),
            Ok(_) => return (frames, None),
            Err(error) => return (frames, Some(error)),
        }
    }
}

const TWO_FRAMES: &[u8] = b"YUV4MPEG2 W2 H1 F30000:1001 C444\nFRAME\nabcdefFRAME Ixyz\nghijkl";

#[test]
fn frames_have_numbers_exact_stamps_and_their_bytes() {
    let (frames, error) = frames(TWO_FRAMES);
    assert!(error.is_none());
    assert_eq!(frames.len(), 2);
    assert_eq!((frames[0].sequence, frames[0].stamp_ns), (0, 0));
    assert_eq!(frames[0].bytes, b"abcdef");
    // 1001 / 30000 s
    assert_eq!((frames[1].sequence, frames[1].stamp_ns), (1, 33_366_666));
    assert_eq!(frames[1].bytes, b"ghijkl");
}

#[test]
fn the_rate_is_that_of_the_header() {
    let info = stream(TWO_FRAMES).expect("a header").info();
    assert_eq!(info.rate_hz, Some(30_000.0 / 1001.0));
}

#[test]
fn stamps_do_not_drift() {
    assert_eq!(stamp_ns(30_000, (30_000, 1001)), 1_001_000_000_000);
    assert_eq!(stamp_ns(u64::MAX, (1, u32::MAX)), u64::MAX);
}

#[test]
fn the_header_of_ffmpeg() {
    assert_eq!(
        header("W640 H480 F25:1 Ip A1:1 C420jpeg XYSCSS=420JPEG XCOLORRANGE=LIMITED")
            .expect("valid"),
        Header {
            size: Size {
                width: 640,
                height: 480
            },
            format: PixelFormat::I420,
            full_range: false,
            rate: (25, 1),
        }
    );
    assert!(
        header("W2 H2 F1:1 C444 XCOLORRANGE=FULL")
            .expect("valid")
            .full_range
    );
}

#[test]
fn chroma_tags() {
    for (tag, format) in [
        ("", PixelFormat::I420),
        ("C420", PixelFormat::I420),
        ("C420mpeg2", PixelFormat::I420),
        ("C420paldv", PixelFormat::I420),
        ("C422", PixelFormat::I422),
        ("C444", PixelFormat::I444),
        ("Cmono", PixelFormat::Grey),
    ] {
        let found = header(&format!("W4 H4 F1:1 {tag}")).expect("supported");
        assert_eq!(found.format, format, "{tag}");
    }
    for tag in ["C420p10", "C444alpha", "Cmono16", "C411", "C"] {
        let error = header(&format!("W4 H4 F1:1 {tag}")).expect_err("not supported");
        assert!(
            error.to_string().contains("-pix_fmt yuv420p"),
            "{tag}: {error}"
        );
    }
}

#[test]
fn square_pixels_and_unknown_ones_are_read() {
    for tag in ["A1:1", "A0:0", "A128:128", "A0:1", "A1215:1216", "A400:401"] {
        header(&format!("W4 H4 F1:1 {tag}")).expect(tag);
    }
}

#[test]
fn streams_that_cannot_be_used_say_why() {
    for (bytes, part) in [
        (&b""[..], "empty"),
        (b"\x89PNG\r\n", "not a Y4M stream"),
        (b"YUV4MPEG2X W2 H2 F1:1\n", "not a Y4M stream"),
        (b"YUV4MPEG2 W2 H2 F1:1", "not a Y4M stream"),
        (b"YUV4MPEG2 W2 H2 F1:1 It\n", "yadif"),
        (b"YUV4MPEG2 W2 H2 F1:1 Ib\n", "yadif"),
        (b"YUV4MPEG2 W2 H2 F1:1 Im\n", "yadif"),
        (b"YUV4MPEG2 W2 H2 F1:1 A12:11\n", "setsar=1"),
        (b"YUV4MPEG2 W2 H2 F1:1 A59:54\n", "setsar=1"),
        (b"YUV4MPEG2 W2 H2 F1:1 A10:11\n", "setsar=1"),
        (b"YUV4MPEG2 W2 H2 F1:1 A1\n", "'A1'"),
        (b"\x89MCAP0\r\n\x01", "from a pipe"),
        (b"YUV4MPEG2 W100000 H100000 F1:1\n", "100000x100000"),
        (b"YUV4MPEG2 W16384 H16384 F1:1\n", "16384x16384"),
        (b"YUV4MPEG2 W2 H2 F0:0\n", "no frame rate"),
        (b"YUV4MPEG2 W2 H2\n", "no frame rate"),
        (b"YUV4MPEG2 W2 H2 F25\n", "'F25'"),
        (b"YUV4MPEG2 W-2 H2 F1:1\n", "'W-2'"),
        (b"YUV4MPEG2 H2 F1:1\n", "0x2 pixels"),
        (b"YUV4MPEG2 W99999 H99999 F1:1\n", "99999x99999"),
        (b"YUV4MPEG2 W99999999999999999999999 H2 F1:1\n", "W999"),
    ] {
        let error = stream(bytes).expect_err(part).to_string();
        assert!(error.starts_with("test: "), "{error}");
        assert!(error.contains(part), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn an_endless_first_line_is_not_read_to_its_end() {
    let line = io::BufReader::new(io::repeat(b'Y'));
    let error = Y4m::new("test".to_owned(), line).expect_err("no header");
    assert!(matches!(error, Y4mError::NotY4m { .. }));
}

#[test]
fn a_cut_stream_gives_its_whole_frames_first() {
    let header = b"YUV4MPEG2 W2 H1 F30000:1001 C444\n".len();
    let first_end = header + b"FRAME\nabcdef".len();
    for end in header..TWO_FRAMES.len() {
        let (frames, error) = frames(&TWO_FRAMES[..end]);
        assert_eq!(frames.len(), usize::from(end >= first_end), "{end}");
        if end == header || end == first_end {
            assert!(error.is_none(), "{end}: {error:?}");
        } else {
            let number = u64::from(end > first_end);
            assert!(
                matches!(error, Some(Y4mError::Truncated { frame, expected: 6, .. }) if frame == number),
                "{end}: {error:?}"
            );
        }
    }
    let (_, error) = frames(&TWO_FRAMES[..TWO_FRAMES.len() - 2]);
    assert_eq!(
        error.expect("cut").to_string(),
        "test: cut off: frame 1 has 4 of 6 bytes"
    );
}

#[test]
fn garbage_between_frames_is_an_error() {
    let (frames, error) = frames(b"YUV4MPEG2 W1 H1 F1:1 Cmono\nFRAME\nx?FRAME\ny");
    assert_eq!(frames.len(), 1);
    assert!(matches!(error, Some(Y4mError::NotAFrame { frame: 1, .. })));
}

proptest! {
    #[test]
    fn any_bytes_are_an_answer(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let header = &b"YUV4MPEG2 W2 H1 F3:1\n"[..];
        _ = stream(&bytes);
        _ = frames(&[header, &bytes].concat());
    }
}
