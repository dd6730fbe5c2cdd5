//! The life cycle of tracks, on synthetic scenes.

use predict::{FORECAST_SPACING_S, Heading, MAX_FORECAST, MAX_TRACKS, Observation, Track, Tracker};

use crate::fixture::{Floor, STEP_NS, STEP_S, distance, settings};

fn blob([x, y]: [f64; 2]) -> Observation {
    Observation {
        x,
        y,
        covariance: [[0.04, 0.0], [0.0, 0.04]],
        heading: None,
        marker: None,
        reach: 0.0,
        area: 0.0,
    }
}

fn robot(marker: u32, position: [f64; 2], heading_rad: f64) -> Observation {
    Observation {
        heading: Some(Heading {
            rad: heading_rad,
            variance: 1e-4,
        }),
        marker: Some(marker),
        ..blob(position)
    }
}

fn worst_forecast(track: &Track, truth: impl Fn(f64) -> [f64; 2]) -> f64 {
    assert_eq!(track.forecast().len(), MAX_FORECAST);
    let error = |(i, point): (usize, &predict::ForecastPoint)| {
        assert!((point.dt_s - (i + 1) as f64 * FORECAST_SPACING_S).abs() < 1e-12);
        distance([point.x, point.y], truth(point.dt_s))
    };
    track
        .forecast()
        .iter()
        .enumerate()
        .map(error)
        .fold(0.0, f64::max)
}

#[test]
fn a_straight_line_is_forecast_from_the_third_sample() {
    let position = |t: f64| [10.0 + 60.0 * t, 200.0 - 25.0 * t];
    let mut floor = Floor::new();
    for i in 0..120 {
        let t = f64::from(i) * STEP_S;
        floor.observe(&[blob(position(t))]);
        let track = floor.only();
        assert_eq!(track.position(), position(t), "not filtered");
        if i >= 2 {
            let error = worst_forecast(track, |dt| position(t + dt));
            assert!(error < 1e-2, "frame {i}: {error} px");
            // Experts have single precision.
            assert!(distance(track.velocity(), [60.0, -25.0]) < 1e-4);
        }
    }
}

#[test]
fn a_circle_is_forecast_from_the_fourth_sample() {
    let position = |t: f64| {
        [
            300.0 + 60.0 * (1.2 * t).cos(),
            200.0 + 60.0 * (1.2 * t).sin(),
        ]
    };
    let mut floor = Floor::new();
    for i in 0..120 {
        let t = f64::from(i) * STEP_S;
        floor.observe(&[blob(position(t))]);
        let error = worst_forecast(floor.only(), |dt| position(t + dt));
        // A line would be 120 px off after two seconds.
        if i >= 3 {
            assert!(error < 0.5, "frame {i}: {error} px");
        }
        if i >= 20 {
            assert!(error < 0.01, "frame {i}: {error} px");
        }
    }
}

#[test]
fn uneven_and_dropped_frames_do_not_bend_a_line() {
    let mut tracker = Tracker::new(vec![Track::EMPTY; MAX_TRACKS]);
    let mut stamp_ns = 5_000_000_000;
    for i in 0..60_u64 {
        stamp_ns += [STEP_NS, STEP_NS / 2, 3 * STEP_NS][(i % 3) as usize];
        let at = |ns: f64| [60.0 * ns / 1e9, 5.0];
        tracker.update(stamp_ns, &[blob(at(stamp_ns as f64))], &settings());
        let track = tracker.tracks().next().expect("a track");
        assert_eq!(track.id(), 1);
        if i >= 2 {
            let error = worst_forecast(track, |dt| at(stamp_ns as f64 + dt * 1e9));
            assert!(error < 1e-2, "frame {i}: {error} px");
        }
    }
}

#[test]
fn crossing_objects_keep_their_ids() {
    let mut floor = Floor::new();
    for i in 0..60 {
        let t = f64::from(i) * STEP_S;
        // They meet at (200, 100) in frame 30. Their order in the input changes.
        let right = blob([200.0 + 80.0 * (t - 2.0), 100.0 + 40.0 * (t - 2.0)]);
        let left = blob([200.0 - 80.0 * (t - 2.0), 102.0 + 40.0 * (t - 2.0)]);
        let swapped = i % 2 == 1;
        floor.observe(&if swapped {
            [left, right]
        } else {
            [right, left]
        });
        let observed: Vec<_> = floor.tracker.tracks().map(Track::observed).collect();
        let expected = if swapped { [1, 0] } else { [0, 1] };
        assert_eq!(observed, expected.map(Some), "frame {i}");
    }
    assert_eq!(floor.ids(), [1, 2]);
}

#[test]
fn a_gap_is_filled_by_the_forecast() {
    let position = |t: f64| [50.0 + 90.0 * t, 100.0];
    let mut floor = Floor::new();
    let mut last_variance = 0.0;
    for i in 0..30 {
        let t = f64::from(i) * STEP_S;
        let hidden = (15..20).contains(&i);
        let observations = [blob(position(t))];
        floor.observe(if hidden { &[] } else { &observations });
        let track = floor.only();
        assert_eq!(track.id(), 1);
        assert_eq!(track.observed(), (!hidden).then_some(0));
        assert_eq!(track.pose_observed(), !hidden);
        assert_eq!(track.misses(), if hidden { i as u32 - 14 } else { 0 });
        if i > 5 {
            assert!(distance(track.position(), position(t)) < 0.01);
            assert!(distance(track.velocity(), [90.0, 0.0]) < 0.1);
            assert!(worst_forecast(track, |dt| position(t + dt)) < 0.05);
        }
        let variance = track.covariance()[0][0];
        if hidden && i > 15 {
            assert!(variance > last_variance, "uncertainty grows");
        }
        last_variance = variance;
    }
}

#[test]
fn a_track_is_retired_after_its_misses_and_its_id_not_reused() {
    let mut floor = Floor::new();
    floor.observe(&[blob([100.0, 100.0])]);
    for miss in 1..=floor.settings.max_misses {
        assert_eq!(floor.observe(&[]).retired, 0);
        assert_eq!(floor.only().misses(), miss);
    }
    assert_eq!(floor.observe(&[]).retired, 1);
    assert_eq!(floor.ids(), []);
    let update = floor.observe(&[blob([100.0, 100.0])]);
    assert_eq!(update.started, 1);
    assert_eq!(floor.ids(), [2]);
}

#[test]
fn the_order_of_ids_survives_retirement() {
    let mut floor = Floor::new();
    let positions = [0.0, 200.0, 400.0, 600.0].map(|x| blob([x, 0.0]));
    floor.observe(&positions);
    for _ in 0..9 {
        floor.observe(&[positions[2], positions[0]]);
    }
    assert_eq!(floor.ids(), [1, 3]);
    floor.observe(&positions);
    assert_eq!(floor.ids(), [1, 3, 5, 6]);
}

#[test]
fn confirmation_hides_a_flash() {
    let mut floor = Floor::new();
    floor.settings.confirm = 3;
    floor.observe(&[blob([100.0, 100.0]), blob([300.0, 100.0])]);
    floor.observe(&[blob([100.0, 100.0])]);
    assert_eq!(floor.ids(), []);
    floor.observe(&[blob([100.0, 100.0])]);
    assert_eq!(floor.ids(), [1]);
    assert_eq!(floor.only().age_s(), 2.0 * STEP_S);
    floor.observe(&[blob([300.0, 100.0])]);
    assert_eq!(floor.ids(), [1], "three observations are needed again");
}

#[test]
fn a_marker_keeps_its_track_through_a_close_crossing() {
    let mut floor = Floor::new();
    for i in 0..40 {
        let t = f64::from(i) * STEP_S;
        let ahead = 80.0 * (t - 20.0 * STEP_S);
        let mut observations = [
            robot(7, [200.0 + ahead, 100.0], 0.0),
            robot(4, [200.0 - ahead, 101.0], 3.0),
        ];
        // They push each other aside where they meet. By distance alone they would switch ids.
        if i >= 20 {
            observations = [
                robot(7, [200.0 - ahead, 101.0], 3.0),
                robot(4, [200.0 + ahead, 100.0], 0.0),
            ];
        }
        floor.observe(&observations);
        let marked: Vec<_> = floor
            .tracker
            .tracks()
            .map(|t| (t.id(), t.marker()))
            .collect();
        assert_eq!(marked, [(1, Some(7)), (2, Some(4))], "frame {i}");
    }
}

#[test]
fn a_marker_never_joins_the_track_of_another() {
    let mut floor = Floor::new();
    floor.observe(&[robot(1, [100.0, 100.0], 0.0)]);
    floor.observe(&[robot(2, [100.0, 100.0], 0.0)]);
    let observations: Vec<_> = floor
        .tracker
        .tracks()
        .map(|t| (t.marker(), t.observed()))
        .collect();
    assert_eq!(observations, [(Some(1), None), (Some(2), Some(0))]);
}

#[test]
fn a_known_marker_has_a_wider_gate() {
    let gate = settings().gate_base + 3.0 * settings().top_speed * STEP_S;
    for (marker, expected) in [(Some(5), vec![1]), (None, vec![1, 2])] {
        let mut floor = Floor::new();
        floor.observe(&[robot(5, [100.0, 100.0], 0.0)]);
        let mut carried = robot(5, [100.0 + 2.0 * gate, 100.0], 0.0);
        carried.marker = marker;
        floor.observe(&[carried]);
        assert_eq!(floor.ids(), expected);
    }
}

#[test]
fn a_carried_robot_keeps_its_id() {
    let mut floor = Floor::new();
    let object = blob([500.0, 300.0]);
    for _ in 0..20 {
        floor.observe(&[robot(3, [60.0, 50.0], 0.5), object]);
    }
    // Immediately, after a while under a hand, and long after its track was retired.
    for (away_frames, position) in [(0, [400.0, 50.0]), (5, [60.0, 400.0]), (60, [300.0, 300.0])] {
        for _ in 0..away_frames {
            floor.observe(&[object]);
        }
        for _ in 0..3 {
            floor.observe(&[robot(3, position, -1.0), object]);
            assert_eq!(floor.ids(), [1, 2], "after {away_frames} frames");
            floor.assert_at(1, position, 0.0);
            assert_eq!(floor.track(1).marker(), Some(3));
        }
        // It is at rest: being carried is not its own motion.
        assert!(distance(floor.track(1).velocity(), [0.0; 2]) < 1.0);
    }
}

#[test]
fn an_object_in_the_place_of_a_robot_does_not_take_its_id() {
    let mut floor = Floor::new();
    for _ in 0..20 {
        floor.observe(&[robot(3, [60.0, 50.0], 0.5)]);
    }
    // A bag covers it until the marker is given up. Then the robot is elsewhere.
    for _ in 0..20 {
        floor.observe(&[blob([62.0, 50.0])]);
    }
    floor.observe(&[blob([62.0, 50.0]), robot(3, [300.0, 50.0], 0.5)]);
    assert_eq!(floor.track(1).marker(), Some(3));
    floor.assert_at(1, [300.0, 50.0], 0.0);
    floor.observe(&[blob([62.0, 50.0]), robot(3, [300.0, 50.0], 0.5)]);
    assert_eq!(floor.ids(), [1, 2], "the bag has its own track");
}

/// A robot comes into the picture over its border: without its marker at first.
#[test]
fn a_robot_that_returns_over_the_border_keeps_its_id() {
    let longest = u64::from(Floor::new().settings.max_misses);
    // Its track is retired, or still waits for it where it left.
    for away in [2 * longest, longest / 2] {
        let mut floor = Floor::new();
        let other = blob([400.0, 300.0]);
        let x = |i: u64| 40.0 + 2.0 * i as f64;
        for i in (0..20).rev() {
            floor.observe(&[robot(3, [x(i), 50.0], 3.1), other]);
        }
        for _ in 0..away {
            floor.observe(&[other]);
        }
        for i in 0..6 {
            floor.observe(&[other, blob([x(i), 250.0])]);
        }
        assert_eq!(floor.ids().last(), Some(&3), "nobody knows it yet");
        floor.observe(&[other, robot(3, [x(6), 250.0], 0.0)]);
        assert_eq!(floor.ids(), [1, 2]);
        assert_eq!(floor.track(1).marker(), Some(3));
        floor.assert_at(1, [x(6), 250.0], 0.0);
        assert_eq!(floor.track(2).marker(), None);
        for i in 7..30 {
            floor.observe(&[other, robot(3, [x(i), 250.0], 0.0)]);
            assert_eq!(floor.ids(), [1, 2]);
        }
    }
}

#[test]
fn two_robots_with_the_same_marker_have_two_tracks() {
    let mut floor = Floor::new();
    for _ in 0..20 {
        floor.observe(&[robot(3, [60.0, 50.0], 0.5), robot(3, [400.0, 50.0], 0.5)]);
        assert_eq!(floor.ids(), [1, 2]);
        floor.assert_at(1, [60.0, 50.0], 0.0);
    }
}

/// A robot drives along x and turns slowly. Its centroid is 6 px beside the plate.
fn drive(floor: &mut Floor, frames: u64, read: bool) {
    for _ in 0..frames {
        let t = floor.frame as f64 * STEP_S;
        let plate = [50.0 + 60.0 * t, 100.0];
        floor.observe(&[if read {
            robot(3, plate, 0.2 * t)
        } else {
            blob([plate[0], plate[1] + 6.0])
        }]);
    }
}

#[test]
fn a_missing_marker_keeps_robot_and_heading() {
    let mut floor = Floor::new();
    drive(&mut floor, 20, true);
    drive(&mut floor, 3, false);
    let t = 22.0 * STEP_S;
    let track = floor.only();
    assert_eq!((track.id(), track.marker()), (1, Some(3)));
    assert_eq!((track.observed(), track.pose_observed()), (Some(0), false));
    assert_eq!(track.misses(), 0);
    let away = distance(track.position(), [50.0 + 60.0 * t, 100.0]);
    assert!(away < 1.0, "pulled {away} px to the centroid");
    let heading = track.heading().expect("a forecast heading");
    assert!((heading.rad - 0.2 * t).abs() < 1e-6);
    assert!(heading.variance > 1e-4);
    assert!((track.turn_rate_rad_s() - 0.2).abs() < 1e-6);

    drive(&mut floor, 1, true);
    let track = floor.only();
    assert!(track.pose_observed());
    assert_eq!(track.position()[1], 100.0);
    assert!(distance(track.velocity(), [60.0, 0.0]) < 0.01);
}

#[test]
fn a_marker_missing_for_long_is_given_up_and_may_return() {
    let mut floor = Floor::new();
    drive(&mut floor, 20, true);
    let longest = u64::from(floor.settings.max_misses);
    drive(&mut floor, longest, false);
    assert_eq!(floor.only().marker(), Some(3));
    drive(&mut floor, 1, false);
    let track = floor.only();
    assert_eq!((track.id(), track.marker()), (1, None));
    assert_eq!(track.heading(), None);
    assert!(track.pose_observed());
    assert_eq!(track.position()[1], 106.0);
    let jump = distance(track.velocity(), [60.0, 0.0]);
    assert!(jump < 1.0, "velocity jumped by {jump} px/s");
    drive(&mut floor, 1, true);
    let track = floor.only();
    assert_eq!((track.id(), track.marker()), (1, Some(3)));
    let jump = distance(track.velocity(), [60.0, 0.0]);
    assert!(jump < 1.0, "velocity jumped by {jump} px/s");
}

#[test]
fn tracks_survive_forget_floor() {
    let blobs = [blob([100.0, 100.0]), blob([200.0, 150.0])];
    let mut floor = Floor::new();
    for _ in 0..5 {
        floor.observe(&blobs);
    }
    floor.tracker.forget_floor();
    floor.observe(&blobs);
    let observed: Vec<_> = floor.tracker.tracks().map(Track::observed).collect();
    assert_eq!(observed, [Some(0), Some(1)]);
    // On a floor where only one object was observed, the other one is not expected.
    floor.tracker.forget_floor();
    floor.observe(&[blob([100.0, 101.0])]);
    floor.tracker.forget_floor();
    floor.observe(&[blob([200.0, 151.0])]);
    let observed: Vec<_> = floor.tracker.tracks().map(Track::observed).collect();
    assert_eq!(observed, [None, Some(0)]);
    floor.tracker.forget_floor();
    assert_eq!(floor.observe(&[]).started, 0);
}

#[test]
fn overflow_is_counted() {
    let far_apart = |i: usize| blob([500.0 * (i % 20) as f64, 500.0 * (i / 20) as f64]);
    let observations: Vec<_> = (0..300).map(far_apart).collect();
    let mut floor = Floor::new();
    let update = floor.observe(&observations[..MAX_TRACKS + 6]);
    assert_eq!((update.started, update.overflow), (MAX_TRACKS, 6));
    let update = floor.observe(&observations);
    assert_eq!((update.started, update.overflow), (0, 300 - MAX_TRACKS));
    assert!(
        floor
            .tracker
            .tracks()
            .all(|track| track.observed() == Some(track.id() as usize - 1))
    );
}

#[test]
fn invalid_observations_are_ignored_and_counted() {
    let mut floor = Floor::new();
    let update = floor.observe(&[
        blob([f64::NAN, 0.0]),
        blob([1.0, 2.0]),
        blob([0.0, f64::INFINITY]),
    ]);
    assert_eq!((update.rejected, update.started), (2, 1));
    assert_eq!(
        floor.only().observed(),
        Some(1),
        "the index is the caller's"
    );
}

#[test]
fn a_time_stamp_that_does_not_advance_is_the_same_time() {
    let mut floor = Floor::new();
    let position = |frame: u64| [4.0 * frame as f64, 0.0];
    for _ in 0..10 {
        floor.observe(&[blob(position(floor.frame))]);
    }
    let velocity = floor.only().velocity();
    floor.frame -= 1;
    floor.observe(&[blob(position(9))]);
    assert_eq!(floor.only().velocity(), velocity);
    // The clock is set back by several frames. The tracker continues from there.
    for i in 0..5 {
        let stamp_ns = 1000 + i * STEP_NS;
        let observations = [blob(position(9 + i))];
        floor
            .tracker
            .update(stamp_ns, &observations, &floor.settings);
        assert!(distance(floor.only().velocity(), velocity) < 1e-4);
        assert_eq!(floor.only().id(), 1);
    }
}

#[test]
fn results_do_not_depend_on_the_previous_use_of_a_slot() {
    let run = |floor: &mut Floor| {
        let mut results = Vec::new();
        for i in 0..30 {
            let t = f64::from(i) * 0.3;
            floor.observe(&[robot(1, [100.0 + 40.0 * t.sin(), 30.0 * t], 0.1 * t)]);
            let track = floor.only();
            let forecast = track.forecast().to_vec();
            results.push((
                track.velocity(),
                track.heading(),
                track.covariance(),
                forecast,
            ));
        }
        results
    };
    // Nothing is observed beyond the corners. The bounds belong to the tracker, not to a slot.
    let corners = || {
        let mut floor = Floor::new();
        floor.observe(&[blob([0.0, 0.0]), blob([640.0, 480.0])]);
        for _ in 0..10 {
            floor.observe(&[]);
        }
        floor
    };
    let mut used = corners();
    for i in 0..50 {
        let x = f64::from(i % 7) * 3.0;
        used.observe(&[blob([x, 400.0]), robot(9, [300.0, x], x)]);
    }
    for _ in 0..10 {
        used.observe(&[]);
    }
    assert_eq!(used.ids(), []);
    assert_eq!(run(&mut used), run(&mut corners()));
}

#[test]
fn metres_and_pixels_give_equal_results() {
    const METRES_PER_PX: f64 = 0.003;
    let mut pixels = Floor::new();
    let mut metres = Floor::new();
    metres.settings = metres.settings.scaled(METRES_PER_PX);
    for i in 0..60 {
        let t = f64::from(i) * STEP_S;
        let position = [
            60.0 * t,
            30.0 * (2.0 * t).sin() + 0.3 * f64::from(i * i % 5),
        ];
        pixels.observe(&[blob(position)]);
        metres.observe(&[Observation {
            x: position[0] * METRES_PER_PX,
            y: position[1] * METRES_PER_PX,
            covariance: blob(position)
                .covariance
                .map(|row| row.map(|c| c * METRES_PER_PX * METRES_PER_PX)),
            ..blob(position)
        }]);
        for (px, m) in pixels
            .only()
            .forecast()
            .iter()
            .zip(metres.only().forecast())
        {
            let difference = distance([px.x, px.y], [m.x, m.y].map(|c| c / METRES_PER_PX));
            // The network has single precision.
            assert!(difference < 1e-2, "frame {i}: {difference} px");
        }
    }
}
