//! `overcam markers`: the table, the sheets, and what is refused.

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
    let ended = run(
        folder.path(),
        &["markers", "sheet", "-o", "a.svg", "--plate", "5"],
    );
    assert_eq!(ended.status, Some(2));
}
