//! The light or the camera changes at once.

use crate::body::{BLACK, Body, Paint, RED, Shape};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Judged, MaskScore};
use crate::light::Light;
use crate::play::{Play, RATE_HZ};
use crate::table::{DrawnScene, Figures, SIZE, per_frame};

/// Frames before something changes.
const BEFORE: usize = 10;

const ROBOTS: usize = 3;

/// A parked plate, a parked black disc and a red box that drives.
fn robots(frame: usize) -> [Body; ROBOTS] {
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

/// Frames in the dark.
const DARK: usize = 20;

/// Frames beneath a second lamp.
const LAMP: usize = 45;

pub(crate) const SCENES: &[DrawnScene] = &[
    ("light-longer-exposure", |floor| {
        after(floor, 0, 30, |_| Light::exposure(1.3))
    }),
    ("light-shorter-exposure", |floor| {
        after(floor, 0, 30, |_| Light::exposure(0.7))
    }),
    ("light-white-balance", |floor| {
        after(floor, 0, 30, |_| Light {
            gain: [1.15, 1.0, 0.85],
            ..Light::EVEN
        })
    }),
    ("light-off-and-on", |floor| {
        after(floor, DARK, RATE_HZ, |since| {
            Light::exposure(if since < DARK { 0.03 } else { 1.0 })
        })
    }),
    ("light-second-lamp", |floor| {
        after(floor, 0, LAMP, |_| lamp())
    }),
    ("light-second-lamp-off", |floor| {
        after(floor, LAMP, RATE_HZ, |since| {
            if since < LAMP { lamp() } else { Light::EVEN }
        })
    }),
];

fn lamp() -> Light {
    Light {
        lamp: 0.5,
        ..Light::EVEN
    }
}

/// Shows robots on a floor; the light is a function of the frame since the first change. Judging
/// begins `wait` frames later, with the last change: how long it takes until all robots are seen,
/// and nothing else.
fn after(floor: Floor, wait: usize, frames: usize, light: fn(usize) -> Light) -> Figures {
    let empty = Canvas::new(floor, SIZE);
    let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
    let mut mask = MaskScore::default();
    let (mut n_seen, mut n_false, mut recovered) = (0, 0, 0);
    for frame in 0..BEFORE + wait + frames {
        let canvas = empty.with(&robots(frame), &[]);
        let since = frame.checked_sub(BEFORE);
        let scene = play.show(&canvas, &since.map_or(Light::EVEN, light));
        let Some(since) = since.and_then(|since| since.checked_sub(wait)) else {
            continue;
        };
        let judged = Judged::new(scene, &canvas);
        mask.add(&judged);
        let seen = (0..ROBOTS).filter(|&robot| judged.sees(robot)).count();
        let here = judged.false_objects().count();
        if seen < ROBOTS || here > 0 {
            recovered = since + 1;
        }
        n_seen += seen;
        n_false += here;
    }
    Figures {
        f: Some(mask.f_measure()),
        whole: per_frame(n_seen, frames * ROBOTS),
        n_false: per_frame(n_false, frames),
        frames: Some(recovered),
        ..Figures::default()
    }
}
