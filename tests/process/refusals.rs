//! Mistakes and damaged files: the exit status, and one line that names the problem.

use std::fs;
use std::path::Path;

use imgproc::Size;
use jpeg_encoder::{ColorType, Encoder};
use overcam::image::frame::Picture;
use overcam::image::picture_file::write_png;

use crate::fixture::{
    Ended, PLAIN, Pairs, STRAIGHT, folder, printed, run, sequence_of, write_calibration,
    write_markers, y4m,
};

/// A run that does not start: status 1, no output, and one line that contains all of `parts`.
pub(crate) fn assert_refused(folder: &Path, arguments: &[&str], parts: &[&str]) {
    let ended = run(folder, arguments);
    assert_eq!(ended.status, Some(1), "{arguments:?}: {:?}", ended.errors);
    assert!(ended.lines.is_empty());
    let [line] = ended.errors.as_slice() else {
        panic!("{arguments:?}: not one line: {:?}", ended.errors);
    };
    assert_error_line(line, parts);
}

fn assert_error_line(line: &str, parts: &[&str]) {
    assert!(line.starts_with("overcam: "), "{line}");
    for part in parts {
        // Only once: a cause is not repeated.
        assert_eq!(line.matches(part).count(), 1, "{part:?} in {line:?}");
    }
}

fn write(path: &Path, content: impl AsRef<[u8]>) {
    fs::write(path, content).expect("the file can be written");
}

#[test]
fn sources_that_are_none_are_refused() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("empty")).expect("the folder can be made");
    write(&path("notes.txt"), "once upon a time");
    write(&path("empty.mcap"), "");
    write(&path("text.mcap"), "hi\n");
    write(&path("magic.mcap"), mcap::MAGIC);
    write(&path("empty.y4m"), "");
    write(&path("text.y4m"), "once upon a time\n");
    write(&path("no-rate.y4m"), "YUV4MPEG2 W4 H4\n");
    fs::create_dir(path("broken")).expect("the folder can be made");
    write(&path("broken/1.png"), "once upon a time");
    for (device, reason) in [
        ("nowhere", "there is no such camera, file or folder"),
        ("nowhere.mcap", "there is no such camera, file or folder"),
        ("/dev/nonexistent", "no such camera"),
        ("/dev/null", "not a camera"),
        ("empty", "no pictures in this folder"),
        ("notes.txt", "not a source of frames"),
        ("empty.mcap", "nothing was recorded"),
        ("text.mcap", "is not an MCAP file"),
        ("magic.mcap", "ends in the middle before its first frame"),
        ("empty.y4m", "wrote none"),
        ("text.y4m", "not a Y4M stream"),
        ("no-rate.y4m", "no frame rate"),
        ("broken", "neither a PNG nor a JPEG file"),
    ] {
        assert_refused(folder.path(), &["--device", device], &[reason]);
        let ended = run(folder.path(), &["--device", device]);
        assert!(ended.said(device), "{:?}", ended.errors);
    }
    let empty = "standard input: empty";
    assert_refused(folder.path(), &["--device", "-"], &[empty]);
}

#[test]
fn markers_that_cannot_be_used_are_refused() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let drawing = |figure: &str| {
        format!(r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100">{figure}</svg>"#)
    };
    let folder_with = |name: &str, file: &str, content: &str| {
        fs::create_dir(path(name)).expect("the folder can be made");
        write(&path(name).join(file), content);
    };
    let square = drawing(r#"<path d="M25 25H75V75H25Z"/>"#);
    folder_with("square", "square.svg", &square);
    folder_with("cut", "cut.svg", &square[..60]);
    folder_with("blank", "blank.svg", &drawing(""));
    folder_with("bell", "a\u{7}b.svg", &square);
    folder_with("zipped", "m.svgz", &square);
    let text = r#"<path d="M50 12L84 86H16Z"/><text id="label" y="9">R1</text>"#;
    folder_with("text", "text.svg", &drawing(text));
    let covered = r##"<path d="M50 12L84 86H16Z"/><circle cx="50" cy="60" r="9" fill="#fff"/>"##;
    folder_with("covered", "covered.svg", &drawing(covered));
    folder_with("same", "a.svg", &square);
    write(&path("same").join("A.svg"), &square);
    folder_with("hidden", "._arrow.svg", "resource fork");
    folder_with("long", &format!("{}.svg", "n".repeat(40)), &square);
    folder_with("other", "readme.txt", "no drawing");
    write_markers(&path("twins"), &["arrow", "cup"]);
    let arrow = path("twins/arrow.svg");
    fs::copy(arrow, path("twins/pfeil.svg")).expect("the drawing can be copied");
    write(&path("file.svg"), &square);
    for (markers, parts) in [
        ("nowhere", ["markers nowhere", "No such file"]),
        ("other", ["markers other", "no .svg file"]),
        ("file.svg", ["markers file.svg", "give a folder"]),
        ("square", ["marker square", "to tell its heading"]),
        ("cut", ["marker cut", "not a readable SVG"]),
        ("blank", ["marker blank", "no dark shape"]),
        ("long", ["has 40 bytes", "rename the file"]),
        ("bell", ["marker a\\u{7}b", "cannot be seen"]),
        ("zipped", ["m.svgz", "unpack it into a .svg file"]),
        ("text", ["text, id \"label\"", "convert text to a path"]),
        ("covered", ["marker covered", "2 outlines"]),
        ("same", ["\"A.svg\" and \"a.svg\"", "rename one"]),
        ("hidden", ["markers hidden", "no .svg file"]),
        ("twins", ["markers arrow and pfeil", "take one away"]),
    ] {
        assert_refused(folder.path(), &["--markers", markers], &parts);
    }
}

#[test]
fn calibrations_that_cannot_be_used_are_refused() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write(&path("syntax.toml"), "[[points]]\npixel = [1, 2\n");
    write(&path("empty.toml"), "");
    let with = |name: &str, pairs: Pairs| write_calibration(&path(name), pairs);
    with("three.toml", &STRAIGHT[..3]);
    let on_a_line = [0.0, 100.0, 200.0, 300.0].map(|c| ([c, c], [c / 100.0, c / 100.0]));
    with("line.toml", &on_a_line);
    let mirrored: Vec<_> = STRAIGHT
        .iter()
        .map(|&(pixel, [x, y])| (pixel, [-x, y]))
        .collect();
    with("mirrored.toml", &mirrored);
    let mut wrong = STRAIGHT.to_vec();
    wrong.extend([([320.0, 240.0], [4.2, 2.4]), ([320.0, 120.0], [3.2, 3.6])]);
    with("wrong.toml", &wrong);
    let near = [[20.0, 20.0], [160.0, 118.0], [300.0, 220.0], [25.0, 215.0]];
    let near: Vec<_> = near
        .iter()
        .map(|&[x, y]| ([x, y], [x / 100.0, -y / 100.0]))
        .collect();
    with("near.toml", &near);
    for (file, reason) in [
        ("nowhere.toml", "No such file"),
        ("syntax.toml", "line 2"),
        ("empty.toml", "missing field `points`"),
        ("three.toml", "3 points are given, at least 4 are needed"),
        ("line.toml", "no three of four points may lie on one line"),
        ("mirrored.toml", "axes are mirrored"),
        ("wrong.toml", "point 5 is off by"),
        ("near.toml", "lie nearly on a line"),
    ] {
        assert_refused(folder.path(), &["--calibration", file], &[file, reason]);
    }
}

#[test]
fn pictures_of_the_floor_that_cannot_be_used_are_refused() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let png = write_png(&picture(0));
    write(&path("small.png"), &png);
    write(&path("cut.png"), &png[..png.len() / 2]);
    let jpeg = jpeg(0);
    write(&path("cut.jpg"), &jpeg[..jpeg.len() / 2]);
    write(&path("notes.txt"), "once upon a time");
    for (file, reason) in [
        ("nowhere.png", "No such file"),
        ("notes.txt", "neither a PNG nor a JPEG file"),
        ("small.png", "it is 48 x 32, but the frames are 640 x 480"),
        ("cut.png", "damaged PNG file"),
        ("cut.jpg", "JPEG picture cut off"),
    ] {
        let arguments = [&PLAIN[..], &["--background", file]].concat();
        assert_refused(folder.path(), &arguments, &[file, reason]);
    }
}

#[test]
fn places_where_nothing_can_be_recorded_are_refused() {
    let folder = folder();
    write(&folder.path().join("old.mcap"), "precious");
    let full = folder.path().join("full.mcap");
    std::os::unix::fs::symlink("/dev/full", full).expect("a link can be made");
    for (file, reason) in [
        ("nowhere/run.mcap", "there is no such folder"),
        ("old.mcap", "exists already"),
        ("old.mcap/run.mcap", "cannot be created"),
        ("full.mcap", "exists already"),
    ] {
        let arguments = [&PLAIN[..], &["--record", file]].concat();
        assert_refused(folder.path(), &arguments, &[file, reason]);
    }
    let old = fs::read(folder.path().join("old.mcap")).expect("it is there");
    assert_eq!(old, b"precious");
}

#[test]
fn wrong_arguments_have_a_status_of_their_own() {
    let folder = folder();
    let arguments: [&[&str]; 10] = [
        &["--bogus"],
        &["wacth"],
        &["--frames", "many"],
        &["--size", "640"],
        &["--format", "h264"],
        &["--learn", "0"],
        &["--learn", "3", "--background", "empty.png"],
        &["--record-jpeg", "90"],
        &["recover", "run.mcap"],
        &["--json", "watch"],
    ];
    for arguments in arguments {
        let ended = run(folder.path(), arguments);
        assert_eq!(ended.status, Some(2), "{arguments:?}: {:?}", ended.errors);
        assert!(ended.errors[0].starts_with("error: "), "{:?}", ended.errors);
        assert!(ended.said("--help") && ended.lines.is_empty());
    }
}

#[test]
fn arguments_that_do_not_apply_to_the_source_are_refused() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("pictures")).expect("the folder can be made");
    write(&path("run.y4m"), y4m(1));
    write(&path("run.mcap"), "");
    for (device, flag, value, kind) in [
        ("demo", "--rate", "10", "the demo"),
        ("demo", "--format", "grey", "the demo"),
        ("demo", "--gain", "-3", "the demo"),
        ("-", "--size", "320x240", "Y4M on standard input"),
        ("run.y4m", "--rate", "10", "a Y4M file"),
        ("run.mcap", "--white-balance", "4600", "a recording"),
        ("pictures", "--focus", "3", "a folder of pictures"),
        ("pictures", "--exposure", "10000", "a folder of pictures"),
    ] {
        let ended = run(folder.path(), &["--device", device, flag, value]);
        assert_eq!(ended.status, Some(2), "{device} {flag}: {:?}", ended.errors);
        let line = format!("overcam: {device}: {flag} does not apply to {kind}: leave it out");
        assert_eq!(ended.errors, [line]);
    }
    let ended = run(folder.path(), &["--device", "run.y4m", "--camera-auto"]);
    assert_eq!(ended.status, Some(2), "{:?}", ended.errors);
}

#[test]
fn what_cannot_be_recovered_is_refused() {
    let folder = folder();
    write(&folder.path().join("text.mcap"), "hi\n");
    for (file, reason) in [
        ("nowhere.mcap", "No such file"),
        ("text.mcap", "is not an MCAP file"),
    ] {
        let arguments = ["recover", file, "-o", "new.mcap"];
        assert_refused(folder.path(), &arguments, &[file, reason]);
        assert!(!folder.path().join("new.mcap").exists());
    }
}

/// A source that ends with damage: everything before it is processed, then one line names it.
fn assert_breaks_off(ended: &Ended, n_lines: usize, parts: &[&str]) {
    assert_eq!(ended.status, Some(1), "{:?}", ended.errors);
    assert_eq!(ended.lines.len(), n_lines, "{:?}", ended.errors);
    let (last, before) = ended.errors.split_last().expect("there is an error");
    assert_error_line(last, parts);
    // All other lines are those of every run: the source, the markers, how the floor is learned,
    // and the summary.
    for line in before {
        let usual = [
            ", 160 x 120, ",
            ", 48 x 32, ",
            "looking for",
            "learning",
            "frames: ",
        ];
        assert!(usual.iter().any(|text| line.contains(text)), "{line}");
    }
}

#[test]
fn a_truncated_stream_is_processed_up_to_the_cut() {
    let folder = folder();
    let mut stream = y4m(21);
    stream.truncate(stream.len() - 100);
    write(&folder.path().join("cut.y4m"), stream);
    let arguments = [
        &PLAIN[..],
        &["--device", "cut.y4m", "--learn", "15", "--json"],
    ]
    .concat();
    let ended = run(folder.path(), &arguments);
    assert_breaks_off(&ended, 5, &["cut.y4m: cut off: frame 20 has"]);
}

#[test]
fn a_truncated_recording_is_processed_up_to_the_cut() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    write(&path("run.y4m"), y4m(60));
    let learn = ["--device", "run.y4m", "--learn", "15"];
    let record = [&PLAIN[..], &learn, &["--json", "--record", "run.mcap"]].concat();
    let lines = printed(folder.path(), &record);
    let mut recording = fs::read(path("run.mcap")).expect("it is there");
    recording.truncate(recording.len() / 2);
    write(&path("cut.mcap"), recording);
    let ended = run(
        folder.path(),
        &["--device", "cut.mcap", "--json", "--no-publish"],
    );
    let n_lines = (ended.lines.len(), lines.len());
    assert!(n_lines.0 > 0 && n_lines.0 < n_lines.1, "{n_lines:?}");
    assert!(lines.starts_with(&ended.lines));
    let parts = [
        "ends in the middle after frame",
        "`overcam recover cut.mcap -o NEW`",
    ];
    assert_breaks_off(&ended, ended.lines.len(), &parts);
}

#[test]
fn a_damaged_picture_in_a_folder_is_skipped() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let pngs: Vec<Vec<u8>> = (0..4).map(|n| write_png(&picture(n))).collect();
    let jpegs: Vec<Vec<u8>> = (0..4).map(jpeg).collect();
    for (kind, mut files) in [("png", pngs), ("jpg", jpegs)] {
        fs::create_dir(path(kind)).expect("the folder can be made");
        let length = files[2].len();
        files[2].truncate(length / 2);
        for (n, file) in files.iter().enumerate() {
            write(&path(kind).join(format!("{n}.{kind}")), file);
        }
        let arguments = [&PLAIN[..], &["--device", kind, "--learn", "1", "--json"]].concat();
        let ended = run(folder.path(), &arguments);
        assert_passed_over(&ended, &format!("{kind}/2.{kind}: "));
    }

    // An intact JPEG file of an unsupported kind, arithmetic coding, which only decoding shows.
    let mut arithmetic = jpeg(2);
    let frame_header = arithmetic.windows(2).position(|two| two == [0xff, 0xc0]);
    arithmetic[frame_header.expect("there is a frame header") + 1] = 0xc9;
    write(&path("jpg/2.jpg"), arithmetic);
    let arguments = [&PLAIN[..], &["--device", "jpg", "--learn", "1", "--json"]].concat();
    let ended = run(folder.path(), &arguments);
    assert_passed_over(&ended, "frame 2 is passed over: ");
}

/// Of four pictures, the first of which is used for learning, the third gave no result, and this
/// was reported.
fn assert_passed_over(ended: &Ended, reason: &str) {
    assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
    let sequences: Vec<u64> = ended.lines.iter().map(|line| sequence_of(line)).collect();
    assert_eq!(sequences, [1, 3], "{:?}", ended.errors);
    assert!(
        ended.said(reason) && ended.said(", 1 faulty"),
        "{:?}",
        ended.errors
    );
}

const SMALL: Size = Size {
    width: 48,
    height: 32,
};

/// A picture full of edges, slightly different for each number.
fn picture(n: u8) -> Picture {
    let plane: Vec<u8> = (0..SMALL.area())
        .map(|i| (i * i % 251) as u8 / 4 + 100 + n)
        .collect();
    Picture {
        size: SMALL,
        red: plane.clone(),
        green: plane.clone(),
        blue: plane,
    }
}

fn jpeg(n: u8) -> Vec<u8> {
    let mut file = Vec::new();
    Encoder::new(&mut file, 90)
        .encode(&picture(n).red, 48, 32, ColorType::Luma)
        .expect("it can be encoded");
    file
}
