//! For any input, the output is finite and all observations and tracks are accounted for.

use predict::{Heading, MAX_TRACKS, Observation, Settings, Track, Tracker};
use proptest::prelude::*;

/// Any bit pattern, with special and ordinary numbers frequent.
fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        3 => any::<u64>().prop_map(f64::from_bits),
        2 => prop::sample::select(vec![
            f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN_POSITIVE, 5e-324, 0.0, -0.0, 1e9, -1e9, 1.0,
        ]),
        5 => -700.0..700.0_f64,
        2 => Just(100.0),
    ]
}

/// Accepted coordinates, so that tracks live long enough to be harmed: scattered, close together,
/// or at the limits.
fn position() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => 90.0..110.0_f64,
        2 => Just(100.0),
        1 => -1e9..1e9_f64,
        1 => prop::sample::select(vec![1e9, -1e9, 0.0, 1e-300]),
    ]
}

fn accepted() -> impl Strategy<Value = Observation> {
    let variance = prop_oneof![Just(0.0), 0.0..1.0_f64, Just(1e18), Just(5e-324)];
    let heading =
        (-1e9..1e9_f64, 0.0..1e3_f64).prop_map(|(rad, variance)| Heading { rad, variance });
    let extent = prop_oneof![
        3 => (1.0..5.0_f64, 1.0..30.0_f64),
        2 => (5.0..30.0_f64, 30.0..300.0_f64),
        1 => prop::sample::select(vec![(0.0, 0.0), (1e9, 1e18), (5e-324, 5e-324), (1e9, 5e-324), (0.0, 1e18)]),
    ];
    (
        [position(), position()],
        [variance.clone(), variance],
        -1.0..1.0_f64,
        prop::option::of(heading),
        prop::option::of(0..3_u32),
        extent,
    )
        .prop_map(
            |([x, y], [xx, yy], xy, heading, marker, (reach, area))| Observation {
                x,
                y,
                covariance: [[xx, xy], [xy, yy]],
                heading,
                marker,
                reach,
                area,
            },
        )
}

fn arbitrary() -> impl Strategy<Value = Observation> {
    let heading =
        [any_number(), any_number()].prop_map(|[rad, variance]| Heading { rad, variance });
    (
        [any_number(), any_number()],
        [[any_number(), any_number()], [any_number(), any_number()]],
        prop::option::of(heading),
        prop::option::of(any::<u32>()),
        [any_number(), any_number()],
    )
        .prop_map(
            |([x, y], covariance, heading, marker, [reach, area])| Observation {
                x,
                y,
                covariance,
                heading,
                marker,
                reach,
                area,
            },
        )
}

/// Time stamps: even, equal, a nanosecond later, far ahead, backwards, anything.
fn stamps() -> impl Strategy<Value = Vec<u64>> {
    let change = prop_oneof![
        6 => Just(66_666_667_i128),
        2 => Just(0),
        2 => 1..1000_i128,
        1 => Just(-66_666_667),
        1 => (0..u64::MAX).prop_map(i128::from),
        1 => (0..u64::MAX).prop_map(|ns| -i128::from(ns)),
    ];
    prop::collection::vec(change, 1..80).prop_map(|changes| {
        let mut now = 0_i128;
        let mut step = |change: i128| {
            now = (now + change).clamp(0, i128::from(u64::MAX));
            now as u64
        };
        changes.into_iter().map(&mut step).collect()
    })
}

fn any_settings() -> impl Strategy<Value = Settings> {
    let numbers = [any_number(), any_number(), any_number(), any_number()];
    let wild = (numbers, 0..12_u32, 0..4_u32).prop_map(
        |([step, top, base, offset], max_misses, confirm)| Settings {
            frame_period_s: step,
            top_speed: top,
            gate_base: base,
            marker_offset: offset,
            max_misses,
            confirm,
        },
    );
    prop_oneof![Just(Settings::default()), wild]
}

fn check(track: &Track, n_observations: usize) -> Result<(), TestCaseError> {
    let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
    let plausible = |c: [[f64; 2]; 2]| {
        finite(c.as_flattened()) && c[0][0] >= 0.0 && c[1][1] >= 0.0 && c[0][1] == c[1][0]
    };
    prop_assert!(finite(&track.position()), "{:?}", track.position());
    prop_assert!(finite(&track.velocity()), "{:?}", track.velocity());
    prop_assert!(plausible(track.covariance()), "{:?}", track.covariance());
    prop_assert!(track.observed().is_none_or(|index| index < n_observations));
    prop_assert!(track.turn_rate_rad_s().is_finite() && track.age_s() >= 0.0);
    for dt_s in [-1.0, 0.0, 0.05, 1.3, 9.0, f64::NAN, f64::INFINITY] {
        let point = track.forecast_at(dt_s);
        prop_assert!(finite(&[point.dt_s, point.x, point.y]), "{point:?}");
        prop_assert!(plausible(point.covariance), "{point:?}");
    }
    if let Some(heading) = track.heading() {
        prop_assert!(heading.rad.abs() <= std::f64::consts::PI);
        prop_assert!(heading.variance >= 0.0 && heading.variance.is_finite());
    }
    for point in track.forecast() {
        prop_assert!(finite(&[point.dt_s, point.x, point.y]), "{point:?}");
        prop_assert!(plausible(point.covariance), "{point:?}");
    }
    Ok(())
}

/// Jumps between the limits within nanoseconds, and maximum variances.
#[test]
fn the_largest_numbers_stay_finite() {
    let second = 1_000_000_000;
    let (jump, same) = ([-1e9, 1e9, 1e9, 1e9, 1e9], [5.0; 5]);
    for (frame_period_s, top_speed) in [(10.0, 1e9), (0.1, 1e9), (1.0 / 15.0, 1e9), (10.0, 300.0)] {
        let frame = (frame_period_s * second as f64) as u64;
        for stamps in [
            [0, 1, 2, 3, 4].map(|i| i * frame),
            [0, 1, frame, 2 * frame, 3 * frame],
        ] {
            for (xs, variance) in [(jump, 1e18), (jump, 0.0), (same, 1e18)] {
                let settings = Settings {
                    frame_period_s,
                    top_speed,
                    gate_base: top_speed,
                    ..Settings::default()
                };
                let mut tracker = Tracker::new(vec![Track::EMPTY; MAX_TRACKS]);
                for (stamp_ns, x) in stamps.into_iter().zip(xs) {
                    let observation = Observation {
                        x,
                        y: -0.7 * x,
                        covariance: [[variance, 0.0], [0.0, variance]],
                        heading: None,
                        marker: Some(1),
                        reach: 0.0,
                        area: 0.0,
                    };
                    tracker.update(stamp_ns, &[observation], &settings);
                    for track in tracker.tracks() {
                        check(track, 1).expect("finite");
                    }
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn all_output_is_finite_for_any_input(
        stamps in stamps(),
        settings in prop::collection::vec(any_settings(), 1..3),
        frames in prop::collection::vec(
            prop::collection::vec(prop_oneof![4 => accepted(), 1 => arbitrary()], 0..6), 1..80),
    ) {
        let mut tracker = Tracker::new(vec![Track::EMPTY; MAX_TRACKS]);
        let mut newest_id = 0;
        let mut alive = 0;
        for ((i, stamp_ns), observations) in stamps.iter().enumerate().zip(&frames) {
            let settings = &settings[i * settings.len() / stamps.len()];
            let update = tracker.update(*stamp_ns, observations, settings);
            alive = alive + update.started - update.retired;
            prop_assert!(tracker.tracks().count() <= alive);
            let mut accounted = update.rejected + update.overflow;
            let mut last_id = 0;
            for track in tracker.tracks() {
                check(track, observations.len())?;
                prop_assert!(track.id() > last_id);
                last_id = track.id();
                accounted += usize::from(track.observed().is_some());
            }
            prop_assert!(last_id <= newest_id + update.started as u64);
            newest_id += update.started as u64;
            prop_assert!(accounted <= observations.len());
            if settings.confirm <= 1 {
                prop_assert_eq!(accounted, observations.len());
                prop_assert_eq!(tracker.tracks().count(), alive);
            }
        }
    }

    #[test]
    fn crowds_are_bounded(n in 0..400_usize, spread in 0.0..1e4_f64) {
        let mut tracker = Tracker::new(vec![Track::EMPTY; MAX_TRACKS]);
        let observations: Vec<Observation> = (0..n)
            .map(|i| Observation {
                x: spread * (i as f64 * 0.618).fract(),
                y: spread * (i as f64 * 0.414).fract(),
                covariance: [[1.0, 0.0], [0.0, 1.0]],
                heading: None,
                marker: (i % 3 == 0).then_some(i as u32 % 5),
                reach: 0.0,
                area: 0.0,
            })
            .collect();
        for stamp_ns in [0, 66_666_667] {
            let update = tracker.update(stamp_ns, &observations, &Settings::default());
            let tracked = tracker.tracks().filter(|track| track.observed().is_some()).count();
            prop_assert!(tracked <= MAX_TRACKS);
            prop_assert_eq!(tracked + update.overflow, n);
        }
    }
}
