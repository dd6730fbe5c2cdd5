//! The light or the camera changes at once.

use std::collections::BTreeSet;

use imgproc::Size;

use crate::body::{BLACK, Body, Paint, RED, Shape};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Demands, Judged, LongestRun};
use crate::light::Light;
use crate::play::{Play, RATE_HZ};

const SIZE: Size = Size {
    width: 320,
    height: 240,
};

/// Frames before something changes.
const BEFORE: usize = 10;

/// A parked plate, a parked black disc and a red box that drives.
fn robots(frame: usize) -> [Body; 3] {
    let robot = |shape, paint, at| Body {
        shape,
        paint,
        at,
        heading_rad: 0.5,
    };
    [
        robot(Shape::Box(40.0, 40.0), Paint::Plate(40.0), [70.0, 70.0]),
        robot(Shape::Disc(16.0), Paint::Plain(BLACK), [250.0, 60.0]),
        robot(
            Shape::Box(36.0, 26.0),
            Paint::Plain(RED),
            [60.0 + 1.2 * frame as f32, 180.0],
        ),
    ]
}

/// What became of the robots and of the empty floor from a change on.
struct Aftermath {
    /// Longest time without one of the robots, frames.
    lost: usize,
    /// Longest time with false objects, frames.
    false_run: usize,
    /// First frame after which all robots are there in every frame.
    back: usize,
    /// Different false objects.
    n_false: usize,
    /// False objects in the last second.
    n_false_late: usize,
}

/// Shows robots on a floor; the light is a function of the frame since the change.
fn play(floor: Floor, frames: usize, light: impl Fn(usize) -> Light) -> Aftermath {
    let empty = Canvas::new(floor, SIZE);
    let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
    let mut lost = [LongestRun::default(); 3];
    let (mut false_run, mut tracks) = (LongestRun::default(), BTreeSet::new());
    let (mut back, mut n_false_late) = (0, 0);
    for frame in 0..BEFORE + frames {
        let canvas = empty.with(&robots(frame), &[]);
        let Some(since) = frame.checked_sub(BEFORE) else {
            play.show(&canvas, &Light::EVEN);
            continue;
        };
        let judged = Judged::new(play.show(&canvas, &light(since)), &canvas);
        for (robot, lost) in lost.iter_mut().enumerate() {
            let sees = judged.sees(robot);
            lost.add(!sees);
            if !sees {
                back = since + 1;
            }
        }
        let n_false = judged.false_objects().count();
        false_run.add(n_false > 0);
        tracks.extend(judged.false_objects().map(|object| object.track));
        if since + RATE_HZ >= frames {
            n_false_late += n_false;
        }
    }
    Aftermath {
        lost: lost.iter().map(|run| run.longest).max().unwrap_or(0),
        false_run: false_run.longest,
        back,
        n_false: tracks.len(),
        n_false_late,
    }
}

/// A step of the camera's gain that stays.
fn step(name: &str, gain: [f32; 3]) {
    println!("{name}: floor, frames without a robot, frames with false objects, false objects");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let stepped = Light {
            gain,
            ..Light::EVEN
        };
        let after = play(floor, 45, |_| stepped);
        println!(
            "  {:10} {:3} {:3} {:3}",
            format!("{floor:?}"),
            after.lost,
            after.false_run,
            after.n_false
        );
        demands.demand(after.lost <= 5, || {
            format!(
                "{name}: a robot is lost for {} frames on {floor:?}",
                after.lost
            )
        });
        demands.demand(after.false_run <= 15, || {
            format!(
                "{name}: false objects for {} frames on {floor:?}",
                after.false_run
            )
        });
    }
    demands.check();
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_longer_exposure_is_followed() {
    step("exposure +30 %", [1.3; 3]);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_shorter_exposure_is_followed() {
    step("exposure -30 %", [0.7; 3]);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_white_balance_step_is_followed() {
    step("white balance", [1.15, 1.0, 0.85]);
}

/// Frames in the dark.
const DARK: usize = 40;

/// A handful.
const FALSE_OBJECTS_MAX: usize = 5;

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn lights_off_and_on_leave_no_mark() {
    println!("lights off and on: floor, robots back after, false objects, in the last second");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let after = play(floor, DARK + 3 * RATE_HZ, |since| {
            Light::exposure(if since < DARK { 0.03 } else { 1.0 })
        });
        let back = after.back.saturating_sub(DARK);
        println!(
            "  {:10} {back:3} {:3} {:3}",
            format!("{floor:?}"),
            after.n_false,
            after.n_false_late
        );
        demands.demand(back <= RATE_HZ, || {
            format!("robots are back {back} frames after the light on {floor:?}")
        });
        demands.demand(after.n_false <= FALSE_OBJECTS_MAX, || {
            format!("{} false objects on {floor:?}", after.n_false)
        });
        demands.demand(after.n_false_late == 0, || {
            format!(
                "{} false objects in the last second on {floor:?}",
                after.n_false_late
            )
        });
    }
    demands.check();
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn robots_are_back_a_second_after_a_second_lamp() {
    println!("a second lamp: floor, robots back after, false objects, in the last second");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let lamp = Light {
            lamp: 0.5,
            ..Light::EVEN
        };
        let after = play(floor, 4 * RATE_HZ, |_| lamp);
        println!(
            "  {:10} {:3} {:3} {:3}",
            format!("{floor:?}"),
            after.back,
            after.n_false,
            after.n_false_late
        );
        demands.demand(after.back <= RATE_HZ, || {
            format!("robots are back after {} frames on {floor:?}", after.back)
        });
    }
    demands.check();
}
