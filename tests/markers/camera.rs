//! Cameras whose grey levels are not proportional to the light.

use overcam::marker::built_in_files;

use crate::accuracy::{Score, at, measure};
use crate::scene::{Conditions, GREY};

fn seen(plate_px: f32, gamma: f32, frames: u64) -> Score {
    let conditions = Conditions {
        gamma,
        ..at(plate_px)
    };
    let score = measure(&built_in_files(), &GREY, conditions, frames);
    score.print(&conditions);
    assert_eq!(
        (score.wrong_names, score.half_turns, score.false_markers),
        (0, 0, 0),
        "{plate_px} px, gamma {gamma}"
    );
    score
}

#[test]
fn a_tone_curve_costs_no_marker_and_hardly_any_accuracy() {
    // With edges half-way between the grey levels, gamma 2.2 moves every centre by 0.13 px.
    for (plate_px, gamma, centre_px, heading_deg) in [
        (16.0, 2.2, 0.025, 0.24),
        (24.0, 1.6, 0.018, 0.12),
        (24.0, 2.2, 0.02, 0.14),
        (48.0, 2.4, 0.02, 0.06),
    ] {
        let score = seen(plate_px, gamma, 6);
        let name = format!("{plate_px} px, gamma {gamma}");
        assert!(score.recall() >= 0.99, "{name}: {}", score.recall());
        assert!(score.centre_px() <= centre_px, "{name}");
        assert!(score.heading_deg() <= heading_deg, "{name}");
    }
}

/// The table in BENCHMARKS: `cargo test --release --test markers -- --ignored --nocapture curve`.
/// `FRAMES` sets how many frames a row has.
#[test]
#[ignore = "takes minutes"]
fn every_tone_curve() {
    let frames = std::env::var("FRAMES").map_or(20, |n| n.parse().expect("a number"));
    for plate_px in [12.0, 16.0, 24.0, 32.0, 48.0, 64.0] {
        for gamma in [1.0, 1.6, 2.2, 2.4] {
            seen(plate_px, gamma, frames);
        }
    }
}
