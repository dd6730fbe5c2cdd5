//! One thing is one object, however it is coloured; two things stay two.

use crate::body::{BLACK, BLUE, Body, Colour, Paint, RED, Shape, WHITE, YELLOW};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Judged, MaskScore};
use crate::light::Light;
use crate::play::Play;
use crate::table::{DrawnScene, Figures, SIZE, per_frame};

type Thing = (Shape, Paint);

pub(crate) const SCENES: &[DrawnScene] = &[
    ("whole-half-like-floor", |floor| {
        one_each(floor, |floor| {
            let like = |by: f32| floor.map(|c| c + by);
            [
                (Shape::Box(60.0, 40.0), Paint::Halves(RED, like(5.0))),
                (Shape::Box(56.0, 44.0), Paint::Halves(like(-6.0), WHITE)),
                (Shape::Disc(26.0), Paint::Halves(BLUE, like(4.0))),
            ]
        })
    }),
    ("whole-two-colours", |floor| {
        one_each(floor, |_| {
            [
                (Shape::Box(60.0, 40.0), Paint::Halves(RED, WHITE)),
                (Shape::Box(56.0, 44.0), Paint::Halves(BLACK, YELLOW)),
                (Shape::Disc(26.0), Paint::Halves(BLUE, BLACK)),
            ]
        })
    }),
    ("whole-stripe-3px", |floor| {
        one_each(floor, |floor| striped(floor, 3.0))
    }),
    ("whole-stripe-8px", |floor| {
        one_each(floor, |floor| striped(floor, 8.0))
    }),
    ("whole-rings", |floor| {
        one_each(floor, |_| {
            [
                (Shape::Ring(34.0, 22.0), Paint::Plain(WHITE)),
                (Shape::Ring(28.0, 20.0), Paint::Plain(RED)),
                (Shape::Ring(24.0, 12.0), Paint::Plain(BLACK)),
            ]
        })
    }),
    ("whole-touching", touching),
];

/// A stripe in the colour of the floor across each thing.
fn striped(floor: Colour, width: f32) -> [Thing; 3] {
    [
        (Shape::Box(60.0, 40.0), Paint::Striped(RED, floor, width)),
        (Shape::Box(56.0, 44.0), Paint::Striped(WHITE, floor, width)),
        (Shape::Disc(26.0), Paint::Striped(BLUE, floor, width)),
    ]
}

/// Counts the frames in which each of some things is exactly one object.
fn one_each(floor: Floor, things: fn(Colour) -> [Thing; 3]) -> Figures {
    const FRAMES: usize = 12;
    let empty = Canvas::new(floor, SIZE);
    let things = things(empty.mean());
    let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
    let (mut mask, mut whole, mut n_false) = (MaskScore::default(), 0, 0);
    for frame in 0..FRAMES {
        let place = |(i, (shape, paint)): (usize, Thing)| Body {
            shape,
            paint,
            at: [60.0 + 95.0 * i as f32 + frame as f32, 120.0],
            heading_rad: 0.4 + i as f32 + 0.05 * frame as f32,
        };
        let bodies: Vec<_> = things.into_iter().enumerate().map(place).collect();
        let canvas = empty.with(&bodies, &[]);
        let judged = Judged::new(play.show(&canvas, &Light::EVEN), &canvas);
        // Half a robot is found where the other half looks like the floor, but never twice.
        let each = |body: &Body| {
            let inside = judged
                .observed
                .iter()
                .filter(|(object, _)| body.contains([object.x as f32, object.y as f32]));
            inside.count() == 1
        };
        whole += usize::from(judged.observed.len() == 3 && bodies.iter().all(each));
        mask.add(&judged);
        n_false += judged.false_objects().count();
    }
    Figures {
        f: Some(mask.f_measure()),
        whole: per_frame(whole, FRAMES),
        n_false: per_frame(n_false, FRAMES),
        ..Figures::default()
    }
}

/// Two robots meet, stand against each other for longer than a track lives without being seen, and
/// part: in which share of the frames both tracks are there, and how long after the parting each
/// robot has its own again.
fn touching(floor: Floor) -> Figures {
    const MEET: usize = 20;
    const PART: usize = MEET + 12;
    let empty = Canvas::new(floor, SIZE);
    let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
    let mut tracks = Vec::new();
    let (mut kept, mut third) = (0, 0);
    let mut recovered = 0;
    for frame in 0..PART + MEET {
        let way_px = 3.0 * MEET.saturating_sub(frame).max(frame.saturating_sub(PART)) as f32;
        let robot = |paint, x| Body {
            shape: Shape::Box(40.0, 40.0),
            paint,
            at: [x, 120.0],
            heading_rad: 0.0,
        };
        // Their edges overlap by a pixel when they meet.
        let bodies = [
            robot(Paint::Plain(RED), 140.0 - way_px),
            robot(Paint::Plain(WHITE), 179.0 + way_px),
        ];
        let canvas = empty.with(&bodies, &[]);
        let scene = play.show(&canvas, &Light::EVEN);
        let track_at = |body: &Body| {
            let near = scene
                .objects()
                .iter()
                .find(|o| body.contains([o.x as f32, o.y as f32]));
            near.map(|object| object.track)
        };
        if frame == MEET / 2 {
            tracks = bodies.iter().filter_map(track_at).collect();
        }
        if frame > MEET / 2 {
            let there = |track: &u64| scene.objects().iter().any(|o| o.track == *track);
            kept += usize::from(tracks.len() == 2 && tracks.iter().all(there));
            third += scene.objects().len().saturating_sub(2);
        }
        if frame >= PART
            && !bodies
                .iter()
                .filter_map(track_at)
                .eq(tracks.iter().copied())
        {
            recovered = frame - PART + 1;
        }
    }
    let frames = PART + MEET / 2 - 1;
    Figures {
        whole: per_frame(kept, frames),
        n_false: per_frame(third, frames),
        frames: Some(recovered),
        ..Figures::default()
    }
}
