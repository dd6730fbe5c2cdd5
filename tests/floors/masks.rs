//! The shapes of objects, pixel by pixel, without shadows.

use crate::body::{BLACK, BLUE, BROWN, Body, Colour, GREEN, Paint, RED, Shape, WHITE, YELLOW};
use crate::camera::{Camera, Encoding, luma};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Judged, MaskScore};
use crate::light::Light;
use crate::play::Play;
use crate::table::{DrawnScene, Figures, SIZE, per_frame};

/// Frames that are judged.
pub(crate) const FRAMES: usize = 6;

/// Columns and rows of the grid on which things stand.
const GRID: [usize; 2] = [3, 2];

pub(crate) const SCENES: &[DrawnScene] = &[
    ("masks-noise-1", |floor| {
        score(floor, 1.0, Encoding::Rgb, all)
    }),
    ("masks-noise-3", |floor| {
        score(floor, 3.0, Encoding::Rgb, all)
    }),
    ("masks-noise-6", |floor| {
        score(floor, 6.0, Encoding::Rgb, all)
    }),
    ("masks-noise-12", |floor| {
        score(floor, 12.0, Encoding::Rgb, all)
    }),
    ("masks-grey", |floor| {
        score(floor, 3.0, Encoding::Grey, contrasts)
    }),
    ("masks-4:2:0", |floor| {
        score(floor, 3.0, Encoding::I420, all)
    }),
    ("masks-4:2:2", |floor| {
        score(floor, 3.0, Encoding::Yuyv, all)
    }),
    ("masks-jpeg-80", |floor| {
        score(floor, 3.0, Encoding::Jpeg(80), all)
    }),
    ("masks-jpeg-60", |floor| {
        score(floor, 3.0, Encoding::Jpeg(60), all)
    }),
    ("faint-box-noise-3", |floor| faint_box(floor, 3.0)),
    ("faint-box-noise-6", |floor| faint_box(floor, 6.0)),
];

fn all(_: &Body, _: Colour) -> bool {
    true
}

/// Everything that may stand on a floor of this mean colour, 16 to 84 px large: two grids full.
fn things(floor: Colour) -> Vec<Body> {
    let brighter = [1.1 * luma(floor); 3];
    [
        (Shape::Box(40.0, 40.0), Paint::Plain(WHITE)),
        (Shape::Disc(30.0), Paint::Plain(BLACK)),
        (Shape::L(64.0, 24.0), Paint::Plain(RED)),
        (Shape::Box(48.0, 30.0), Paint::Plain(GREEN)),
        (Shape::Disc(16.0), Paint::Plain(BLUE)),
        (Shape::Box(40.0, 40.0), Paint::Plain(brighter)),
        (Shape::Box(76.0, 48.0), Paint::Plain(BROWN)),
        (Shape::Disc(22.0), Paint::Patches(YELLOW)),
        (Shape::Box(16.0, 16.0), Paint::Plain(WHITE)),
        (Shape::Box(56.0, 56.0), Paint::Plate(56.0)),
        (Shape::L(44.0, 18.0), Paint::Plain(BLACK)),
        (Shape::Box(84.0, 42.0), Paint::Halves(BLUE, WHITE)),
    ]
    .into_iter()
    .enumerate()
    .map(|(i, (shape, paint))| Body {
        shape,
        paint,
        at: cell_centre(i),
        heading_rad: 0.4 * i as f32,
    })
    .collect()
}

/// The things of a frame: the first grid in the first half of the frames, the second in the second.
pub(crate) fn things_of(frame: usize, floor: Colour) -> Vec<Body> {
    let cells = GRID[0] * GRID[1];
    let first = if frame < FRAMES / 2 { 0 } else { cells };
    things(floor)[first..][..cells].to_vec()
}

/// Middle of the cell for thing number `i`; the last cell is followed by the first.
pub(crate) fn cell_centre(i: usize) -> [f32; 2] {
    let [columns, rows] = GRID;
    let place = |index: usize, cells: usize, length: usize| {
        (index as f32 + 0.5) * length as f32 / cells as f32 - 0.5
    };
    [
        place(i % columns, columns, SIZE.width),
        place(i / columns % rows, rows, SIZE.height),
    ]
}

/// Everything a little further on its way: circles of 8 px, each begun elsewhere, turning.
pub(crate) fn moved(bodies: &[Body], frame: usize) -> Vec<Body> {
    let step = |(i, body): (usize, &Body)| {
        let (sin, cos) = (0.3 * frame as f32 + i as f32).sin_cos();
        Body {
            at: [body.at[0] + 8.0 * cos, body.at[1] + 8.0 * sin],
            heading_rad: body.heading_rad + 0.05 * frame as f32,
            ..*body
        }
    };
    bodies.iter().enumerate().map(step).collect()
}

/// Whether a camera without colours can tell a thing from a floor.
fn contrasts(body: &Body, floor: Colour) -> bool {
    let differs = |colour| (luma(colour) - luma(floor)).abs() >= 40.0;
    match body.paint {
        Paint::Plain(colour) | Paint::Patches(colour) => differs(colour),
        Paint::Halves(a, b) => differs(a) && differs(b),
        Paint::Plate(_) | Paint::Striped(..) => true,
    }
}

/// Scores the masks of things that move.
fn score(
    floor: Floor,
    noise: f32,
    encoding: Encoding,
    stands: fn(&Body, Colour) -> bool,
) -> Figures {
    let empty = Canvas::new(floor, SIZE);
    let colour = empty.mean();
    let mut play = Play::learned(Camera::new(noise, encoding), &empty);
    let (mut mask, mut n_false) = (MaskScore::default(), 0);
    for frame in 0..FRAMES {
        let mut bodies = moved(&things_of(frame, colour), frame);
        bodies.retain(|body| stands(body, colour));
        let canvas = empty.with(&bodies, &[]);
        let judged = Judged::new(play.show(&canvas, &Light::EVEN), &canvas);
        mask.add(&judged);
        n_false += judged.false_objects().count();
    }
    Figures {
        f: Some(mask.f_measure()),
        n_false: per_frame(n_false, FRAMES),
        ..Figures::default()
    }
}

/// A grey box that is a tenth brighter than the floor: in how many frames it is alone and whole.
fn faint_box(floor: Floor, noise: f32) -> Figures {
    const FRAMES: usize = 20;
    let empty = Canvas::new(floor, SIZE);
    let mut play = Play::learned(Camera::new(noise, Encoding::Rgb), &empty);
    let (mut n_seen, mut n_false) = (0, 0);
    for frame in 0..FRAMES {
        let body = Body {
            shape: Shape::Box(40.0, 40.0),
            paint: Paint::Plain([1.1 * luma(empty.mean()); 3]),
            at: [80.0 + 4.0 * frame as f32, 120.0],
            heading_rad: 0.1 * frame as f32,
        };
        let canvas = empty.with(&[body], &[]);
        let judged = Judged::new(play.show(&canvas, &Light::EVEN), &canvas);
        n_seen += usize::from(judged.sees(0));
        n_false += judged.false_objects().count();
    }
    Figures {
        whole: per_frame(n_seen, FRAMES),
        n_false: per_frame(n_false, FRAMES),
        ..Figures::default()
    }
}
