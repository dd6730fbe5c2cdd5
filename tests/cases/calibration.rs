//! Misleading measurements: the wrong point is named, and doubtful values are reported.

use std::fs;

use crate::cases;
use crate::svg::overcam;

/// `bad4_named5.toml` has the number of the bad point in its name.
fn bad_point(name: &str) -> Option<u32> {
    let digits = name.strip_prefix("bad")?;
    digits[..digits.find('_')?].parse().ok()
}

#[test]
#[ignore = "needs cases: CASES=DIR cargo test --test cases -- --ignored"]
fn misleading_points_are_named() {
    let mut wrong = Vec::new();
    for case in cases(&["calibration-"]) {
        let mut files: Vec<String> = fs::read_dir(&case.folder)
            .expect("the case can be read")
            .map(|entry| {
                entry
                    .expect("a file")
                    .file_name()
                    .to_string_lossy()
                    .into_owned()
            })
            .filter(|name| name.ends_with(".toml"))
            .collect();
        files.sort();
        for file in files {
            let mut arguments = vec!["--frames", "1", "--no-publish", "--calibration", &file];
            if case.name == "calibration-millimetres" {
                arguments.extend(["--plate", "320"]);
            }
            let (status, said) = overcam(&case.folder, &arguments);
            let is_right = match (file.as_str(), bad_point(&file)) {
                (_, Some(point)) => {
                    status == Some(1) && said.contains(&format!("point {point} is off by"))
                }
                ("mm.toml", _) => status == Some(1) && said.contains("floor points in metres"),
                ("near.toml", _) => said.contains("nearly on a line") && said.contains(" m "),
                _ => status == Some(0),
            };
            if !is_right {
                wrong.push(format!("{}/{file}: {status:?} {said}", case.name));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
