//! Capturing from real V4L2 devices: the kernel's test camera `vivid` with its fault injection, and
//! `v4l2loopback`.
//!
//! `tests/v4l2-vm/test` runs all tests in a virtual machine, because both devices need kernel
//! modules and the faults are set with `v4l2-ctl`. The tests run one at a time, since there is only
//! one camera.
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use std::{env, fs};

use imgproc::Size;
use overcam::camera::controls::ControlRequest;
use overcam::camera::devices;
use overcam::camera::{Camera, CameraError, CameraRequest, Counters, Loss};
use overcam::image::frame::{Frame, Picture, PixelFormat, decode};
use overcam::run::slot::Next;

const VGA: Size = Size {
    width: 640,
    height: 480,
};
/// The emulated machine is slow, but nothing here should take this long.
const PATIENCE: Duration = Duration::from_secs(60);

fn node() -> PathBuf {
    env::var_os("OVERCAM_TEST_CAMERA").map_or_else(|| "/dev/video0".into(), PathBuf::from)
}

/// Skips the second of waiting for automatic controls, which most tests do not concern.
fn open(request: CameraRequest) -> Camera {
    let controls = ControlRequest {
        camera_auto: true,
        ..request.controls
    };
    start(CameraRequest {
        controls,
        ..request
    })
}

fn start(request: CameraRequest) -> Camera {
    let mut camera = Camera::open(&node(), &request).expect("a camera");
    camera.start(&AtomicBool::new(false)).expect("it starts");
    camera
}

fn error(request: CameraRequest) -> CameraError {
    Camera::open(&node(), &request)
        .and_then(|mut camera| camera.start(&AtomicBool::new(false)))
        .expect_err("should be refused")
}

fn small() -> CameraRequest {
    CameraRequest {
        size: Some(Size {
            width: 320,
            height: 180,
        }),
        ..CameraRequest::default()
    }
}

/// Captures `n` frames, or fewer if an error comes first.
fn capture(camera: &mut Camera, n: usize) -> (Vec<Frame>, Option<CameraError>) {
    let start = Instant::now();
    let (mut frames, mut frame) = (Vec::new(), Frame::empty());
    while frames.len() < n {
        assert!(start.elapsed() < PATIENCE, "{} frames of {n}", frames.len());
        match camera.next(&mut frame) {
            Ok(Next::Frame) => frames.push(frame.clone()),
            Ok(_) => {}
            Err(error) => return (frames, Some(error)),
        }
    }
    (frames, None)
}

fn frames(camera: &mut Camera, n: usize) -> Vec<Frame> {
    let (frames, error) = capture(camera, n);
    assert!(error.is_none(), "{error:?}");
    frames
}

fn set_control(setting: &str) {
    let status = Command::new("v4l2-ctl")
        .arg("-d")
        .arg(node())
        .args(["-c", setting])
        .status()
        .expect("v4l2-ctl runs");
    assert!(status.success(), "{setting}");
}

fn control(name: &str) -> String {
    let output = Command::new("v4l2-ctl")
        .arg("-d")
        .arg(node())
        .args(["-C", name])
        .output()
        .expect("v4l2-ctl runs");
    let text = String::from_utf8(output.stdout).expect("text");
    text.trim().to_owned()
}

fn picture(frame: &Frame) -> Picture {
    let mut picture = Picture::new(frame.size);
    decode(frame, &mut picture).expect("a whole frame");
    picture
}

/// Colours at the centres of vivid's eight colour bars, below its text.
fn bars(frame: &Frame) -> Vec<[i32; 3]> {
    let picture = picture(frame);
    let Size { width, height } = frame.size;
    (0..8)
        .map(|bar| (height - 2) * width + (2 * bar + 1) * width / 16)
        .map(|i| [picture.red[i], picture.green[i], picture.blue[i]].map(i32::from))
        .collect()
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_shows_the_same_colours_in_every_format() {
    let rgb = CameraRequest {
        format: Some(PixelFormat::Rgb),
        ..CameraRequest::default()
    };
    let expected = bars(&frames(&mut open(rgb), 1)[0]);
    // White, yellow, cyan, green, magenta, red, blue, black. These distinguish limited from full
    // range.
    assert!(expected[0].iter().all(|&c| c > 180), "{expected:?}");
    assert!(expected[7].iter().all(|&c| c < 20), "{expected:?}");
    for format in [
        PixelFormat::Yuyv,
        PixelFormat::Uyvy,
        PixelFormat::Nv12,
        PixelFormat::I420,
        PixelFormat::Grey,
    ] {
        for size in [Some(VGA), small().size] {
            let request = CameraRequest {
                format: Some(format),
                size,
                ..CameraRequest::default()
            };
            let mut camera = open(request);
            assert_eq!(
                (Some(camera.info().size), camera.info().format),
                (size, format)
            );
            assert!(camera.info().live);
            let frames = frames(&mut camera, 5);
            for (first, second) in frames.iter().zip(&frames[1..]) {
                assert!(first.stamp_ns < second.stamp_ns);
                assert!(first.sequence < second.sequence);
            }
            for frame in &frames {
                assert_eq!(Some(frame.bytes.len()), format.frame_bytes(frame.size));
            }
            let found = bars(&frames[4]);
            for (found, expected) in found.iter().zip(&expected) {
                let [red, green, blue] = *expected;
                let expected = match format {
                    // The driver computes grey by BT.709.
                    PixelFormat::Grey => [(2126 * red + 7152 * green + 722 * blue) / 10_000; 3],
                    _ => *expected,
                };
                let close = (0..3).all(|i| (found[i] - expected[i]).abs() <= 6);
                assert!(close, "{format:?} {size:?}: {found:?}, not {expected:?}");
            }
        }
    }
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_is_asked_for_sensible_things() {
    let camera = open(CameraRequest::default());
    assert_eq!(camera.info().size, VGA);
    assert_eq!(camera.info().format, PixelFormat::Yuyv);
    assert!(
        camera.info().name.contains("/dev/video"),
        "{:?}",
        camera.info()
    );
    // The driver's highest rate at this size is below the requested 30.
    assert_eq!(camera.info().rate_hz, Some(25.0));
    drop(camera);
    let slow = CameraRequest {
        rate_hz: Some(10.0),
        ..CameraRequest::default()
    };
    assert_eq!(open(slow).info().rate_hz, Some(10.0));
    let odd = CameraRequest {
        size: Some(Size {
            width: 333,
            height: 77,
        }),
        ..CameraRequest::default()
    };
    let refusal = error(odd);
    assert!(matches!(refusal, CameraError::Size { .. }), "{refusal}");
    assert!(refusal.to_string().contains("640x480"), "{refusal}");
    let jpeg = CameraRequest {
        format: Some(PixelFormat::Jpeg),
        ..CameraRequest::default()
    };
    let refusal = error(jpeg);
    assert!(matches!(refusal, CameraError::Format { .. }), "{refusal}");
    assert!(refusal.to_string().contains("YUYV"), "{refusal}");
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_is_busy_for_a_second_program() {
    let mut camera = open(CameraRequest::default());
    let refusal = error(CameraRequest::default());
    assert!(matches!(refusal, CameraError::Busy { .. }), "{refusal}");
    frames(&mut camera, 3);
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_is_listed() {
    let mut text = Vec::new();
    devices::list(&mut text).expect("written");
    let text = String::from_utf8(text).expect("text");
    println!("{text}");
    for part in [
        "vivid",
        "  YUYV\n",
        "    640x480: ",
        "not read by overcam: ",
        "  gain: 0 to 255, now ",
    ] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
}

/// While automatic, the gain of vivid is the seconds of its clock. It has no other control to lock.
#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_gain_is_locked_and_restored() {
    set_control("gain_automatic=1");
    let mut camera = start(small());
    let report = camera.info().controls.expect("it is started");
    let gain = report.strip_prefix("locked gain ").expect(&report);
    let (gain, missing) = gain.split_once("; ").expect(&report);
    assert_eq!(missing, "no control of exposure, white balance, focus");
    assert_eq!(control("gain_automatic"), "gain_automatic: 0");
    assert_eq!(control("gain"), format!("gain: {gain}"));
    // Discarded frames are not counted.
    assert_eq!(frames(&mut camera, 3)[0].sequence, 0);
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(control("gain"), format!("gain: {gain}"));
    drop(camera);
    assert_eq!(control("gain_automatic"), "gain_automatic: 1");

    let camera = open(small());
    let report = camera.info().controls.expect("it is started");
    assert!(report.starts_with("automatic gain; no control"), "{report}");
    assert_eq!(control("gain_automatic"), "gain_automatic: 1");
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_accepts_its_controls_and_refuses_missing_ones() {
    set_control("gain_automatic=1");
    let with = |controls| CameraRequest {
        controls,
        ..small()
    };
    let gain = |gain| ControlRequest {
        gain: Some(gain),
        ..ControlRequest::default()
    };
    let camera = start(with(gain(7)));
    let report = camera.info().controls.expect("it is started");
    assert!(report.starts_with("given gain 7; no control"), "{report}");
    assert_eq!(control("gain"), "gain: 7");
    drop(camera);
    assert_eq!(control("gain_automatic"), "gain_automatic: 1");

    let refusal = error(with(gain(256))).to_string();
    assert!(
        refusal.ends_with("--gain 256: the camera has 0 to 255 in steps of 1"),
        "{refusal}"
    );
    let focus = ControlRequest {
        focus: Some(1),
        ..ControlRequest::default()
    };
    let refusal = error(with(focus)).to_string();
    assert!(refusal.contains("has no focus"), "{refusal}");
    assert_eq!(control("gain_automatic"), "gain_automatic: 1");
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_dropped_buffers_are_counted_as_lost() {
    let mut camera = open(small());
    frames(&mut camera, 3);
    set_control("percentage_of_dropped_buffers=30");
    let frames = frames(&mut camera, 60);
    set_control("percentage_of_dropped_buffers=0");
    let Counters {
        lost_by_driver,
        faulty,
    } = camera.counters();
    assert!(lost_by_driver >= 5, "{lost_by_driver}");
    let captured = 3 + frames.len() as u64;
    assert_eq!(frames[59].sequence + 1, captured + lost_by_driver + faulty);
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_damaged_buffers_are_skipped_and_counted() {
    let mut camera = open(small());
    frames(&mut camera, 3);
    set_control("inject_v4l2_buf_flag_error=1");
    let last = frames(&mut camera, 20).pop().expect("20 frames");
    assert_eq!(camera.counters().faulty, 1);
    assert_eq!(last.sequence, 23 + camera.counters().lost_by_driver);
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_failing_calls_are_named() {
    for (control, call) in [
        ("inject_vidioc_reqbufs_error=1", "VIDIOC_REQBUFS"),
        ("inject_vidioc_qbuf_error=1", "VIDIOC_QBUF"),
        ("inject_vidioc_streamon_error=1", "VIDIOC_STREAMON"),
    ] {
        set_control(control);
        let error = error(CameraRequest::default());
        assert!(
            matches!(error, CameraError::Call { call: found, .. } if found == call),
            "{error}"
        );
    }
    frames(&mut open(CameraRequest::default()), 3);
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_counts_and_clocks_may_wrap_around() {
    set_control("wrap_sequence_number=1");
    let mut camera = open(small());
    // The count starts 128 before its wrap-around.
    let last = frames(&mut camera, 150).pop().expect("150 frames");
    set_control("wrap_sequence_number=0");
    let lost = camera.counters().lost_by_driver;
    assert!(lost < 1000, "{lost}");
    assert_eq!(last.sequence, 149 + lost);
    drop(camera);
    for wrap in ["wrap_timestamp=1", "wrap_timestamp=2"] {
        set_control(wrap);
        frames(&mut open(small()), 10);
    }
    set_control("wrap_timestamp=0");
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn vivid_can_be_unplugged_and_come_back() {
    for control in ["inject_fatal_streaming_error=1", "disconnect=1"] {
        let mut camera = open(CameraRequest::default());
        let first = frames(&mut camera, 5);
        let before = first.len() as u64;
        set_control(control);
        let start = Instant::now();
        let (rest, error) = capture(&mut camera, 1000);
        println!("{control}: {error:?} after {:?}", start.elapsed());
        match error {
            Some(CameraError::Lost {
                loss: Loss::Gone { n_frames, .. },
            }) => assert_eq!(n_frames, before + rest.len() as u64),
            other => panic!("{control}: {other:?}"),
        }
        assert!(camera.next(&mut Frame::empty()).is_err());
        camera.resume().expect("it is there again");
        let last = rest.last().unwrap_or(&first[4]).sequence;
        let lost = camera.counters().lost_by_driver;
        let again = frames(&mut camera, 3);
        let skipped = camera.counters().lost_by_driver - lost;
        assert_eq!(again[2].sequence, last + 3 + skipped);
        drop(camera);
        frames(&mut open(CameraRequest::default()), 3);
    }
}

/// Frames of the feeds; each is a grey level with a bright square.
const N_FEED: usize = 25;

fn feed_rgb(number: usize) -> Vec<u8> {
    let level = 40 + 4 * number as u8;
    (0..VGA.area())
        .flat_map(|i| {
            let (x, y) = (i % VGA.width, i / VGA.width);
            match (100..200).contains(&x) && (300..400).contains(&y) {
                true => [230, 40, 60],
                false => [level; 3],
            }
        })
        .collect()
}

fn feed_jpeg(number: usize) -> Vec<u8> {
    let mut jpeg = Vec::new();
    jpeg_encoder::Encoder::new(&mut jpeg, 90)
        .encode(
            &feed_rgb(number),
            VGA.width as u16,
            VGA.height as u16,
            jpeg_encoder::ColorType::Rgb,
        )
        .expect("encodes");
    jpeg
}

/// Removes the Huffman tables, as cameras do.
fn without_tables(jpeg: &[u8]) -> Vec<u8> {
    let mut stripped = jpeg[..2].to_vec();
    let mut at = 2;
    while jpeg[at + 1] != 0xda {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != 0xc4 {
            stripped.extend(&jpeg[at..end]);
        }
        at = end;
    }
    stripped.extend(&jpeg[at..]);
    stripped
}

fn feed_yuyv(number: usize) -> Vec<u8> {
    [100 + number as u8, 128].repeat(VGA.area())
}

/// Writes what the loopback camera will play.
#[test]
#[ignore = "part of tests/v4l2-vm/test"]
fn write_feeds() {
    let folder = env::var_os("OVERCAM_TEST_FEEDS").expect("OVERCAM_TEST_FEEDS names a folder");
    let write = |name: &str, frame: &dyn Fn(usize) -> Vec<u8>| {
        let frames: Vec<u8> = (0..N_FEED).flat_map(frame).collect();
        fs::write(Path::new(&folder).join(name), frames).expect("written");
    };
    write("yuyv.raw", &feed_yuyv);
    write("tables.mjpg", &feed_jpeg);
    write("bare.mjpg", &|number| without_tables(&feed_jpeg(number)));
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn loopback_raw_frames_are_those_of_the_feed() {
    let mut camera = start(CameraRequest::default());
    let report = camera.info().controls.expect("it is started");
    assert_eq!(report, "no control of exposure, gain, white balance, focus");
    let frames = frames(&mut camera, 30);
    // The first buffer has count 0, the next ones their index since the feed started, which was
    // seconds ago.
    assert!(frames[29].sequence < 100, "{}", frames[29].sequence);
    assert!(
        camera.counters().lost_by_driver < 70,
        "{:?}",
        camera.counters()
    );
    for frame in &frames {
        let number = usize::from(frame.bytes[0]) - 100;
        assert!(frame.bytes == feed_yuyv(number), "frame {number}");
        assert!(frame.stamp_ns > 0);
    }
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn loopback_jpeg_frames_are_those_of_the_feed() {
    let mut camera = open(CameraRequest::default());
    assert_eq!(camera.info().format, PixelFormat::Jpeg);
    assert_eq!(camera.info().size, VGA);
    for frame in frames(&mut camera, 10) {
        let picture = picture(&frame);
        let level = picture.green[20 * VGA.width + 20];
        let number = (f64::from(level) - 40.0) / 4.0;
        assert!((0.0..N_FEED as f64).contains(&number), "{level}");
        let square = 350 * VGA.width + 150;
        assert!(picture.red[square] > 210 && picture.green[square] < 70);
    }
}

#[test]
#[ignore = "needs a camera in a virtual machine: run tests/v4l2-vm/test"]
fn loopback_that_stalls_ends_with_an_error() {
    let mut camera = open(CameraRequest::default());
    let (frames, error) = capture(&mut camera, 1000);
    let error = error.expect("the feed ends");
    assert!(
        matches!(
            error,
            CameraError::Lost { loss: Loss::Stalled { seconds: 5, n_frames, .. } } if n_frames == frames.len() as u64
        ),
        "{error}"
    );
}
