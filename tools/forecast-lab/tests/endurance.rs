//! Hours of frames: all output stays finite, and forecasts do not degrade.

use forecast_lab::random::Random;
use predict::{Observation, Settings, Track, Tracker};

const RATE_HZ: usize = 15;
const HOUR: usize = 3600 * RATE_HZ;
/// Number of frames ahead at which errors are measured: a second.
const AHEAD: usize = RATE_HZ;

/// Positions of three objects: one on a figure of eight, one that wanders between walls and changes
/// direction, and one that is parked.
struct Floor {
    random: Random,
    frame: usize,
    at: [f64; 2],
    heading: f64,
    speed: f64,
}

impl Floor {
    fn next(&mut self) -> [[f64; 2]; 3] {
        let t = self.frame as f64 / RATE_HZ as f64;
        self.frame += 1;
        self.heading += 0.3 * self.random.normal();
        if self.random.chance(0.02) {
            self.heading = self.random.between(-3.1, 3.1);
            self.speed = self.random.between(0.0, 6.0);
        }
        let step = [self.heading.cos(), self.heading.sin()].map(|c| self.speed * c);
        for axis in 0..2 {
            self.at[axis] =
                (self.at[axis] + step[axis]).clamp([700.0, 0.0][axis], [1300.0, 480.0][axis]);
        }
        let eight = [300.0 + 150.0 * (0.5 * t).sin(), 240.0 + 80.0 * t.sin()];
        [eight, self.at, [1600.0, 240.0]]
    }
}

/// Mean errors of the three objects a second ahead, in the first and in the last `part` of
/// `frames`, relative to the distance that each covers in a second, because the wandering one never
/// repeats itself. For the parked one this distance is taken as 1 px.
fn errors(frames: usize, part: usize) -> [[f64; 3]; 2] {
    let mut floor = Floor {
        random: Random::new(5),
        frame: 0,
        at: [1000.0, 240.0],
        heading: 0.0,
        speed: 3.0,
    };
    let mut noise = Random::new(6);
    let mut tracker = Tracker::new(vec![Track::EMPTY; 3]);
    let settings = Settings::default();
    let mut waiting = vec![[[f64::NAN; 2]; 3]; AHEAD];
    let mut before = vec![[[f64::NAN; 2]; 3]; AHEAD];
    let (mut sums, mut distances) = ([[0.0; 3]; 2], [[1e-9; 3]; 2]);
    for frame in 0..frames {
        let truth = floor.next();
        let observations = truth.map(|position| Observation {
            x: position[0] + 0.3 * noise.normal(),
            y: position[1] + 0.3 * noise.normal(),
            covariance: [[0.09, 0.0], [0.0, 0.09]],
            heading: None,
            marker: None,
            reach: 0.0,
            area: 0.0,
        });
        let stamp_ns = (frame as u64 * 1_000_000_000) / RATE_HZ as u64;
        tracker.update(stamp_ns, &observations, &settings);
        let slot = frame % AHEAD;
        let parts = [(10 * AHEAD..part).contains(&frame), frame >= frames - part];
        for part in (0..2).filter(|part| parts[*part]) {
            for (i, truth) in truth.iter().enumerate() {
                let from =
                    |position: [f64; 2]| (position[0] - truth[0]).hypot(position[1] - truth[1]);
                sums[part][i] += from(waiting[slot][i]);
                distances[part][i] += if i == 2 { 1.0 } else { from(before[slot][i]) };
            }
        }
        before[slot] = truth;
        let mut ids = [0; 3];
        for (i, track) in tracker.tracks().enumerate() {
            let point = track.forecast_at(AHEAD as f64 / RATE_HZ as f64);
            assert!(point.x.is_finite() && point.y.is_finite(), "frame {frame}");
            assert!(
                point
                    .covariance
                    .as_flattened()
                    .iter()
                    .all(|c| c.is_finite())
            );
            waiting[slot][i] = [point.x, point.y];
            ids[i] = track.id();
        }
        assert_eq!(ids, [1, 2, 3], "frame {frame}");
    }
    [0, 1].map(|part| [0, 1, 2].map(|i| sums[part][i] / distances[part][i]))
}

fn check([first, last]: [[f64; 3]; 2]) {
    println!("errors a second ahead, first part {first:.3?}, last part {last:.3?}");
    for (first, last) in first.iter().zip(last) {
        assert!(last <= 1.05 * first, "{first} became {last}");
    }
}

#[test]
fn forecasts_do_not_degrade_within_an_hour() {
    check(errors(HOUR, HOUR / 4));
}

#[test]
#[ignore = "takes a minute: cargo test --release -p forecast-lab --test endurance -- --ignored --nocapture"]
fn a_day_wears_nothing_out() {
    check(errors(24 * HOUR, HOUR));
}
