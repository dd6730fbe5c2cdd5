//! Effects of cameras, lamps and motion on markers: fewer are read, none is mistaken.

use overcam::marker::built_in_files;

use crate::accuracy::{Score, at, measure};
use crate::scene::{Conditions, Disturbance, GREY, Palette};

/// Red on white on a wooden floor.
const RED: Palette = Palette {
    floor: [150.0, 120.0, 85.0],
    paper: [225.0, 224.0, 220.0],
    ink: [200.0, 40.0, 45.0],
};

fn score(palette: &Palette, plate_px: f32, disturbance: Disturbance, frames: u64) -> Score {
    let conditions = Conditions {
        disturbance,
        ..at(plate_px)
    };
    let score = measure(&built_in_files(), palette, conditions, frames);
    score.print(&conditions);
    assert_eq!(
        (score.wrong_names, score.half_turns, score.false_markers),
        (0, 0, 0),
        "{conditions:?}"
    );
    score
}

#[test]
fn ordinary_disturbances_hide_hardly_any_marker() {
    for (palette, disturbance, recall) in [
        (&GREY, Disturbance::Motion(2.0), 0.97),
        (&GREY, Disturbance::Defocus(1.5), 0.97),
        (&GREY, Disturbance::Falloff(0.7), 0.97),
        (&GREY, Disturbance::Jpeg(60), 0.97),
        (&GREY, Disturbance::Touching, 0.85),
        (&RED, Disturbance::Touching, 0.95),
        (&RED, Disturbance::Subsampled, 0.97),
        // After compression, the colours around dark rims hide parts of robots.
        (&RED, Disturbance::Jpeg(75), 0.9),
    ] {
        let score = score(palette, 24.0, disturbance, 6);
        assert!(
            score.recall() >= recall,
            "{disturbance:?}: {}",
            score.recall()
        );
        assert!(
            score.centre_px() < 0.1 && score.heading_deg() < 1.0,
            "{disturbance:?}"
        );
    }
}

#[test]
fn what_cannot_be_read_is_not_guessed() {
    for disturbance in [
        Disturbance::Motion(6.0),
        Disturbance::Defocus(3.5),
        Disturbance::Falloff(0.4),
        Disturbance::Shadow(0.7),
        Disturbance::Shadow(0.4),
        Disturbance::Glare(0.2),
        Disturbance::Glare(0.4),
        Disturbance::Jpeg(20),
        Disturbance::Border,
    ] {
        score(&GREY, 24.0, disturbance, 6);
    }
}

/// Of robots that were never seen before; `floorless` has those that are known.
#[test]
fn a_cover_is_not_part_of_a_marker() {
    for (share, recall) in [(0.05, 0.7), (0.1, 0.5)] {
        let score = score(&GREY, 24.0, Disturbance::Covered(share), 6);
        assert!(score.recall() >= recall, "{share}: {}", score.recall());
    }
}
