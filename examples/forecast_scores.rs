//! Forecast errors of overcam and of baseline predictors on recorded tracks.
//!
//! ```text
//! cargo run --release --example forecast_scores -- [--json] FILES
//! ```
//!
//! A file is text with one sample per line: `time_s id x y [heading_rad]`, separated by blanks or
//! commas. `#` begins a comment. The samples of an id are in order of time and without gaps. A
//! forecast made at sample i (from 0) of an id for sample i + k is scored by its distance from that
//! sample, for every i >= 7 with i + k inside the track; ellipses are scored from sample 15 on. k
//! goes up to two seconds. `--json` prints one object per line.

use std::collections::BTreeMap;
use std::io::Write;
use std::process::ExitCode;
use std::time::Instant;

use forecast_lab::scores::{Board, Contestant, LINE5, OVERCAM, PREDICTORS, Sample, Scene};

/// Numbers of samples ahead that are scored, up to [`predict::FORECAST_RANGE_S`].
const STEPS: [usize; 13] = [1, 2, 3, 4, 5, 8, 10, 15, 20, 30, 45, 60, 120];

fn main() -> ExitCode {
    let (flags, files): (Vec<String>, Vec<String>) = std::env::args()
        .skip(1)
        .partition(|word| word.starts_with("--"));
    if let Some(flag) = flags.iter().find(|flag| *flag != "--json") {
        eprintln!("error: unknown flag {flag}: there is --json");
        return ExitCode::from(2);
    }
    if files.is_empty() {
        eprintln!("error: no files given; name text files of 'time_s id x y [heading_rad]'");
        return ExitCode::from(2);
    }
    for file in &files {
        let scored = std::fs::read_to_string(file)
            .map_err(|e| e.to_string())
            .and_then(|text| parsed(&text))
            .and_then(|tracks| score(file, &tracks, !flags.is_empty()).map_err(|e| e.to_string()));
        if let Err(error) = scored {
            eprintln!("error: {file}: {error}");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

/// The tracks of a file, by id.
fn parsed(text: &str) -> Result<Vec<Vec<Sample>>, String> {
    let mut tracks: BTreeMap<&str, Vec<Sample>> = BTreeMap::new();
    for (number, line) in (1..).zip(text.lines()) {
        let content = line.split('#').next().unwrap_or_default();
        let separators = |c: char| c == ',' || c.is_whitespace();
        let words: Vec<&str> = content
            .split(separators)
            .filter(|word| !word.is_empty())
            .collect();
        let (time, id, x, y, heading) = match words[..] {
            [] => continue,
            [time, id, x, y] => (time, id, x, y, None),
            [time, id, x, y, heading, ..] => (time, id, x, y, Some(heading)),
            _ => {
                return Err(format!(
                    "line {number} is not 'time_s id x y [heading_rad]'"
                ));
            }
        };
        let read = |word: &str| match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("line {number}: '{word}' is not a number")),
        };
        let sample = Sample {
            time_s: read(time)?,
            position: [read(x)?, read(y)?],
            heading_rad: heading.map(read).transpose()?,
        };
        let track = tracks.entry(id).or_default();
        if track
            .last()
            .is_some_and(|last| last.time_s >= sample.time_s)
        {
            return Err(format!(
                "line {number}: the samples of {id} are not in order of time"
            ));
        }
        track.push(sample);
    }
    if tracks.is_empty() {
        return Err("no samples".to_owned());
    }
    Ok(tracks.into_values().collect())
}

fn score(file: &str, tracks: &[Vec<Sample>], json: bool) -> std::io::Result<()> {
    let scene = Scene::of(tracks);
    let step_s = scene.scale.step_s;
    let near = |steps: &usize| *steps as f64 * step_s <= predict::FORECAST_RANGE_S * 1.01;
    let mut steps: Vec<usize> = STEPS.into_iter().filter(near).collect();
    if steps.is_empty() {
        steps.push(1);
    }
    let n_samples: usize = tracks.iter().map(Vec::len).sum();
    let which: Vec<usize> = (0..PREDICTORS.len()).collect();
    let mut board = Board::new(&steps);
    for track in tracks {
        let truth: Vec<[f64; 2]> = track.iter().map(|sample| sample.position).collect();
        board.add(track, &truth, &scene, &which);
    }
    let mut out = std::io::stdout().lock();
    for (k, steps) in steps.iter().enumerate() {
        let horizon_s = *steps as f64 * step_s;
        let line5 = board.tallies[LINE5][k].mean();
        if !json && !board.tallies[OVERCAM][k].errors.is_empty() {
            writeln!(out, "\n{file}: {steps} samples, {horizon_s:.3} s ahead")?;
        }
        for predictor in &which {
            let tally = &board.tallies[*predictor][k];
            if tally.errors.is_empty() {
                continue;
            }
            let name = PREDICTORS[*predictor];
            let (mean, median, n) = (tally.mean(), tally.median(), tally.errors.len());
            if json {
                let line = serde_json::json!({
                    "file": file,
                    "predictor": name,
                    "horizon_s": (horizon_s * 1e6).round() / 1e6,
                    "mean_error": mean,
                    "median_error": median,
                    "coverage95": tally.coverage(),
                    "n": n,
                });
                writeln!(out, "{line}")?;
            } else {
                let coverage = tally.coverage().map_or(String::new(), |part| {
                    format!("  {:5.1} % in the ellipse", 100.0 * part)
                });
                writeln!(
                    out,
                    "  {name:<10} mean {mean:10.5}  median {median:10.5}  {:6.3} of line5{coverage}",
                    mean / line5
                )?;
            }
        }
    }
    if !json {
        let begin = Instant::now();
        for track in tracks {
            let mut overcam = Contestant::new(OVERCAM, &scene, track);
            for sample in track {
                overcam.observe(sample);
            }
        }
        let us = begin.elapsed().as_secs_f64() * 1e6 / n_samples as f64;
        writeln!(
            out,
            "\n{n_samples} samples of {} tracks, {us:.1} us per track and frame",
            tracks.len()
        )?;
    }
    Ok(())
}
