//! Shadows are no objects, and black things are no shadows.
//!
//! What counts as soft and hard is decided by the light that is left at each pixel, so that the
//! penumbra of a hard shadow counts as what it is.

use overcam::image::frame::Frame;

use crate::body::{BLACK, Body, Paint, Shape};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Judged, MaskScore, Share};
use crate::light::Light;
use crate::masks::{FRAMES, cell_centre, moved, things_of};
use crate::play::Play;
use crate::shadow::{Shadow, bluish, neutral};
use crate::table::{DrawnScene, Figures, SIZE, per_frame};

/// Light left on the floor.
const SOFT: std::ops::RangeInclusive<f32> = 0.5..=0.9;
const HARD: std::ops::RangeInclusive<f32> = 0.1..=0.4;

pub(crate) const SCENES: &[DrawnScene] = &[
    ("shadows-soft", |floor| {
        judge(floor, Kind::Soft, Encoding::Rgb)
    }),
    ("shadows-hard", |floor| {
        judge(floor, Kind::Hard, Encoding::Rgb)
    }),
    ("shadows-soft-grey", |floor| {
        judge(floor, Kind::Soft, Encoding::Grey)
    }),
    ("shadows-soft-4:2:0", |floor| {
        judge(floor, Kind::Soft, Encoding::I420)
    }),
    ("shadows-hard-jpeg-80", |floor| {
        judge(floor, Kind::Hard, Encoding::Jpeg(80))
    }),
];

/// Things in all columns but the last, to whose right there is nothing that a shadow would fall on.
fn objects(frame: usize, empty: &Canvas) -> Vec<Body> {
    let all = moved(&things_of(frame, empty.mean()), frame);
    let standing = all.iter().enumerate().filter(|(cell, _)| cell % 3 != 2);
    standing.map(|(_, body)| *body).collect()
}

/// One from each thing, and two that wander alone.
fn soft(frame: usize, objects: &[Body]) -> Vec<Shadow> {
    let thrown = objects.iter().enumerate().map(|(i, body)| {
        let left = [0.52, 0.6, 0.7, 0.8, 0.88][i % 5];
        let left = if i % 2 == 0 {
            neutral(left)
        } else {
            bluish(left)
        };
        Shadow::of(body, [22.0, 13.0], left, [0.0, 4.0, 12.0][i % 3])
    });
    let alone = alone(
        frame,
        [
            (neutral(0.55), 0.0),
            (bluish(0.65), 4.0),
            (neutral(0.8), 12.0),
        ],
    );
    thrown.chain(alone).collect()
}

/// The same under a lamp or the sun.
fn hard(frame: usize, objects: &[Body]) -> Vec<Shadow> {
    let thrown = objects.iter().enumerate().map(|(i, body)| {
        let left = [0.13, 0.2, 0.28, 0.36][i % 4];
        let left = if i % 2 == 0 {
            neutral(left)
        } else {
            bluish(left)
        };
        Shadow::of(body, [22.0, 13.0], left, [0.0, 2.0][i % 2])
    });
    let alone = alone(
        frame,
        [
            (neutral(0.15), 0.0),
            (bluish(0.25), 2.0),
            (neutral(0.36), 0.0),
        ],
    );
    thrown.chain(alone).collect()
}

/// Shadows of things out of the picture, in the last column: two of three.
fn alone(frame: usize, looks: [([f32; 3], f32); 3]) -> impl Iterator<Item = Shadow> {
    let shapes = [
        Shape::Box(70.0, 44.0),
        Shape::Disc(34.0),
        Shape::L(80.0, 30.0),
    ];
    (0..2).map(move |i| {
        let number = i + usize::from(frame >= FRAMES / 2);
        let (left, penumbra_px) = looks[number];
        let [x, y] = cell_centre(3 * i + 2);
        Shadow {
            shape: shapes[number],
            at: [x + 2.0 * frame as f32 - 8.0, y + frame as f32],
            heading_rad: 0.3 + 0.04 * frame as f32,
            left,
            penumbra_px,
        }
    })
}

/// What lies on the floor beside its objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Soft,
    Hard,
}

impl Kind {
    fn cast(self, frame: usize, objects: &[Body]) -> Vec<Shadow> {
        match self {
            Self::Soft => soft(frame, objects),
            Self::Hard => hard(frame, objects),
        }
    }
}

fn judge(floor: Floor, kind: Kind, encoding: Encoding) -> Figures {
    let empty = Canvas::new(floor, SIZE);
    let mut play = Play::learned(Camera::new(3.0, encoding), &empty);
    let (mut mask, mut n_false) = (MaskScore::default(), 0);
    let [mut black, mut taken] = [Share::default(); 2];
    for frame in 0..FRAMES {
        let objects = objects(frame, &empty);
        let canvas = empty.with(&objects, &kind.cast(frame, &objects));
        let judged = Judged::new(play.show(&canvas, &Light::EVEN), &canvas);
        mask.add(&judged);
        n_false += judged.false_objects().count();
        for (i, body) in objects.iter().enumerate() {
            if matches!(body.paint, Paint::Plain(BLACK)) {
                black.add(judged.recall_of(i));
            }
        }
        taken.add(judged.shadow_taken(if kind == Kind::Soft { SOFT } else { HARD }));
    }
    Figures {
        f: Some(mask.f_measure()),
        black: Some(black.value()),
        shadow: Some(taken.value()),
        n_false: per_frame(n_false, FRAMES),
        ..Figures::default()
    }
}

#[test]
#[ignore = "draws pictures to look at: FLOORS_PICTURES=DIR cargo test --test floors pictures -- --ignored"]
fn pictures_of_the_scenes_are_drawn() {
    let folder = std::env::var_os("FLOORS_PICTURES").expect("FLOORS_PICTURES names a folder");
    let folder = std::path::Path::new(&folder);
    for floor in Floor::ALL {
        let empty = Canvas::new(floor, SIZE);
        for kind in [Kind::Soft, Kind::Hard] {
            let objects = objects(0, &empty);
            let canvas = empty.with(&objects, &kind.cast(0, &objects));
            let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
            let outlines: Vec<_> = play
                .show(&canvas, &Light::EVEN)
                .objects()
                .iter()
                .flat_map(|object| object.outline().to_vec())
                .collect();
            let mut frame = Frame::empty();
            Camera::new(3.0, Encoding::Rgb).expose(&canvas, &Light::EVEN, &mut frame);
            for [x, y] in outlines {
                let (x, y) = (x.max(0.0) as usize, y.max(0.0) as usize);
                let i = 3 * (y.min(SIZE.height - 1) * SIZE.width + x.min(SIZE.width - 1));
                frame.bytes[i..i + 3].copy_from_slice(&[255, 0, 0]);
            }
            let (width, height) = (SIZE.width as u32, SIZE.height as u32);
            let picture = image::RgbImage::from_raw(width, height, frame.bytes);
            let path = folder.join(format!("{floor:?}-{kind:?}.png"));
            let picture = picture.expect("as many bytes as pixels");
            picture.save(path).expect("the folder can be written to");
        }
    }
}
