//! Things that stood on the floor when its picture was taken, and leave.

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

/// Frame in which the things that are in the background leave.
const LEAVING: usize = 15;

/// Frames until their places must be floor again.
const FREED: usize = 2 * RATE_HZ;

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn a_ghost_is_freed_and_a_parked_robot_stays() {
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
    println!("ghosts: floor, background, freed after, false objects later, parked robot lost for");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let empty = Canvas::new(floor, SIZE);
        // What stands in the background is not reported: only the parked robot is true.
        let background = empty.with(&leaving, &[]).as_floor();
        let before = background.with(&[parked], &[]);
        let after = empty.with(&[parked], &[]);
        for learned in [true, false] {
            let camera = Camera::new(3.0, Encoding::Rgb);
            let mut play = if learned {
                Play::learned(camera, &background)
            } else {
                Play::given(camera, &background)
            };
            let (mut lost, mut freed, mut n_late) = (LongestRun::default(), 0, 0);
            for frame in 0..LEAVING + FREED + RATE_HZ / 2 {
                let canvas = if frame < LEAVING { &before } else { &after };
                let judged = Judged::new(play.show(canvas, &Light::EVEN), canvas);
                lost.add(!judged.sees(0));
                let n_false = judged.false_objects().count();
                if frame >= LEAVING && n_false > 0 {
                    freed = frame - LEAVING + 1;
                }
                if frame >= LEAVING + FREED {
                    n_late += n_false;
                }
            }
            let how = if learned { "learned" } else { "given" };
            println!(
                "  {:10} {how:8} {freed:3} {n_late:3} {:3}",
                format!("{floor:?}"),
                lost.longest
            );
            demands.demand(n_late == 0, || {
                format!("a ghost for {freed} frames on {floor:?}, {how}")
            });
            demands.demand(lost.longest == 0, || {
                format!(
                    "the parked robot is lost for {} frames on {floor:?}, {how}",
                    lost.longest
                )
            });
        }
    }
    demands.check();
}
