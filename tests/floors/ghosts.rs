//! Things that stood on the floor when its picture was taken, and leave.

use crate::body::{BLACK, Body, Paint, RED, Shape};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::Judged;
use crate::light::Light;
use crate::play::{Play, RATE_HZ};
use crate::table::{DrawnScene, Figures, SIZE, per_frame};

/// Frame in which the things that are in the background leave.
const LEAVING: usize = 10;

const FRAMES: usize = LEAVING + 2 * RATE_HZ;

pub(crate) const SCENES: &[DrawnScene] = &[
    ("ghosts-learned", |floor| leave(floor, Play::learned)),
    ("ghosts-given", |floor| leave(floor, Play::given)),
];

/// Two things that are in the background leave, and a parked robot stays: how long their places are
/// objects, and in which share of the frames the robot is seen.
fn leave(floor: Floor, begin: fn(Camera, &Canvas) -> Play) -> Figures {
    let body = |shape, paint, at| Body {
        shape,
        paint,
        at,
        heading_rad: 0.3,
    };
    let leaving = [
        body(Shape::Box(40.0, 40.0), Paint::Plate(40.0), [80.0, 90.0]),
        body(Shape::Disc(18.0), Paint::Plain(BLACK), [230.0, 60.0]),
    ];
    let parked = body(Shape::Box(40.0, 30.0), Paint::Plain(RED), [170.0, 180.0]);
    let empty = Canvas::new(floor, SIZE);
    // What stands in the background is not reported: only the parked robot is true.
    let background = empty.with(&leaving, &[]).as_floor();
    let before = background.with(&[parked], &[]);
    let after = empty.with(&[parked], &[]);
    let mut play = begin(Camera::new(3.0, Encoding::Rgb), &background);
    let (mut n_seen, mut n_false, mut freed) = (0, 0, 0);
    for frame in 0..FRAMES {
        let canvas = if frame < LEAVING { &before } else { &after };
        let judged = Judged::new(play.show(canvas, &Light::EVEN), canvas);
        n_seen += usize::from(judged.sees(0));
        let here = judged.false_objects().count();
        if frame >= LEAVING && here > 0 {
            freed = frame - LEAVING + 1;
        }
        n_false += here;
    }
    Figures {
        whole: per_frame(n_seen, FRAMES),
        n_false: per_frame(n_false, FRAMES),
        frames: Some(freed),
        ..Figures::default()
    }
}
