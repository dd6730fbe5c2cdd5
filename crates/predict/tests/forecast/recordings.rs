//! Forecasts of real motions.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use predict::Settings;

use crate::motions::STEP_S;
use crate::quality::{HORIZONS, Row, score, table_head, table_row};

/// Real recordings: an erratic robot (px, 30/s), wheeled robots (m, 15/s) and pedestrians (m, 2.5/s).
#[test]
#[ignore = "needs recordings: RECORDINGS=DIR cargo test -p predict --test forecast recordings -- --ignored --nocapture"]
fn real_recordings() {
    let folder = std::env::var("RECORDINGS").expect("RECORDINGS names the folder");
    let folder = Path::new(&folder);
    table_head("real recordings");

    let settings = Settings {
        forecast_step_s: 1.0 / 30.0,
        top_speed: 900.0,
        ..Settings::default()
    };
    let mut rows = [Row::default(); HORIZONS.len()];
    for number in 1..=10 {
        let text = read(&folder.join(format!("hexbug/test{number:02}.txt")));
        let path: Vec<[f64; 2]> = numbers(&text, ',').map(|n| [n[0], n[1]]).collect();
        score(&path, &path, 1.0, &settings, &mut rows);
    }
    table_row("hexbug", &rows);
    assert!(rows.iter().all(|row| row.error <= 1.05 * row.line_error));

    let settings = Settings {
        forecast_step_s: STEP_S,
        top_speed: 1.0,
        gate_base: 0.05,
        ..Settings::default()
    };
    let mut rows = [Row::default(); HORIZONS.len()];
    for robot in 1..=3 {
        let text = read_gzip(&folder.join(format!("mrclam/Robot{robot}_Groundtruth.dat.gz")));
        let path = resampled(&numbers(&text, ' ').collect::<Vec<_>>());
        score(&path, &path, 1e-6, &settings, &mut rows);
    }
    table_row("mrclam", &rows);
    assert!(rows.iter().all(|row| row.error <= 1.05 * row.line_error));

    let settings = Settings {
        forecast_step_s: 0.4,
        top_speed: 4.0,
        gate_base: 0.3,
        ..Settings::default()
    };
    let mut pedestrians: BTreeMap<u32, Vec<[f64; 2]>> = BTreeMap::new();
    for row in numbers(&read(&folder.join("eth/obsmat.txt")), ' ') {
        pedestrians
            .entry(row[1] as u32)
            .or_default()
            .push([row[2], row[4]]);
    }
    let mut rows = [Row::default(); HORIZONS.len()];
    for path in pedestrians.values() {
        score(path, path, 1e-3, &settings, &mut rows);
    }
    table_row("eth", &rows);
    assert!(rows.iter().all(|row| row.error <= 1.05 * row.line_error));
}

/// The rows of numbers in a text, comments left out.
fn numbers(text: &str, separator: char) -> impl Iterator<Item = Vec<f64>> + '_ {
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .map(move |line| {
            line.split(|c: char| c == separator || c.is_whitespace())
                .filter(|field| !field.is_empty())
                .map(|field| field.parse().expect("a number"))
                .collect()
        })
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).expect("a text file")
}

fn read_gzip(path: &Path) -> String {
    let output = Command::new("gzip").arg("-dc").arg(path).output();
    String::from_utf8(output.expect("gzip runs").stdout).expect("a text file")
}

/// Rows of (time s, x, y, ..), interpolated to one place a step.
fn resampled(rows: &[Vec<f64>]) -> Vec<[f64; 2]> {
    let mut path = Vec::new();
    let mut next_s = rows[0][0];
    for pair in rows.windows(2) {
        let (from, to) = (&pair[0], &pair[1]);
        while next_s < to[0] {
            let part = (next_s - from[0]) / (to[0] - from[0]);
            path.push([1, 2].map(|axis| from[axis] + part * (to[axis] - from[axis])));
            next_s += STEP_S;
        }
    }
    path
}
