//! Pictures, streams and recordings.

use serde_json::Value;

use crate::{Case, Ended, cases, observed};

const FRAMES: [&str; 5] = [
    "--device",
    "frames",
    "--background",
    "background.png",
    "--json",
];

fn sequences(ended: &Ended) -> Vec<u64> {
    ended
        .scenes
        .iter()
        .map(|scene| scene["sequence"].as_u64().expect("a number"))
        .collect()
}

fn is_marker(object: &&Value) -> bool {
    object["kind"] == "marker"
}

/// All frames give results, each with the same number of objects.
fn all_are_read(case: &Case) {
    let ended = case.succeed(&FRAMES);
    assert_eq!(
        sequences(&ended),
        [0, 1, 2, 3, 4, 5],
        "{}: {}",
        case.name,
        ended.said
    );
    assert!(
        !ended.said.contains("faulty"),
        "{}: {}",
        case.name,
        ended.said
    );
    let counts: Vec<usize> = ended
        .scenes
        .iter()
        .map(|scene| observed(scene).len())
        .collect();
    assert!(
        counts[0] > 0 && counts.iter().all(|&n| n == counts[0]),
        "{}: {counts:?}",
        case.name
    );
}

/// The fourth frame gives none, and only that one is counted.
fn the_cut_one_is_passed_over(case: &Case) {
    let ended = case.succeed(&FRAMES);
    assert_eq!(sequences(&ended), [0, 1, 2, 4, 5], "{}", ended.said);
    assert!(ended.said.contains(", 1 faulty"), "{}", ended.said);
    let counts: Vec<usize> = ended
        .scenes
        .iter()
        .map(|scene| observed(scene).len())
        .collect();
    assert!(counts.iter().all(|&n| n == counts[0]), "{counts:?}");
}

fn stamps_ascend(case: &Case, ended: &Ended) {
    let stamps = ended
        .scenes
        .iter()
        .map(|scene| scene["stamp_ns"].as_u64().expect("a number"));
    let stamps: Vec<u64> = stamps.collect();
    assert!(
        stamps.len() > 5 && stamps.is_sorted_by(|a, b| a < b),
        "{}: {stamps:?}",
        case.name
    );
}

fn recording(case: &Case) -> Ended {
    case.succeed(&[
        "--device",
        "x.mcap",
        "--background",
        "background.png",
        "--json",
    ])
}

fn velocities_are_true(case: &Case) {
    let ended = recording(case);
    stamps_ascend(case, &ended);
    let last = ended.scenes.last().expect("there are scenes");
    let speeds: Vec<f64> = observed(last)
        .into_iter()
        .filter(is_marker)
        .map(|object| {
            let [vx, vy] = ["vx", "vy"].map(|key| object[key].as_f64().expect("a number"));
            vx.hypot(vy)
        })
        .collect();
    assert!(!speeds.is_empty(), "no marker is seen: {last}");
    assert!(
        speeds.iter().all(|speed| (speed - 90.0).abs() < 3.0),
        "{speeds:?}"
    );
}

fn every_spelling_is_read(case: &Case) {
    for file in ["x1.mcap", "x2.mcap", "x3.mcap"] {
        let ended = case.succeed(&["--device", file, "--learn", "1", "--json"]);
        assert!(!ended.scenes.is_empty(), "{file}: {}", ended.said);
    }
}

fn recordings_are_right(case: &Case) {
    for file in ["LZ4.mcap", "NONE.mcap", "ZSTD.mcap", "nochunk.mcap"] {
        let ended = case.succeed(&["--device", file, "--learn", "1", "--json"]);
        assert!(!ended.scenes.is_empty(), "{file}: {}", ended.said);
    }
    let ended = case.run(&["--device", "two.mcap", "--learn", "1"]);
    assert_eq!(ended.status, Some(1));
    assert!(
        ended.said.contains("several image topics (/"),
        "{}",
        ended.said
    );
    let folder = tempfile::tempdir().expect("a folder can be made");
    let whole = folder.path().join("whole.mcap");
    let whole = whole.to_str().expect("a name in UTF-8");
    let recovered = crate::run_in(&case.folder, &["recover", "cut.mcap", "-o", whole]);
    assert_eq!(recovered.status, Some(0), "{}", recovered.said);
    let ended = case.succeed(&["--device", whole, "--learn", "1", "--json"]);
    assert!(!ended.scenes.is_empty(), "{}", ended.said);
}

fn wide_pixels_lose_no_marker_in_silence(case: &Case) {
    let ended = case.run(&[
        "--device",
        "x.y4m",
        "--background",
        "background.png",
        "--json",
    ]);
    if ended.status == Some(0) {
        assert!(
            ended
                .scenes
                .iter()
                .any(|scene| observed(scene).iter().any(is_marker))
        );
    } else {
        assert!(ended.said.contains("setsar=1"), "{}", ended.said);
    }
}

fn transparent_is_not_looked_at(case: &Case) {
    let ended = case.succeed(&[
        "--size",
        "320x240",
        "--region",
        "region.png",
        "--frames",
        "5",
    ]);
    assert!(
        ended.said.contains("looking at 59 % of the picture"),
        "{}",
        ended.said
    );
}

fn one_robot_and_one_obstacle(case: &Case) {
    let ended = case.succeed(&FRAMES);
    assert!(!ended.scenes.is_empty());
    for scene in &ended.scenes {
        let objects = observed(scene);
        let n_markers = objects.iter().filter(|object| is_marker(object)).count();
        assert_eq!((n_markers, objects.len()), (1, 2), "{scene}");
    }
}

#[test]
#[ignore = "needs cases: CASES=DIR cargo test --test cases -- --ignored"]
fn pictures_are_what_their_readmes_say() {
    let mut n_checked = 0;
    for case in cases(&[
        "jpeg-",
        "png-",
        "mcap-",
        "y4m-",
        "region-",
        "background-",
        "folder-",
        "v4l2-",
        "duplicate-",
    ]) {
        match case.name.as_str() {
            "jpeg-cut-with-eoi" => the_cut_one_is_passed_over(&case),
            "jpeg-extraneous-bytes" | "jpeg-no-eoi" => all_are_read(&case),
            "mcap-format-names" => every_spelling_is_read(&case),
            "mcap-out-of-order" => stamps_ascend(&case, &recording(&case)),
            "mcap-receive-jitter" => velocities_are_true(&case),
            "mcap-right" => recordings_are_right(&case),
            "y4m-wide-pixels" => wide_pixels_lose_no_marker_in_silence(&case),
            "region-alpha" => transparent_is_not_looked_at(&case),
            "duplicate-marker" => one_robot_and_one_obstacle(&case),
            // It has no frames, only a program that needs others to generate them.
            "v4l2-interlaced" if !case.has("x.y4m") => continue,
            _ => {
                case.run_as_documented();
                continue;
            }
        }
        n_checked += 1;
    }
    assert!(n_checked > 0, "no case of these kinds is in CASES");
    eprintln!("{n_checked} cases are right");
}
