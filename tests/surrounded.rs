//! A robot in the corner, bay or hole of another object is one robot, and the other object is an
//! obstacle.

use imgproc::Size;
use overcam::background::model::BackgroundModel;
use overcam::image::frame::{Frame, Picture, PixelFormat};
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::Pipeline;
use overcam::run::slot::Slot;
use overcam::settings::Settings;
use scene::{KIND_MARKER, KIND_OBSTACLE};

const SIZE: Size = Size {
    width: 220,
    height: 200,
};
const FLOOR: u8 = 140;
/// Red, green and blue of the other object, and of the rim of the robot's plate.
const THING: [f64; 3] = [70.0, 110.0, 60.0];
const RIM: [f64; 3] = [60.0, 60.0, 160.0];
/// The arrow of the built-in markers, in a view box of 100.
const ARROW: [[f64; 2]; 7] = [
    [50.0, 9.0],
    [80.0, 50.0],
    [61.0, 50.0],
    [61.0, 91.0],
    [39.0, 91.0],
    [39.0, 50.0],
    [20.0, 50.0],
];
const PLATE_PX: f64 = 32.0;
const CENTRE: [f64; 2] = [110.0, 90.0];
const TURN_RAD: f64 = 0.4;
/// Sample points per pixel in each direction.
const STEPS: usize = 4;

/// Whether the other object covers a point, given relative to the robot's centre.
type Thing = fn(i32, i32) -> bool;

/// The colour of a point of the robot, if it is there.
fn robot(x: f64, y: f64) -> Option<[f64; 3]> {
    let (sin, cos) = TURN_RAD.sin_cos();
    let [dx, dy] = [x - CENTRE[0], y - CENTRE[1]];
    let [u, v] = [cos * dx + sin * dy, cos * dy - sin * dx].map(|d| 50.0 + 100.0 * d / PLATE_PX);
    let within = |margin: f64| {
        [u, v]
            .iter()
            .all(|c| (-margin..=100.0 + margin).contains(c))
    };
    let edges = ARROW.iter().zip(ARROW.iter().cycle().skip(1));
    let crossings = edges.filter(|([ax, ay], [bx, by])| {
        (*ay > v) != (*by > v) && u < ax + (bx - ax) * (v - ay) / (by - ay)
    });
    if crossings.count() % 2 == 1 {
        Some([20.0; 3])
    } else if within(0.0) {
        Some([235.0; 3])
    } else {
        within(12.0).then_some(RIM)
    }
}

fn robot_beside(thing: Thing) -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    let mut slot = Slot::empty();
    let noise = |i: usize| (i * 7919 % 101 % 5) as f64 - 2.0;
    let bytes = (0..SIZE.area()).flat_map(|i| {
        let (x, y) = ((i % SIZE.width) as f64, (i / SIZE.width) as f64);
        let mut sum = [0.0; 3];
        for k in 0..STEPS * STEPS {
            let [across, down] =
                [k % STEPS, k / STEPS].map(|n| (n as f64 + 0.5) / STEPS as f64 - 0.5);
            let stands = thing((x - CENTRE[0]) as i32, (y - CENTRE[1]) as i32).then_some(THING);
            let colour = robot(x + across, y + down)
                .or(stands)
                .unwrap_or([FLOOR.into(); 3]);
            sum = [0, 1, 2].map(|c| sum[c] + colour[c]);
        }
        sum.map(|sum| (sum / (STEPS * STEPS) as f64 + noise(i)).round() as u8)
    });
    slot.frame = Frame {
        format: PixelFormat::Rgb,
        size: SIZE,
        bytes: bytes.collect(),
        ..Frame::empty()
    };
    let plane = vec![FLOOR; SIZE.area()];
    slot.background = Some(BackgroundModel::from_picture(&Picture {
        size: SIZE,
        red: plane.clone(),
        green: plane.clone(),
        blue: plane,
    }));
    let family = Family::from_files(&built_in_files()).expect("the built-in markers are good");
    let mut pipeline = Pipeline::new(SIZE, Some(30.0), Settings::default(), family, None);
    pipeline.process(&mut slot).expect("it is a picture");
    let of_kind = |kind| {
        let objects = slot.scene.objects().iter();
        objects
            .filter(move |object| object.kind == kind)
            .map(|object| [object.x - CENTRE[0], object.y - CENTRE[1]])
            .collect()
    };
    (of_kind(KIND_MARKER), of_kind(KIND_OBSTACLE))
}

fn inside(dx: i32, dy: i32, half: i32) -> bool {
    dx.abs() <= half && dy.abs() <= half
}

/// Outer and inner half-width of the object around the robot, which it does not touch.
const OUTER: i32 = 50;
const INNER: i32 = 38;

#[test]
fn what_is_around_a_robot_is_not_the_robot() {
    let nothing: Thing = |_, _| false;
    assert_eq!(robot_beside(nothing).0.len(), 1);
    let corner: Thing = |dx, dy| {
        let (left, below) = (-90..-76, 70..85);
        (left.contains(&dx) && (-70..85).contains(&dy))
            || (below.contains(&dy) && (-90..70).contains(&dx))
    };
    let bay: Thing = |dx, dy| inside(dx, dy, OUTER) && !inside(dx, dy, INNER) && dy < INNER;
    let ring: Thing = |dx, dy| inside(dx, dy, OUTER) && !inside(dx, dy, INNER);
    let wire: Thing = |dx, dy| inside(dx, dy, INNER + 7) && (dx < -INNER || dy > INNER);
    for (name, thing) in [
        ("corner", corner),
        ("bay", bay),
        ("ring", ring),
        ("wire", wire),
    ] {
        let (markers, obstacles) = robot_beside(thing);
        assert_eq!(
            (markers.len(), obstacles.len()),
            (1, 1),
            "{name}: {markers:?}, {obstacles:?}"
        );
        let [x, y] = markers[0];
        assert!(x.hypot(y) < 1.0, "{name}: {markers:?}");
    }
}
