//! The demo floor: a synthetic scene with exact ground truth, for a first look, for tests and for
//! benchmarks.
//!
//! Robots with markers drive in circles, back and forth, and stop and go; a target stands still.
//! Around them are objects without markers, one of them rolling, some of which resemble markers:
//! dark spots on bright ground. Everything is a function of the frame number and a seed, so any
//! frame can be drawn independently, with known ground truth.
//!
//! The module `render` draws it. The scene was designed for 640 x 480 pixels; other sizes scale it.

use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::time::{Duration, Instant};

use imgproc::Size;

use crate::background::model;
use crate::geometry::raster::Vertex;
use crate::image::frame::{Frame, PixelFormat};
use crate::marker;
use crate::marker::reference::PLATE;
use crate::run::slot::{Next, Slot, SourceInfo};
use crate::source::render::{Appearance, Layer, Renderer};

/// Frames per second.
pub const RATE_HZ: f64 = 30.0;

/// The size for which the scene was designed.
pub const NATURAL_SIZE: Size = Size {
    width: 640,
    height: 480,
};

/// Ground truth for one object at the time of a frame, in image coordinates as in a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Name of the marker; `None` for an obstacle.
    pub marker: Option<&'static str>,
    /// Centre of the plate, or centroid of the obstacle, in pixels.
    pub x: f64,
    /// See `x`.
    pub y: f64,
    /// Direction of the marker, from +x towards +y.
    pub heading_rad: f64,
    /// Side of the plate in pixels; zero for an obstacle.
    pub plate_px: f64,
    /// Radius of a circle around the centre that contains the whole object, in pixels.
    pub radius_px: f64,
}

/// The scene.
#[derive(Debug)]
pub struct Floor {
    size: Size,
    scale: f32,
    actors: Vec<Actor>,
    renderer: Renderer,
}

/// One object: its appearance and motion.
#[derive(Debug)]
struct Actor {
    marker: Option<&'static str>,
    plate_px: f32,
    radius_px: f32,
    motion: Motion,
    appearance: Appearance,
}

/// Position of an object as a function of time, in pixels of [`NATURAL_SIZE`] and seconds.
#[derive(Debug, Clone, Copy)]
enum Motion {
    /// Stands still.
    Parked { at: [f32; 2], heading_rad: f32 },
    /// Drives around a centre; a negative period reverses the direction.
    Circle {
        centre: [f32; 2],
        radius: f32,
        period_s: f32,
    },
    /// Drives from one end to the other, turns in place, and drives back.
    ToAndFro {
        from: [f32; 2],
        to: [f32; 2],
        drive_s: f32,
        turn_s: f32,
    },
    /// Drives along the sides of a rectangle and pauses in the middle of each, turning at the
    /// corners.
    StopAndGo {
        left_top: [f32; 2],
        right_bottom: [f32; 2],
        side_s: f32,
    },
    /// Rolls back and forth along a line, slowing down at its ends, without rotating.
    Swing {
        from: [f32; 2],
        to: [f32; 2],
        period_s: f32,
    },
}

impl Floor {
    /// The scene in a given size; `seed` determines the noise and the texture of the floor.
    #[must_use]
    pub fn new(size: Size, seed: u64) -> Self {
        let scale = (size.width as f32 / NATURAL_SIZE.width as f32)
            .min(size.height as f32 / NATURAL_SIZE.height as f32);
        let actors = actors();
        Self {
            size,
            scale,
            actors,
            renderer: Renderer::new(size, seed),
        }
    }

    /// Draws a frame.
    pub fn render(&mut self, sequence: u64, frame: &mut Frame) {
        let time_s = sequence as f32 / RATE_HZ as f32;
        self.renderer.begin(time_s);
        for actor in &self.actors {
            let (at, heading) = actor.motion.at(time_s);
            let at = at.map(|c| c * self.scale);
            self.renderer
                .draw(&actor.appearance, at, heading + FRAC_PI_2, self.scale);
        }
        frame.sequence = sequence;
        frame.stamp_ns = stamp_ns(sequence);
        frame.format = PixelFormat::Rgb;
        frame.full_range = true;
        frame.size = self.size;
        self.renderer.finish(sequence, &mut frame.bytes);
    }

    /// Ground truth for a frame.
    pub fn truth(&self, sequence: u64) -> impl Iterator<Item = Truth> + '_ {
        let time_s = sequence as f32 / RATE_HZ as f32;
        self.actors.iter().map(move |actor| {
            let ([x, y], heading_rad) = actor.motion.at(time_s);
            Truth {
                marker: actor.marker,
                x: f64::from(x * self.scale),
                y: f64::from(y * self.scale),
                heading_rad: f64::from(fourier::wrapped(heading_rad)),
                plate_px: f64::from(actor.plate_px * self.scale),
                radius_px: f64::from(actor.radius_px * self.scale),
            }
        })
    }

    /// The empty floor, as seen by a camera without noise in uniform light. The noise of its frames
    /// is unknown: the part that remains after the median depends on the grain of the floor.
    #[must_use]
    pub fn background(&self) -> model::BackgroundModel {
        model::BackgroundModel::from_picture(&self.renderer.background())
    }
}

/// Time of a frame since the first one.
fn stamp_ns(sequence: u64) -> u64 {
    (sequence as f64 * 1e9 / RATE_HZ).round() as u64
}

/// The demo as a source of frames, in real time.
#[derive(Debug)]
pub struct Demo {
    floor: Floor,
    sequence: u64,
    started: Instant,
}

impl Demo {
    /// The demo in a given size.
    #[must_use]
    pub fn new(size: Size) -> Self {
        Self {
            floor: Floor::new(size, 1),
            sequence: 0,
            started: Instant::now(),
        }
    }

    /// Information about its frames.
    #[must_use]
    pub fn info(&self) -> SourceInfo {
        SourceInfo {
            name: "demo floor".to_owned(),
            size: self.floor.size,
            format: PixelFormat::Rgb,
            rate_hz: Some(RATE_HZ),
            live: false,
            controls: None,
        }
    }

    /// Draws the next frame and waits until it is due. The first one includes the background.
    pub fn next(&mut self, slot: &mut Slot) -> Next {
        self.floor.render(self.sequence, &mut slot.frame);
        slot.background = (self.sequence == 0).then(|| self.floor.background());
        self.sequence += 1;
        let due = self.started + Duration::from_nanos(slot.frame.stamp_ns);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        Next::Frame
    }
}

impl Motion {
    /// Position and heading (from +x towards +y).
    fn at(self, time_s: f32) -> ([f32; 2], f32) {
        match self {
            Self::Parked { at, heading_rad } => (at, heading_rad),
            Self::Circle {
                centre,
                radius,
                period_s,
            } => {
                let angle = TAU * (time_s / period_s).fract();
                let at = [
                    centre[0] + radius * angle.cos(),
                    centre[1] + radius * angle.sin(),
                ];
                (at, angle + FRAC_PI_2.copysign(period_s))
            }
            Self::ToAndFro {
                from,
                to,
                drive_s,
                turn_s,
            } => {
                let there = (to[1] - from[1]).atan2(to[0] - from[0]);
                let leg = drive_s + turn_s;
                let phase = time_s % (2.0 * leg);
                let (start, end, heading) = if phase < leg {
                    (from, to, there)
                } else {
                    (to, from, there + PI)
                };
                let phase = phase % leg;
                let turned = PI * ((phase - drive_s) / turn_s).max(0.0);
                (
                    between(start, end, (phase / drive_s).min(1.0)),
                    heading + turned,
                )
            }
            Self::StopAndGo {
                left_top: [left, top],
                right_bottom: [right, bottom],
                side_s,
            } => {
                let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
                let sides = time_s / side_s;
                let side = sides as usize % 4;
                // Three tenths driving, three resting, three driving, one turning.
                let phase = sides.fract();
                let share = if phase < 0.3 {
                    phase / 0.6
                } else if phase < 0.6 {
                    0.5
                } else {
                    ((phase - 0.3) / 0.6).min(1.0)
                };
                let turned = FRAC_PI_2 * ((phase - 0.9) / 0.1).max(0.0);
                (
                    between(corners[side], corners[(side + 1) % 4], share),
                    side as f32 * FRAC_PI_2 + turned,
                )
            }
            Self::Swing { from, to, period_s } => (
                between(from, to, 0.5 - 0.5 * (TAU * time_s / period_s).cos()),
                -FRAC_PI_2,
            ),
        }
    }
}

fn between(from: [f32; 2], to: [f32; 2], share: f32) -> [f32; 2] {
    [
        from[0] + share * (to[0] - from[0]),
        from[1] + share * (to[1] - from[1]),
    ]
}

const WHITE: [u8; 3] = [232, 232, 228];
const BLACK: [u8; 3] = [28, 28, 30];

/// The objects. Their order does not matter, because they never overlap.
fn actors() -> Vec<Actor> {
    let circle = |centre, radius, period_s| Motion::Circle {
        centre,
        radius,
        period_s,
    };
    vec![
        robot(
            "arrow",
            48.0,
            disc(42.0),
            [40, 60, 120],
            Some([230, 190, 40]),
            circle([120.0, 125.0], 62.0, 9.0),
        ),
        robot(
            "chevron",
            32.0,
            rounded_square(52.0),
            [24, 24, 24],
            None,
            Motion::ToAndFro {
                from: [270.0, 50.0],
                to: [590.0, 50.0],
                drive_s: 4.0,
                turn_s: 1.0,
            },
        ),
        robot(
            "keyhole",
            24.0,
            disc(22.0),
            [170, 40, 40],
            None,
            Motion::StopAndGo {
                left_top: [440.0, 130.0],
                right_bottom: [590.0, 260.0],
                side_s: 3.0,
            },
        ),
        robot(
            "cup",
            40.0,
            rounded_square(44.0),
            WHITE,
            None,
            circle([320.0, 195.0], 58.0, -7.0),
        ),
        robot(
            "goblet",
            28.0,
            disc(25.0),
            [60, 110, 60],
            Some([20, 20, 20]),
            Motion::ToAndFro {
                from: [50.0, 270.0],
                to: [190.0, 425.0],
                drive_s: 5.0,
                turn_s: 1.2,
            },
        ),
        robot(
            "triangle",
            36.0,
            rounded_square(36.0),
            WHITE,
            None,
            Motion::Parked {
                at: [585.0, 420.0],
                heading_rad: 0.7,
            },
        ),
        obstacle(
            parked([285.0, 345.0]),
            vec![
                layer(rounded_square(56.0), [150, 100, 60]),
                spot(9.0, [4.0, -6.0]),
            ],
        ),
        obstacle(
            parked([395.0, 405.0]),
            vec![
                layer(rounded_square(46.0), WHITE),
                layer(moved(ellipse(9.0, 14.0), [1.0, -1.0]), BLACK),
            ],
        ),
        obstacle(
            parked([480.0, 330.0]),
            vec![
                layer(disc(24.0), [225, 110, 30]),
                layer(disc(17.0), WHITE),
                layer(polygon(5, 9.0), BLACK),
            ],
        ),
        obstacle(
            parked([260.0, 436.0]),
            vec![layer(moved(ellipse(34.0, 7.0), [0.0, 0.0]), [40, 70, 150])],
        ),
        obstacle(
            Motion::Swing {
                from: [345.0, 310.0],
                to: [425.0, 340.0],
                period_s: 6.0,
            },
            vec![layer(disc(15.0), [50, 50, 52])],
        ),
    ]
}

fn robot(
    marker: &'static str,
    plate_px: f32,
    body: Vec<Vertex>,
    colour: [u8; 3],
    rim: Option<[u8; 3]>,
    motion: Motion,
) -> Actor {
    let svg = marker::BUILT_IN
        .iter()
        .find(|(name, _)| *name == marker)
        .map_or("", |(_, svg)| svg);
    let outline = crate::marker::drawing::read_drawing(marker, svg)
        .map(|drawing| drawing.outline)
        .unwrap_or_default();
    let scaled = |points: &[Vertex], side: f32| {
        points
            .iter()
            .map(|p| p.map(|c| c * side))
            .collect::<Vec<_>>()
    };
    let mut layers = vec![layer(body, colour)];
    if let Some(rim) = rim {
        layers.push(layer(scaled(&PLATE, plate_px * 1.16), rim));
    }
    layers.push(layer(scaled(&PLATE, plate_px), WHITE));
    layers.push(layer(scaled(&outline, plate_px), BLACK));
    Actor {
        marker: Some(marker),
        plate_px,
        radius_px: radius(&layers),
        motion,
        appearance: Appearance { layers },
    }
}

fn obstacle(motion: Motion, layers: Vec<Layer>) -> Actor {
    Actor {
        marker: None,
        plate_px: 0.0,
        radius_px: radius(&layers),
        motion,
        appearance: Appearance { layers },
    }
}

fn parked(at: [f32; 2]) -> Motion {
    Motion::Parked {
        at,
        heading_rad: 0.3 - FRAC_PI_2,
    }
}

fn layer(outline: Vec<Vertex>, colour: [u8; 3]) -> Layer {
    Layer { outline, colour }
}

fn spot(radius: f32, at: Vertex) -> Layer {
    layer(moved(disc(radius), at), BLACK)
}

fn radius(layers: &[Layer]) -> f32 {
    layers
        .iter()
        .flat_map(|layer| &layer.outline)
        .map(|[x, y]| x.hypot(*y))
        .fold(0.0, f32::max)
}

fn disc(radius: f32) -> Vec<Vertex> {
    ellipse(radius, radius)
}

fn ellipse(a: f32, b: f32) -> Vec<Vertex> {
    (0..48)
        .map(|i| TAU * i as f32 / 48.0)
        .map(|angle| [a * angle.cos(), b * angle.sin()])
        .collect()
}

fn polygon(corners: usize, radius: f32) -> Vec<Vertex> {
    (0..corners)
        .map(|i| TAU * i as f32 / corners as f32)
        .map(|angle| [radius * angle.cos(), radius * angle.sin()])
        .collect()
}

/// A square with bevelled corners.
fn rounded_square(side: f32) -> Vec<Vertex> {
    let (a, b) = (side / 2.0, side / 2.0 - side / 10.0);
    vec![
        [-b, -a],
        [b, -a],
        [a, -b],
        [a, b],
        [b, a],
        [-b, a],
        [-a, b],
        [-a, -b],
    ]
}

fn moved(outline: Vec<Vertex>, by: Vertex) -> Vec<Vertex> {
    outline
        .into_iter()
        .map(|[x, y]| [x + by[0], y + by[1]])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Frame {
        Frame {
            sequence: 0,
            stamp_ns: 0,
            format: PixelFormat::Grey,
            full_range: false,
            size: NATURAL_SIZE,
            bytes: Vec::new(),
        }
    }

    #[test]
    fn a_frame_depends_on_its_number_and_the_seed_alone() {
        let (mut in_order, mut alone, mut other) = (frame(), frame(), frame());
        let mut floor = Floor::new(NATURAL_SIZE, 7);
        (0..4).for_each(|sequence| floor.render(sequence, &mut in_order));
        Floor::new(NATURAL_SIZE, 7).render(3, &mut alone);
        assert_eq!(in_order.bytes, alone.bytes);
        assert_eq!(alone.stamp_ns, 100_000_000);
        Floor::new(NATURAL_SIZE, 8).render(3, &mut other);
        assert_ne!(other.bytes, alone.bytes);
    }

    #[test]
    fn nothing_leaves_the_picture_or_touches_another() {
        let floor = Floor::new(NATURAL_SIZE, 1);
        for sequence in (0..3600).step_by(5) {
            let all: Vec<Truth> = floor.truth(sequence).collect();
            for (i, a) in all.iter().enumerate() {
                let inside = |c: f64, end: usize| {
                    c - a.radius_px >= 2.0 && c + a.radius_px <= end as f64 - 3.0
                };
                assert!(
                    inside(a.x, NATURAL_SIZE.width) && inside(a.y, NATURAL_SIZE.height),
                    "{sequence}: {a:?}"
                );
                for b in &all[..i] {
                    let gap = (a.x - b.x).hypot(a.y - b.y) - a.radius_px - b.radius_px;
                    assert!(gap > 8.0, "{sequence}: {gap} px between {a:?} and {b:?}");
                }
            }
        }
    }

    #[test]
    fn motions_are_continuous() {
        for actor in actors() {
            for i in 0..12_000 {
                let ((a, heading), (b, next)) = (
                    actor.motion.at(i as f32 * 0.01),
                    actor.motion.at((i + 1) as f32 * 0.01),
                );
                assert!(
                    (a[0] - b[0]).hypot(a[1] - b[1]) < 1.5,
                    "{:?} at {i}",
                    actor.motion
                );
                assert!(
                    fourier::wrapped(next - heading).abs() < 0.08,
                    "{:?} at {i}",
                    actor.motion
                );
            }
        }
    }
}
