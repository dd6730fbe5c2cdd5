//! Slow drift, in a small picture: a minute of it for the table, and a day.

use imgproc::Size;

use crate::body::{BLACK, Body, Paint, Shape};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Demands, Judged, LongestRun, MaskScore};
use crate::light::Light;
use crate::play::{Play, RATE_HZ};
use crate::table::{DrawnScene, Figures, per_frame};

const SIZE: Size = Size {
    width: 96,
    height: 72,
};

const FRAMES: usize = 50_000;

/// Frames after the robots left in which their places may still look strange.
const GHOST: usize = 3 * RATE_HZ;

pub(crate) const SCENES: &[DrawnScene] = &[("light-drift", drift)];

/// Frames of the table's scene.
const DRIFT_FRAMES: usize = 1800;

/// Less light, and more of it on one side, as fast as the floor can follow. In the end the robots
/// are gone, and their places must not be objects.
fn drift(floor: Floor) -> Figures {
    let parked = robots();
    let empty = Canvas::new(floor, SIZE);
    let with_robots = empty.with(&parked, &[]);
    let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
    let (mut mask, mut n_seen, mut n_false, mut ghosts) = (MaskScore::default(), 0, 0, 0);
    for frame in 0..DRIFT_FRAMES + GHOST {
        let way = frame.min(DRIFT_FRAMES) as f32 / DRIFT_FRAMES as f32;
        let light = Light {
            slope: [0.3 * way, 0.0],
            ..Light::exposure(1.0 - 0.3 * way)
        };
        let here = frame < DRIFT_FRAMES;
        let canvas = if here { &with_robots } else { &empty };
        let judged = Judged::new(play.show(canvas, &light), canvas);
        let false_here = judged.false_objects().count();
        n_false += false_here;
        if here {
            mask.add(&judged);
            n_seen += (0..parked.len()).filter(|&i| judged.sees(i)).count();
        } else if false_here > 0 {
            ghosts = frame - DRIFT_FRAMES + 1;
        }
    }
    Figures {
        f: Some(mask.f_measure()),
        whole: per_frame(n_seen, DRIFT_FRAMES * parked.len()),
        n_false: per_frame(n_false, DRIFT_FRAMES + GHOST),
        frames: Some(ghosts),
        ..Figures::default()
    }
}

fn robots() -> [Body; 2] {
    let robot = |shape, paint, at| Body {
        shape,
        paint,
        at,
        heading_rad: 0.3,
    };
    [
        robot(Shape::Box(20.0, 20.0), Paint::Plate(20.0), [26.0, 24.0]),
        robot(Shape::Disc(10.0), Paint::Plain(BLACK), [70.0, 48.0]),
    ]
}

/// Down to six tenths of the light and back, redder on the way, brighter on one side and then on
/// another.
fn light(frame: usize) -> Light {
    let day = frame as f32 / FRAMES as f32;
    let dim = 0.8 + 0.2 * (std::f32::consts::TAU * day).cos();
    let evening = 0.06 * (std::f32::consts::PI * day).sin();
    let (east, west) = (std::f32::consts::TAU * 3.0 * day).sin_cos();
    Light {
        gain: [dim * (1.0 + evening), dim, dim * (1.0 - evening)],
        slope: [0.25 * east, 0.25 * (west - 1.0) / 2.0],
        lamp: 0.0,
    }
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors day -- --ignored"]
fn robots_parked_for_a_day_are_neither_lost_nor_absorbed() {
    let parked = robots();
    let empty = Canvas::new(Floor::Concrete, SIZE);
    let with_robots = empty.with(&parked, &[]);
    let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
    let (mut lost, mut n_lost, mut n_false) = ([LongestRun::default(); 2], 0, 0);
    for frame in 0..FRAMES {
        let judged = Judged::new(play.show(&with_robots, &light(frame)), &with_robots);
        for (robot, lost) in lost.iter_mut().enumerate() {
            let sees = judged.sees(robot);
            lost.add(!sees);
            n_lost += usize::from(!sees);
        }
        n_false += judged.false_objects().count();
    }
    let drive_off = 10;
    let (mut ghost, mut n_ghosts) = (0, 0);
    for frame in 0..drive_off + 2 * GHOST {
        // To the left and to the right, out of the picture.
        let way_px = 6.0 * frame as f32;
        let canvas = if frame < drive_off {
            let [left, right] = parked;
            let bodies = [
                left.moved_to([left.at[0] - way_px, left.at[1]]),
                right.moved_to([right.at[0] + way_px, right.at[1]]),
            ];
            empty.with(&bodies, &[])
        } else {
            empty.clone()
        };
        let judged = Judged::new(play.show(&canvas, &light(FRAMES)), &canvas);
        let here = judged.false_objects().count();
        if here > 0 {
            ghost = frame.saturating_sub(drive_off) + 1;
        }
        if frame >= drive_off + GHOST {
            n_ghosts += here;
        }
    }
    let longest = lost.iter().map(|run| run.longest).max().unwrap_or(0);
    println!(
        "{FRAMES} frames of drift: lost in {n_lost} frames, for {longest} at most, {n_false} false objects, ghosts for {ghost} frames"
    );
    let mut demands = Demands::default();
    demands.demand(n_lost == 0, || {
        format!("a robot is not seen in {n_lost} frames")
    });
    demands.demand(1000 * n_false <= FRAMES, || {
        format!("{n_false} false objects")
    });
    demands.demand(n_ghosts == 0, || format!("ghosts for {ghost} frames"));
    demands.check();
}
