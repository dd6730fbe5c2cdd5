//! How good the forecasts are against the line through the last five positions, and how honest their ellipses.

use crate::motions::{Motion, Noise, STEP_S};
use predict::{MAX_FORECAST, Observation, Settings, Tracker};

/// Steps ahead in the table.
pub(crate) const HORIZONS: [usize; 3] = [1, 5, MAX_FORECAST];
const RUNS: u64 = 24;
const FRAMES: usize = 200;

#[derive(Default, Clone, Copy)]
pub(crate) struct Row {
    n: f64,
    pub(crate) error: f64,
    pub(crate) line_error: f64,
    inside: f64,
}

/// Forecasts of one measured path against the true one, added to a row for each horizon.
pub(crate) fn score(
    truth: &[[f64; 2]],
    measured: &[[f64; 2]],
    variance: f64,
    settings: &Settings,
    rows: &mut [Row],
) {
    let mut tracker = Box::new(Tracker::new());
    for frame in 0..measured.len() {
        let [x, y] = measured[frame];
        let observation = Observation {
            x,
            y,
            covariance: [[variance, 0.0], [0.0, variance]],
            heading: None,
            marker: None,
            reach: 0.0,
            area: 0.0,
        };
        let stamp_ns = (frame as f64 * settings.forecast_step_s * 1e9) as u64;
        tracker.update(stamp_ns, &[observation], settings);
        let track = tracker.tracks().next().expect("one track");
        assert_eq!(track.id(), 1, "the track was lost");
        if frame < 3 {
            continue;
        }
        for (row, steps) in rows.iter_mut().zip(HORIZONS) {
            let then = frame + steps;
            if then >= measured.len() {
                continue;
            }
            let point = track.forecast()[steps - 1];
            row.n += 1.0;
            row.error += distance([point.x, point.y], truth[then]);
            row.line_error += distance(line_over_5(&measured[..=frame], steps), truth[then]);
            let dx = measured[then][0] - point.x;
            let dy = measured[then][1] - point.y;
            let [[a, b], [_, d]] = point.covariance;
            let mahalanobis = (d * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / (a * d - b * b);
            // 95 % quantile of chi-squared with two degrees of freedom.
            row.inside += f64::from(mahalanobis <= 5.991);
        }
    }
}

/// Least-squares line through the last five places, `steps` ahead: written anew, even steps only.
fn line_over_5(places: &[[f64; 2]], steps: usize) -> [f64; 2] {
    let last = &places[places.len().saturating_sub(5)..];
    let n = last.len() as f64;
    let middle = (n - 1.0) / 2.0;
    [0, 1].map(|axis| {
        let mean = last.iter().map(|p| p[axis]).sum::<f64>() / n;
        let offsets = || (0..last.len()).map(|i| i as f64 - middle);
        let moment: f64 = offsets().zip(last).map(|(o, p)| o * p[axis]).sum();
        let spread: f64 = offsets().map(|o| o * o).sum();
        mean + moment / spread * (middle + steps as f64)
    })
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    f64::hypot(a[0] - b[0], a[1] - b[1])
}

pub(crate) fn table_head(title: &str) {
    println!("\n{title}: mean error (line over 5), ratio, share inside the 95 % ellipse");
    print!("{:<22}", "");
    for steps in HORIZONS {
        print!("| {steps:>2} steps{:27}", "");
    }
    println!();
}

pub(crate) fn table_row(name: &str, rows: &[Row]) {
    print!("{name:<22}");
    for row in rows {
        let (error, line) = (row.error / row.n, row.line_error / row.n);
        print!(
            "| {error:>7.4} ({line:>7.4}) {:>5.3} {:>5.1} % ",
            error / line,
            100.0 * row.inside / row.n
        );
    }
    println!();
}

/// Prints the table: `cargo test -p predict --test forecast -- --nocapture`.
#[test]
fn never_much_worse_than_a_line_and_better_where_motion_repeats() {
    table_head("generated motions");
    let mut failures = Vec::new();
    for motion in Motion::ALL {
        for sigma in [0.05, 0.3, 1.0] {
            let mut rows = [Row::default(); HORIZONS.len()];
            for seed in 0..RUNS {
                let truth = motion.path(seed, FRAMES);
                let mut noise = Noise::new(seed + 1000);
                let measured: Vec<[f64; 2]> = truth
                    .iter()
                    .map(|place| place.map(|c| c + sigma * noise.normal()))
                    .collect();
                let settings = Settings {
                    forecast_step_s: STEP_S,
                    ..Settings::default()
                };
                score(&truth, &measured, sigma * sigma, &settings, &mut rows);
            }
            table_row(&format!("{motion:?} noise {sigma}"), &rows);
            for (row, steps) in rows.iter().zip(HORIZONS) {
                let ratio = row.error / row.line_error;
                let inside = row.inside / row.n;
                if ratio > 1.05 || inside < 0.8 {
                    failures.push(format!(
                        "{motion:?} {sigma} {steps}: {ratio:.3} {inside:.3}"
                    ));
                }
            }
            let at_15_steps = rows[2].error / rows[2].line_error;
            if matches!(motion, Motion::Circle) && at_15_steps > 0.6 {
                failures.push(format!("a circle repeats, yet {at_15_steps:.3}"));
            }
        }
    }
    assert_eq!(failures, Vec::<String>::new());
}
