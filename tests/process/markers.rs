//! `overcam markers`: the table, the sheets, and refusals.

use std::fs;

use crate::fixture::{STRAIGHT, folder, printed, run, write_calibration, write_markers};

#[test]
fn markers_are_checked_and_the_bad_ones_named() {
    let folder = folder();
    let good = folder.path().join("good");
    write_markers(&good, &["arrow", "cup"]);
    let lines = printed(folder.path(), &["markers", "check", "good"]);
    assert_eq!(lines.len(), 3, "{lines:?}");
    assert!(lines[0].starts_with("marker") && lines[1].starts_with("arrow"));
    assert!(
        lines[1].contains(" cup") && lines[1].ends_with(" px"),
        "{lines:?}"
    );

    write_calibration(&folder.path().join("floor.toml"), STRAIGHT);
    let arguments = ["markers", "check", "good", "--calibration", "floor.toml"];
    let lines = printed(folder.path(), &arguments);
    assert!(lines[1].ends_with(" cm"), "{lines:?}");

    let twin = fs::read(good.join("cup.svg")).expect("it was written");
    fs::write(good.join("mug.svg"), twin).expect("it can be written");
    let ended = run(folder.path(), &["markers", "check", "good"]);
    assert_eq!(ended.status, Some(1));
    assert!(ended.lines[2].contains("markers cup and mug: they are 0.0"));
    assert_eq!(
        ended.errors,
        ["overcam: markers: 2 of 3 cannot be used; change or remove those that the table names"]
    );
}

#[test]
fn sheets_are_written_page_by_page() {
    let folder = folder();
    let pages = printed(folder.path(), &["markers", "sheet", "-o", "all.svg"]);
    assert_eq!(pages, ["all.svg", "all-2.svg", "all-3.svg"]);
    for page in &pages {
        let svg = fs::read_to_string(folder.path().join(page)).expect("the page was written");
        assert!(svg.contains("width=\"210mm\" height=\"297mm\""));
    }
    let ended = run(
        folder.path(),
        &["markers", "sheet", "one", "-o", "no/where.svg"],
    );
    assert_eq!(ended.status, Some(1));
    assert!(
        ended.errors[0].contains("no/where.svg cannot be written"),
        "{:?}",
        ended.errors
    );
}

#[test]
fn a_marker_is_learned_from_a_view_of_it() {
    let folder = folder();
    // An arrowhead on a white plate on a grey floor, from above. Every pixel sees a disc of two
    // pixels.
    let picture = image::GrayImage::from_fn(160, 120, |x, y| {
        let level = |dx: i32, dy: i32| {
            let [x, y] = [4 * x as i32 + dx - 320, 4 * y as i32 + dy - 240];
            let head = (-120..96).contains(&y) && 2 * x.abs() < y + 120;
            let plate = x.abs() < 160 && y.abs() < 160;
            [100, 230, 30][usize::from(plate) + usize::from(head)]
        };
        let offsets = (-4..=4).flat_map(|dx| (-4..=4).map(move |dy| (dx, dy)));
        let disc: Vec<i32> = offsets
            .filter(|(dx, dy)| dx * dx + dy * dy <= 16)
            .map(|(dx, dy)| level(dx, dy))
            .collect();
        image::Luma([(disc.iter().sum::<i32>() / disc.len() as i32) as u8])
    });
    let view = folder.path().join("view");
    fs::create_dir(&view).expect("a new folder");
    picture.save(view.join("1.png")).expect("it can be written");

    let learn = ["markers", "learn", "--device", "view", "-o", "head.svg"];
    let lines = printed(folder.path(), &learn);
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(
        lines[1].starts_with("head ") && lines[1].ends_with(" px"),
        "{lines:?}"
    );
    let markers = folder.path().join("mine");
    fs::create_dir(&markers).expect("a new folder");
    fs::rename(folder.path().join("head.svg"), markers.join("head.svg")).expect("it was written");

    // First the floor without the plate, then with it: the marker is read, and points up.
    let floor = image::GrayImage::from_pixel(160, 120, image::Luma([100]));
    floor.save(view.join("0.png")).expect("it can be written");
    let run_it = [
        "--device",
        "view",
        "--markers",
        "mine",
        "--learn",
        "1",
        "--no-publish",
        "--json",
    ];
    let scenes = printed(folder.path(), &run_it);
    let scene = scenes.last().expect("a scene");
    assert!(scene.contains("\"marker\":\"head\""), "{scene}");
    let heading = scene.split("\"heading\":").nth(1).expect("a heading");
    let heading: f64 = heading
        .split([',', '}'])
        .next()
        .and_then(|number| number.parse().ok())
        .expect("a number");
    assert!(
        (heading + std::f64::consts::FRAC_PI_2).abs() < 0.01,
        "{scene}"
    );

    let ended = run(
        folder.path(),
        &[
            "markers",
            "learn",
            "--device",
            "view",
            "-o",
            "mine/head.svg",
        ],
    );
    assert_eq!(ended.status, Some(1));
    fs::remove_file(view.join("1.png")).expect("it is there");
    let ended = run(folder.path(), &learn);
    assert_eq!(ended.status, Some(1));
    let last = ended.errors.last().expect("an error");
    assert!(
        last.contains("no dark shape on a light, square plate"),
        "{last}"
    );
}

/// The sizes of the markers in the last of a few scenes.
fn sizes(folder: &std::path::Path, plate_mm: Option<f64>) -> Vec<f64> {
    let plate = plate_mm.map(|mm| mm.to_string());
    let mut arguments = vec!["--frames", "4", "--no-publish", "--json"];
    arguments.extend(["--calibration", "floor.toml"]);
    if let Some(plate) = &plate {
        arguments.extend(["--plate", plate]);
    }
    let scenes = printed(folder, &arguments);
    let objects = scenes.last().expect("a scene").split("\"track\":").skip(1);
    let marked = objects.filter(|object| object.contains("\"kind\":\"marker\""));
    let size = |object: &str| {
        let (_, size) = object.split_once("\"size\":")?;
        size.split(',').next()?.parse().ok()
    };
    marked.filter_map(size).collect()
}

#[test]
fn markers_of_the_wrong_size_are_ignored() {
    let folder = folder();
    write_calibration(&folder.path().join("floor.toml"), STRAIGHT);
    // The demo's plates are 0.24 to 0.48 m wide.
    let all = sizes(folder.path(), None);
    assert_eq!(all.len(), 6, "{all:?}");
    assert_eq!(sizes(folder.path(), Some(290.0)).len(), 4, "{all:?}");
    assert!(sizes(folder.path(), Some(150.0)).is_empty());

    // Plates too small to be read are reported at once.
    let arguments = ["--frames", "1", "--no-publish", "--calibration"];
    let millimetres: Vec<_> = STRAIGHT
        .iter()
        .map(|&(pixel, [x, y])| (pixel, [1000.0 * x, 1000.0 * y]))
        .collect();
    write_calibration(&folder.path().join("mm.toml"), &millimetres);
    for [file, plate, widths] in [
        ["mm.toml", "300", "0.03 to 0.03 pixels wide"],
        ["floor.toml", "9000", "900.00 to 900.00 pixels wide"],
    ] {
        let ended = run(
            folder.path(),
            &[&arguments[..], &[file, "--plate", plate]].concat(),
        );
        assert_eq!(ended.status, Some(1), "{:?}", ended.errors);
        assert!(
            ended.said(widths) && ended.said("floor points in metres"),
            "{:?}",
            ended.errors
        );
        assert_eq!(ended.errors.len(), 1);
    }
    // Without --plate the floor itself is questioned, and the run continues.
    let ended = run(folder.path(), &[&arguments[..], &["mm.toml"]].concat());
    assert_eq!(ended.status, Some(0), "{:?}", ended.errors);
    assert!(
        ended.said("a pixel is 10.00 m wide and the picture 6400 m"),
        "{:?}",
        ended.errors
    );
    let ended = run(folder.path(), &[&arguments[..], &["floor.toml"]].concat());
    assert!(!ended.said("m wide"), "{:?}", ended.errors);
}
