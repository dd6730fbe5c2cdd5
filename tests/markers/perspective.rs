//! Plates that are no squares in the picture, because the camera is tilted or its lens is wide.

use overcam::marker::built_in_files;

use crate::accuracy::{Score, at, measure};
use crate::scene::{Conditions, GREY};
use crate::viewpoint::Viewpoint;

fn seen(plate_px: f32, viewpoint: Viewpoint, frames: u64) -> Score {
    let conditions = Conditions {
        viewpoint,
        ..at(plate_px)
    };
    let score = measure(&built_in_files(), &GREY, conditions, frames);
    score.print(&conditions);
    score
}

fn tilted(degrees: f32) -> Viewpoint {
    Viewpoint {
        tilt_rad: degrees.to_radians(),
        away_rad: -1.2,
        k1: 0.0,
    }
}

fn lens(k1: f32) -> Viewpoint {
    Viewpoint {
        k1,
        ..Viewpoint::ABOVE
    }
}

#[test]
fn tilt_and_lens_cost_hardly_any_marker_and_no_accuracy() {
    // Upright plates: 0.012 px and 0.09 degrees at 24 px, 0.018 px and 0.17 degrees at 16 px.
    for (plate_px, viewpoint, recall, centre_px, heading_deg) in [
        (24.0, tilted(10.0), 0.99, 0.018, 0.12),
        (24.0, tilted(30.0), 0.99, 0.018, 0.12),
        (24.0, tilted(45.0), 0.98, 0.02, 0.16),
        (16.0, tilted(20.0), 0.99, 0.027, 0.24),
        (24.0, lens(-0.3), 0.99, 0.022, 0.12),
    ] {
        let score = seen(plate_px, viewpoint, 6);
        assert!(score.recall() >= recall, "{plate_px} px, {viewpoint:?}");
        assert!(
            score.centre_px() <= centre_px,
            "{plate_px} px, {viewpoint:?}"
        );
        assert!(
            score.heading_deg() <= heading_deg,
            "{plate_px} px, {viewpoint:?}"
        );
        assert_eq!(
            (score.wrong_names, score.half_turns, score.false_markers),
            (0, 0, 0),
            "{plate_px} px, {viewpoint:?}"
        );
    }
}

/// The table in BENCHMARKS: `cargo test --release --test markers -- --ignored --nocapture angle`.
/// `FRAMES` sets how many frames a row has.
#[test]
#[ignore = "takes minutes"]
fn every_angle_and_lens() {
    let frames = std::env::var("FRAMES").map_or(30, |n| n.parse().expect("a number"));
    for plate_px in [16.0, 24.0, 32.0, 64.0] {
        for viewpoint in [
            Viewpoint::ABOVE,
            tilted(5.0),
            tilted(10.0),
            tilted(20.0),
            tilted(30.0),
            tilted(45.0),
            lens(-0.08),
            lens(-0.2),
            lens(-0.3),
        ] {
            let score = seen(plate_px, viewpoint, frames);
            assert_eq!(
                (score.wrong_names, score.false_markers),
                (0, 0),
                "{plate_px} px, {viewpoint:?}"
            );
        }
    }
}
