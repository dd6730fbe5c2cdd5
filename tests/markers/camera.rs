//! Cameras that make more of the light than grey levels in proportion: tone curves and sharpening.

use overcam::marker::built_in_files;

use crate::accuracy::{Score, at, measure};
use crate::scene::{Conditions, GREY};

fn seen(plate_px: f32, gamma: f32, sharpening: f32, frames: u64) -> Score {
    let conditions = Conditions {
        gamma,
        sharpening,
        ..at(plate_px)
    };
    let score = measure(&built_in_files(), &GREY, conditions, frames);
    score.print(&conditions);
    assert_eq!(
        (score.wrong_names, score.half_turns, score.false_markers),
        (0, 0, 0),
        "{plate_px} px, gamma {gamma}, sharpening {sharpening}"
    );
    score
}

#[test]
fn tone_curves_and_sharpening_cost_no_marker_and_hardly_any_accuracy() {
    // With edges half-way between the grey levels, gamma 2.2 moves every centre by 0.13 px.
    for (plate_px, gamma, sharpening, centre_px, heading_deg) in [
        (16.0, 2.2, 0.0, 0.025, 0.24),
        (24.0, 2.2, 0.0, 0.02, 0.14),
        (48.0, 2.4, 0.0, 0.02, 0.06),
        (24.0, 1.0, 2.0, 0.02, 0.14),
        (24.0, 2.2, 0.7, 0.02, 0.14),
    ] {
        let score = seen(plate_px, gamma, sharpening, 6);
        let name = format!("{plate_px} px, gamma {gamma}, sharpening {sharpening}");
        assert!(score.recall() >= 0.99, "{name}: {}", score.recall());
        assert!(score.centre_px() <= centre_px, "{name}");
        assert!(score.heading_deg() <= heading_deg, "{name}");
    }
}
