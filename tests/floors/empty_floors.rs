//! Where nothing stands, nothing is found.

use crate::body::{Body, Paint, Shape, WHITE};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Demands, Judged};
use crate::light::Light;
use crate::play::Play;
use crate::random::at_point;
use crate::table::{DrawnScene, Figures, SIZE, per_frame};

/// Frames of a scene of the table.
const FRAMES: usize = 40;

pub(crate) const SCENES: &[DrawnScene] = &[
    ("empty-noise-6", |floor| {
        watched(floor, 6.0, Encoding::Rgb, |_| Light::EVEN)
    }),
    ("empty-grey-noise-6", |floor| {
        watched(floor, 6.0, Encoding::Grey, |_| Light::EVEN)
    }),
    ("empty-4:2:0-noise-6", |floor| {
        watched(floor, 6.0, Encoding::I420, |_| Light::EVEN)
    }),
    ("empty-flicker-2%", |floor| {
        watched(floor, 3.0, Encoding::Rgb, flicker)
    }),
    ("empty-litter", litter),
];

/// That of the mains.
fn flicker(frame: usize) -> Light {
    Light::exposure(1.0 + 0.02 * at_point(50, frame as i64, 0))
}

fn watched(floor: Floor, noise: f32, encoding: Encoding, light: fn(usize) -> Light) -> Figures {
    let empty = Canvas::new(floor, SIZE);
    let mut play = Play::learned(Camera::new(noise, encoding), &empty);
    Figures {
        n_false: per_frame(count(&mut play, &empty, light, FRAMES), FRAMES),
        ..Figures::default()
    }
}

/// Chips of 7 px, each smaller than the smallest object that counts.
fn litter(floor: Floor) -> Figures {
    let empty = Canvas::new(floor, SIZE);
    let chip = |i: usize| Body {
        shape: Shape::Box(7.0, 7.0),
        paint: Paint::Plain(WHITE),
        at: [40.0 + 80.0 * i as f32, 60.0 + 30.0 * i as f32],
        heading_rad: 0.3 * i as f32,
    };
    let littered = empty.with(&[0, 1, 2, 3].map(chip), &[]).as_floor();
    let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
    Figures {
        n_false: per_frame(count(&mut play, &littered, |_| Light::EVEN, FRAMES), FRAMES),
        ..Figures::default()
    }
}

/// Objects on a floor without any.
fn count(play: &mut Play, empty: &Canvas, light: fn(usize) -> Light, frames: usize) -> usize {
    let of_frame = |frame| {
        let scene = play.show(empty, &light(frame));
        Judged::new(scene, empty).false_objects().count()
    };
    (0..frames).map(of_frame).sum()
}

#[test]
#[ignore = "slow: FLOORS_FRAMES=5000 cargo test --test floors empty -- --ignored --nocapture"]
fn empty_floors_stay_empty_for_long() {
    let frames = std::env::var("FLOORS_FRAMES").map_or(1000, |frames| {
        frames.parse().expect("FLOORS_FRAMES is a number of frames")
    });
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let empty = Canvas::new(floor, SIZE);
        for (noise, encoding, light) in [
            (6.0, Encoding::Rgb, (|_| Light::EVEN) as fn(usize) -> Light),
            (6.0, Encoding::Grey, |_| Light::EVEN),
            (6.0, Encoding::I420, |_| Light::EVEN),
            (3.0, Encoding::Rgb, flicker),
        ] {
            let mut play = Play::learned(Camera::new(noise, encoding), &empty);
            let n_false = count(&mut play, &empty, light, frames);
            println!("{floor:?}, {encoding:?}, noise {noise}: {n_false} in {frames} frames");
            demands.demand(1000 * n_false <= frames, || {
                format!("{n_false} false objects in {frames} frames on {floor:?}, {encoding:?}")
            });
        }
    }
    demands.check();
}
