//! One thing is one object, however it is coloured; two things stay two.

use imgproc::Size;

use crate::body::{BLACK, BLUE, Body, Colour, Paint, RED, Shape, WHITE, YELLOW};
use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Demands, Judged, LongestRun};
use crate::light::Light;
use crate::play::Play;

const SIZE: Size = Size {
    width: 320,
    height: 240,
};

/// Counts the frames in which each of some things is exactly one object.
fn one_each(name: &str, demanded: bool, things: impl Fn(Colour) -> [(Shape, Paint); 3]) {
    const FRAMES: usize = 20;
    println!("{name}: floor, frames of {FRAMES} with exactly one object for each thing");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let empty = Canvas::new(floor, SIZE);
        let things = things(empty.mean());
        let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
        let mut whole = 0;
        for frame in 0..FRAMES {
            let place = |(i, (shape, paint)): (usize, (Shape, Paint))| Body {
                shape,
                paint,
                at: [60.0 + 95.0 * i as f32 + frame as f32, 120.0],
                heading_rad: 0.4 + i as f32 + 0.05 * frame as f32,
            };
            let bodies: Vec<_> = things.into_iter().enumerate().map(place).collect();
            let canvas = empty.with(&bodies, &[]);
            let judged = Judged::new(play.show(&canvas, &Light::EVEN), &canvas);
            // Half a robot is found where the other half cannot be told from the floor, but never twice.
            let each = |body: &Body| {
                let inside = judged
                    .observed
                    .iter()
                    .filter(|(object, _)| body.contains([object.x as f32, object.y as f32]));
                inside.count() == 1
            };
            whole += usize::from(judged.observed.len() == 3 && bodies.iter().all(each));
        }
        println!("  {:10} {whole}", format!("{floor:?}"));
        demands.demand(!demanded || whole == FRAMES, || {
            format!("{name}: {whole} of {FRAMES} frames on {floor:?}")
        });
    }
    demands.check();
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_robot_half_in_the_colour_of_the_floor_is_one_object() {
    one_each("half like the floor", true, |floor| {
        let like = |by: f32| floor.map(|c| c + by);
        [
            (Shape::Box(60.0, 40.0), Paint::Halves(RED, like(5.0))),
            (Shape::Box(56.0, 44.0), Paint::Halves(like(-6.0), WHITE)),
            (Shape::Disc(26.0), Paint::Halves(BLUE, like(4.0))),
        ]
    });
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_robot_in_two_strong_colours_is_one_object() {
    one_each("two colours", true, |_| {
        [
            (Shape::Box(60.0, 40.0), Paint::Halves(RED, WHITE)),
            (Shape::Box(56.0, 44.0), Paint::Halves(BLACK, YELLOW)),
            (Shape::Disc(26.0), Paint::Halves(BLUE, BLACK)),
        ]
    });
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_thin_stripe_in_the_colour_of_the_floor_does_not_cut_a_robot() {
    one_each("stripe of 3 px", true, |floor| {
        [
            (Shape::Box(60.0, 40.0), Paint::Striped(RED, floor, 3.0)),
            (Shape::Box(56.0, 44.0), Paint::Striped(WHITE, floor, 3.0)),
            (Shape::Disc(26.0), Paint::Striped(BLUE, floor, 3.0)),
        ]
    });
}

#[test]
#[ignore = "demands nothing: cargo test --test floors reported -- --ignored --nocapture"]
fn wide_stripes_in_the_colour_of_the_floor_are_reported() {
    one_each("stripe of 8 px", false, |floor| {
        [
            (Shape::Box(60.0, 40.0), Paint::Striped(RED, floor, 8.0)),
            (Shape::Box(56.0, 44.0), Paint::Striped(WHITE, floor, 8.0)),
            (Shape::Disc(26.0), Paint::Striped(BLUE, floor, 8.0)),
        ]
    });
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_ring_is_one_object() {
    one_each("rings", true, |_| {
        [
            (Shape::Ring(34.0, 22.0), Paint::Plain(WHITE)),
            (Shape::Ring(28.0, 20.0), Paint::Plain(RED)),
            (Shape::Ring(24.0, 12.0), Paint::Plain(BLACK)),
        ]
    });
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn robots_that_touch_keep_their_tracks() {
    // They meet in frame 40, stand against each other for 25 frames, three times as long as a track lives without being seen, and part.
    const MEET: usize = 40;
    const PART: usize = MEET + 25;
    println!("touching robots: floor, frames with a track missing, frames with a third object");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let empty = Canvas::new(floor, SIZE);
        let mut play = Play::learned(Camera::new(3.0, Encoding::Rgb), &empty);
        let mut tracks = Vec::new();
        let (mut missing, mut third) = (0, LongestRun::default());
        let mut swapped = false;
        for frame in 0..PART + MEET {
            let way_px = 1.5 * MEET.saturating_sub(frame).max(frame.saturating_sub(PART)) as f32;
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
                let kept = |track: &u64| scene.objects().iter().any(|o| o.track == *track);
                missing += usize::from(tracks.len() < 2 || !tracks.iter().all(kept));
                third.add(scene.objects().len() > 2);
            }
            if frame == PART + MEET - 1 {
                let last: Vec<_> = bodies.iter().filter_map(track_at).collect();
                swapped = last != tracks;
            }
        }
        println!(
            "  {:10} {missing:3} {:3}",
            format!("{floor:?}"),
            third.longest
        );
        demands.demand(missing == 0, || {
            format!("a track is missing in {missing} frames on {floor:?}")
        });
        demands.demand(!swapped, || {
            format!("tracks are not what they were on {floor:?}")
        });
    }
    demands.check();
}
