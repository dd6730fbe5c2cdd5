//! The contents of a file decide how it is opened, not its name.

use std::fs;
use std::io::Write;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use overcam::image::frame::Picture;
use overcam::image::picture_file::write_png;

use crate::fixture::{PLAIN, Running, folder, overcam, parse, printed, run, write_y4m, y4m};
use crate::refusals::assert_refused;

fn make_pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status();
    assert!(made.expect("mkfifo runs").success());
}

const LEARN: [&str; 3] = ["--learn", "15", "--json"];

#[test]
fn a_stream_is_read_under_any_name_and_from_any_pipe() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write_y4m(&path("run.y4m"), 20);
    let read = |device: &str| {
        printed(
            folder.path(),
            &[&PLAIN[..], &LEARN, &["--device", device]].concat(),
        )
    };
    let expected = read("run.y4m");
    assert_eq!(expected.len(), 5);
    for name in ["run", "run.mp4", "ceiling.cam:1.0-video-index0"] {
        symlink("run.y4m", path(name)).expect("it can be linked");
        assert_eq!(read(name), expected, "{name}");
    }

    make_pipe(&path("frames.pipe"));
    let arguments = [&PLAIN[..], &LEARN, &["--device", "frames.pipe"]].concat();
    let running = Running::start(&mut overcam(folder.path(), &arguments));
    let mut pipe = fs::OpenOptions::new()
        .write(true)
        .open(path("frames.pipe"))
        .expect("it can be opened");
    pipe.write_all(&y4m(20)).expect("it can be written");
    drop(pipe);
    assert_eq!(running.end().lines, expected);

    let substituted = format!(
        "exec {} {} --device <(cat run.y4m)",
        env!("CARGO_BIN_EXE_overcam"),
        [&PLAIN[..], &LEARN].concat().join(" ")
    );
    let mut shell = Command::new("bash");
    shell.args(["-c", &substituted]).current_dir(folder.path());
    assert_eq!(Running::start(&mut shell).end().lines, expected);
}

#[test]
fn a_recording_is_read_under_any_name_but_not_from_a_pipe() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write_y4m(&path("run.y4m"), 20);
    let record = [
        &PLAIN[..],
        &LEARN,
        &["--device", "run.y4m", "--record", "run.mcap"],
    ]
    .concat();
    let expected = printed(folder.path(), &record);
    fs::rename(path("run.mcap"), path("yesterday.bin")).expect("it can be renamed");
    let replay = ["--device", "yesterday.bin", "--json", "--no-publish"];
    assert_eq!(printed(folder.path(), &replay), expected);

    for command in [
        "cat yesterday.bin | OVERCAM --no-publish --device -",
        "OVERCAM --no-publish --device <(cat yesterday.bin)",
    ] {
        let command = command.replace("OVERCAM", env!("CARGO_BIN_EXE_overcam"));
        let mut shell = Command::new("bash");
        shell.args(["-c", &command]).current_dir(folder.path());
        let ended = Running::start(&mut shell).end();
        assert_eq!(ended.status, Some(1));
        assert!(
            ended.said("cannot be read from a pipe: write it to a file"),
            "{:?}",
            ended.errors
        );
    }
}

#[test]
fn a_run_waiting_for_a_pipe_without_writer_can_be_stopped() {
    let folder = folder();
    make_pipe(&folder.path().join("silent"));
    for command in [
        &["--device", "silent"][..],
        &["background", "--device", "silent", "-o", "floor.png"],
    ] {
        let running = Running::start(&mut overcam(folder.path(), command));
        // It is not visible from outside when it starts to wait.
        std::thread::sleep(Duration::from_millis(300));
        let asked = Instant::now();
        running.signal("INT");
        assert_eq!(running.end().status, Some(0));
        assert!(asked.elapsed() < Duration::from_secs(20));
    }
}

#[test]
fn what_is_no_source_is_refused_by_its_content() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| {
        fs::write(folder.path().join(name), content).expect("it can be written")
    };
    write("film.y4m", b"\0\0\0\x20ftypisom\0\0\0\0");
    write("film.mkv", b"\x1a\x45\xdf\xa3\x01\0\0\0");
    write("notes", b"once upon a time");
    write("nothing", b"");
    let size = imgproc::Size {
        width: 4,
        height: 4,
    };
    write("img1.mcap", &write_png(&Picture::new(size)));
    for (device, reason) in [
        (
            "film.y4m",
            "ffmpeg -v error -i film.y4m -f yuv4mpegpipe - | overcam --device -",
        ),
        ("film.mkv", "a Matroska or WebM video"),
        ("notes", "a text file, not a source of frames"),
        ("nothing", "an empty file"),
        ("img1.mcap", "a PNG picture, and a single one"),
        (
            "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:1:1.0-video-index0",
            "no such camera",
        ),
    ] {
        assert_refused(folder.path(), &["--device", device], &[reason]);
    }
    symlink("/dev/null", folder.path().join("usb-0:1:1.0-video-index0")).expect("it can be linked");
    assert_refused(
        folder.path(),
        &["--device", "usb-0:1:1.0-video-index0"],
        &["not a camera"],
    );
}

#[test]
fn interlaced_frames_are_reported_even_if_the_stream_does_not_declare_them() {
    let folder = folder();
    let interlaced = |is: bool| {
        let mut stream = b"YUV4MPEG2 W160 H120 F30:1 Ip Cmono\n".to_vec();
        for n in 0..40 {
            stream.extend(b"FRAME\n");
            for i in 0..160 * 120 {
                let (x, y) = (i % 160, i / 160);
                let left = 20 + 2 * n + usize::from(is && y % 2 == 1);
                let inside = (left..left + 20).contains(&x) && (40..70).contains(&y);
                stream.push(if inside {
                    230
                } else {
                    110 + (i * 7 + n) as u8 % 3
                });
            }
        }
        stream
    };
    for is in [true, false] {
        fs::write(folder.path().join("run.y4m"), interlaced(is)).expect("it can be written");
        let arguments = [&PLAIN[..], &LEARN, &["--device", "run.y4m"]].concat();
        let ended = run(folder.path(), &arguments);
        assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
        assert_eq!(
            ended.said("the frames are interlaced"),
            is,
            "{:?}",
            ended.errors
        );
        assert!(
            ended
                .lines
                .iter()
                .all(|line| parse(line)["sequence"].is_u64())
        );
    }
}
