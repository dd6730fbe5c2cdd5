//! The shapes of objects, pixel by pixel, without shadows.

use imgproc::Size;

use crate::body::{BLACK, BLUE, BROWN, Body, Colour, GREEN, Paint, RED, Shape, WHITE, YELLOW};
use crate::camera::{Camera, Encoding, luma};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Demands, Judged, MaskScore};
use crate::light::Light;
use crate::play::Play;

pub(crate) const VGA: Size = Size {
    width: 640,
    height: 480,
};

/// Frames that are judged.
const FRAMES: usize = 6;

/// Columns and rows of the grid on which things stand.
const GRID: [usize; 2] = [4, 3];

/// Everything that may stand on a floor of this mean colour, 16 to 120 px large, each at home in a cell of its own.
pub(crate) fn things(floor: Colour) -> Vec<Body> {
    let brighter = [1.1 * luma(floor); 3];
    [
        (Shape::Box(40.0, 40.0), Paint::Plain(WHITE)),
        (Shape::Disc(30.0), Paint::Plain(BLACK)),
        (Shape::L(64.0, 24.0), Paint::Plain(RED)),
        (Shape::Box(48.0, 30.0), Paint::Plain(GREEN)),
        (Shape::Disc(16.0), Paint::Plain(BLUE)),
        (Shape::Box(40.0, 40.0), Paint::Plain(brighter)),
        (Shape::Box(80.0, 50.0), Paint::Plain(BROWN)),
        (Shape::Disc(22.0), Paint::Patches(YELLOW)),
        (Shape::Box(16.0, 16.0), Paint::Plain(WHITE)),
        (Shape::Box(56.0, 56.0), Paint::Plate(56.0)),
        (Shape::Box(120.0, 60.0), Paint::Halves(BLUE, WHITE)),
        (Shape::L(44.0, 18.0), Paint::Plain(BLACK)),
    ]
    .into_iter()
    .enumerate()
    .map(|(cell, (shape, paint))| Body {
        shape,
        paint,
        at: cell_centre(cell),
        heading_rad: 0.4 * cell as f32,
    })
    .collect()
}

/// Middle of a cell of the grid in a VGA picture.
pub(crate) fn cell_centre(cell: usize) -> [f32; 2] {
    let place = |index: usize, cells: usize, length: usize| {
        (index as f32 + 0.5) * length as f32 / cells as f32 - 0.5
    };
    [
        place(cell % GRID[0], GRID[0], VGA.width),
        place(cell / GRID[0], GRID[1], VGA.height),
    ]
}

/// Everything a little further on its way: circles of 11 px, each begun elsewhere, turning.
pub(crate) fn moved(bodies: &[Body], frame: usize) -> Vec<Body> {
    let step = |(i, body): (usize, &Body)| {
        let (sin, cos) = (0.3 * frame as f32 + i as f32).sin_cos();
        Body {
            at: [body.at[0] + 11.0 * cos, body.at[1] + 11.0 * sin],
            heading_rad: body.heading_rad + 0.05 * frame as f32,
            ..*body
        }
    };
    bodies.iter().enumerate().map(step).collect()
}

/// Scores the masks of bodies on every floor.
fn score(
    name: &str,
    noise: f32,
    encoding: Encoding,
    f_min: Option<f64>,
    bodies: impl Fn(Colour) -> Vec<Body>,
) {
    println!("{name}: floor, noise, F, precision, recall, false objects a frame");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let empty = Canvas::new(floor, VGA);
        let bodies = bodies(empty.mean());
        let mut play = Play::learned(Camera::new(noise, encoding), &empty);
        let (mut mask, mut n_false) = (MaskScore::default(), 0);
        for frame in 0..FRAMES {
            let canvas = empty.with(&moved(&bodies, frame), &[]);
            let judged = Judged::new(play.show(&canvas, &Light::EVEN), &canvas);
            mask.add(&judged);
            n_false += judged.false_objects().count();
        }
        let f = mask.f_measure();
        println!(
            "  {:10} {noise:4} {f:6.3} {:6.3} {:6.3} {:6.2}",
            format!("{floor:?}"),
            mask.precision(),
            mask.recall(),
            n_false as f64 / FRAMES as f64
        );
        if let Some(f_min) = f_min {
            demands.demand(f >= f_min, || format!("{name}: F {f:.3} on {floor:?}"));
        }
    }
    demands.check();
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn masks_are_exact_on_every_floor() {
    score("colour", 3.0, Encoding::Rgb, Some(0.97), things);
}

#[test]
#[ignore = "demands nothing: cargo test --test floors reported -- --ignored --nocapture"]
fn masks_at_other_noise_are_reported() {
    for noise in [1.0, 6.0, 12.0] {
        score("colour", noise, Encoding::Rgb, None, things);
    }
    score("JPEG 60", 3.0, Encoding::Jpeg(60), None, things);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_grey_camera_sees_what_differs_in_grey() {
    let contrasting = |floor: Colour| {
        let mut bodies = things(floor);
        bodies.retain(|body| {
            let differs = |colour| (luma(colour) - luma(floor)).abs() >= 40.0;
            match body.paint {
                Paint::Plain(colour) | Paint::Patches(colour) => differs(colour),
                Paint::Halves(a, b) => differs(a) && differs(b),
                Paint::Plate(_) | Paint::Striped(..) => true,
            }
        });
        bodies
    };
    score("grey", 3.0, Encoding::Grey, Some(0.97), contrasting);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn chroma_of_every_second_pixel_suffices() {
    score("4:2:0", 3.0, Encoding::I420, Some(0.95), things);
    score("4:2:2", 3.0, Encoding::Yuyv, Some(0.95), things);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn jpeg_suffices() {
    score("JPEG 80", 3.0, Encoding::Jpeg(80), Some(0.95), things);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_box_a_tenth_brighter_than_a_grey_floor_is_found() {
    let mut demands = Demands::default();
    for noise in [3.0, 6.0] {
        let size = Size {
            width: 320,
            height: 240,
        };
        let empty = Canvas::new(Floor::Grey, size);
        let mut play = Play::learned(Camera::new(noise, Encoding::Rgb), &empty);
        let mut seen = 0;
        for frame in 0..20 {
            let body = Body {
                shape: Shape::Box(40.0, 40.0),
                paint: Paint::Plain([132.0; 3]),
                at: [80.0 + 4.0 * frame as f32, 120.0],
                heading_rad: 0.1 * frame as f32,
            };
            let canvas = empty.with(&[body], &[]);
            let judged = Judged::new(play.show(&canvas, &Light::EVEN), &canvas);
            seen += usize::from(judged.sees(0) && judged.false_objects().count() == 0);
        }
        println!("a box a tenth brighter at noise {noise}: alone and whole in {seen} of 20 frames");
        demands.demand(seen == 20, || format!("noise {noise}: {seen} of 20 frames"));
    }
    demands.check();
}
