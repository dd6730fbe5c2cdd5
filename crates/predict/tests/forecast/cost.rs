//! What a frame costs.

use std::time::Instant;

use predict::{MAX_TRACKS, Observation, Settings, Tracker};

use crate::motions::{Motion, Noise, STEP_S};

/// Frames until every buffer of a track is full, and frames measured.
const WARM_UP: usize = 60;
const FRAMES: usize = 300;

#[test]
#[ignore = "measures: cargo test -p predict --release --test forecast cost -- --ignored --nocapture"]
fn cost_of_a_full_floor() {
    // Every track far from the others, so that nothing but forecasting and assigning is measured.
    let mut noise = Noise::new(1);
    let paths: Vec<_> = (0..MAX_TRACKS as u64)
        .map(|seed| Motion::Slalom.path(seed, WARM_UP + FRAMES))
        .collect();
    let frames: Vec<Vec<Observation>> = (0..WARM_UP + FRAMES)
        .map(|frame| {
            let observe = |(i, path): (usize, &Vec<[f64; 2]>)| Observation {
                x: path[frame][0] + 2000.0 * (i % 8) as f64 + 0.2 * noise.normal(),
                y: path[frame][1] + 2000.0 * (i / 8) as f64 + 0.2 * noise.normal(),
                covariance: [[0.04, 0.0], [0.0, 0.04]],
                heading: None,
                marker: None,
                reach: 0.0,
                area: 0.0,
            };
            paths.iter().enumerate().map(observe).collect()
        })
        .collect();

    let mut tracker = Box::new(Tracker::new());
    let mut times_us = Vec::with_capacity(frames.len());
    for (i, observations) in frames.iter().enumerate() {
        let stamp_ns = (i as f64 * STEP_S * 1e9) as u64;
        let start = Instant::now();
        tracker.update(stamp_ns, observations, &Settings::default());
        times_us.push(start.elapsed().as_secs_f64() * 1e6);
    }
    assert_eq!(tracker.tracks().count(), MAX_TRACKS);
    assert!(
        tracker
            .tracks()
            .all(|track| track.id() <= MAX_TRACKS as u64)
    );
    // The median, because other programs take their share of the machine.
    let measured = &mut times_us[WARM_UP..];
    measured.sort_by(f64::total_cmp);
    let frame_us = measured[FRAMES / 2];
    println!(
        "{frame_us:.0} us a frame of {MAX_TRACKS} tracks, {:.1} us a track; a tracker is {} kB",
        frame_us / MAX_TRACKS as f64,
        size_of::<Tracker>() / 1000
    );
}
