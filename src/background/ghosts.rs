//! Ghosts: places that an object has left, although the background still shows it there.
//!
//! A ghost differs from the background like an object, with the object's shape. But an object has
//! an edge around it in the frame, while the edge of a ghost is in the background: in the frame,
//! the floor continues across the contour. A shape that looks like this in the same place for half
//! a second is a ghost.

use imgproc::{Bounds, Point, Size};

use crate::image::frame::Picture;
use crate::settings::frames_in;

/// Maximum number of candidates.
const GHOSTS_MAX: usize = 32;

/// A shape that has looked like a ghost for this long is one.
const SIGHTED_S: f64 = 0.5;

/// Maximum number of contour points tested.
const POINTS_MAX: usize = 96;

/// Minimum number of points for a decision.
const POINTS_MIN: usize = 12;

/// Distance from the contour to the compared pixels, inwards and outwards.
const REACH_PX: f32 = 2.5;

/// Minimum height of an edge, in levels summed over the channels.
const EDGE_MIN: i32 = 24;

/// Candidates for ghosts.
#[derive(Debug)]
pub(crate) struct Ghosts {
    /// Consecutive sightings that make a ghost.
    sightings_min: u32,
    watched: [(Bounds, u32); GHOSTS_MAX],
    n: usize,
    next: [(Bounds, u32); GHOSTS_MAX],
    n_next: usize,
}

impl Ghosts {
    pub(crate) fn new(rate_hz: f64) -> Self {
        let nowhere = (Bounds::of(Point { x: 0, y: 0 }), 0);
        Self {
            sightings_min: frames_in(SIGHTED_S, rate_hz),
            watched: [nowhere; GHOSTS_MAX],
            n: 0,
            next: [nowhere; GHOSTS_MAX],
            n_next: 0,
        }
    }

    /// Records a shape that looks like a ghost in this frame. Returns whether it is one.
    pub(crate) fn sighted(&mut self, bounds: Bounds) -> bool {
        let near = |a: u16, b: u16| a.abs_diff(b) <= 3;
        let before = self.watched[..self.n].iter().find(|(other, _)| {
            near(other.left, bounds.left)
                && near(other.top, bounds.top)
                && near(other.right, bounds.right)
                && near(other.bottom, bounds.bottom)
        });
        let sightings = before.map_or(0, |(_, sightings)| *sightings) + 1;
        if sightings < self.sightings_min && self.n_next < GHOSTS_MAX {
            self.next[self.n_next] = (bounds, sightings);
            self.n_next += 1;
        }
        sightings >= self.sightings_min
    }

    /// Ends a frame: candidates not sighted in it are removed.
    pub(crate) fn end_frame(&mut self) {
        std::mem::swap(&mut self.watched, &mut self.next);
        self.n = self.n_next;
        self.n_next = 0;
    }
}

/// Whether the edge along a contour is in the background and not in the frame.
pub(crate) fn looks_left(
    contour: &[Point],
    frame: &Picture,
    floor: &[Vec<u16>; 3],
    size: Size,
) -> bool {
    let n = contour.len();
    let stride = n.div_ceil(POINTS_MAX);
    let (mut points, mut of_floor, mut of_frame) = (0, 0, 0);
    for i in (0..n).step_by(stride) {
        let (before, after) = (contour[(i + n - 3 % n) % n], contour[(i + 3) % n]);
        let along = [
            f32::from(after.x) - f32::from(before.x),
            f32::from(after.y) - f32::from(before.y),
        ];
        let length = along[0].hypot(along[1]);
        if length == 0.0 {
            continue;
        }
        // The contour is clockwise on the screen, so outwards is to the left.
        let outwards = [along[1] / length * REACH_PX, -along[0] / length * REACH_PX];
        let at = |sign: f32| {
            let x = (f32::from(contour[i].x) + sign * outwards[0]).round();
            let y = (f32::from(contour[i].y) + sign * outwards[1]).round();
            let inside = x >= 0.0 && y >= 0.0 && x < size.width as f32 && y < size.height as f32;
            inside.then(|| y as usize * size.width + x as usize)
        };
        let (Some(outside), Some(inside)) = (at(1.0), at(-1.0)) else {
            continue;
        };
        let planes = [&frame.red, &frame.green, &frame.blue];
        let (mut in_frame, mut in_floor) = (0, 0);
        for (plane, floor) in planes.into_iter().zip(floor) {
            in_frame += i32::from(plane[outside].abs_diff(plane[inside]));
            in_floor += i32::from(floor[outside].abs_diff(floor[inside]) >> 8);
        }
        points += 1;
        of_floor += usize::from(in_floor > 2 * in_frame + EDGE_MIN);
        of_frame += usize::from(in_frame > 2 * in_floor + EDGE_MIN);
    }
    points >= POINTS_MIN && 10 * of_floor >= 6 * points && 100 * of_frame <= 12 * points
}
