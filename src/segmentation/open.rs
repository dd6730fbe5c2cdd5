//! Open areas: parts of the picture where the floor is unknown because a robot stood there while it
//! was learned.
//!
//! The learned floor shows the robot. While the robot stays, only the search for markers sees it.
//! After it has left, the learned floor would differ from the real one in the shape of the robot.
//! So nothing is compared in an open area until the robot has left; then the area is learned from
//! the frame.

use imgproc::labels::FLOOR;
use imgproc::{Bounds, Point, Size};

/// Maximum number of open areas.
const AREAS_MAX: usize = 64;

/// Share of an area's pixels that differ from the learned floor once the robot has left.
const CHANGED_MIN: f32 = 0.15;

/// Maximum distance between an area and a shape that is cut off by it: the opening of the mask
/// leaves a gap.
const CUT_PX: f64 = 4.0;

/// A circle in the picture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OpenArea {
    pub(crate) centre: [f64; 2],
    pub(crate) radius_px: f64,
    /// The frame differs from the learned floor.
    pub(crate) is_changed: bool,
    /// Number of frames in a row that differed without a robot near it.
    empty_frames: u32,
}

/// All open areas of a picture.
#[derive(Debug)]
pub(crate) struct OpenAreas {
    size: Size,
    areas: Vec<OpenArea>,
    /// 1 in an open area.
    plane: Vec<u8>,
}

impl OpenAreas {
    pub(super) fn new(size: Size) -> Self {
        Self {
            size,
            areas: Vec::with_capacity(AREAS_MAX),
            plane: vec![0; size.area()],
        }
    }

    pub(super) fn clear(&mut self) {
        self.areas.clear();
        self.plane.fill(0);
    }

    /// 1 where the floor is unknown; `None` without open areas.
    pub(super) fn plane(&self) -> Option<&[u8]> {
        (!self.areas.is_empty()).then_some(self.plane.as_slice())
    }

    /// Whether a point lies in an open area.
    pub(super) fn contains(&self, point: [f64; 2]) -> bool {
        self.areas.iter().any(|area| area.is_near(point, 0.0))
    }

    /// Whether a shape with this contour may continue in an open area.
    pub(super) fn cuts(&self, contour: &[Point]) -> bool {
        self.areas.iter().any(|area| {
            let mut points = contour.iter().map(|p| [f64::from(p.x), f64::from(p.y)]);
            points.any(|point| area.is_near(point, CUT_PX))
        })
    }

    /// Adds an area, if there is room.
    pub(super) fn add(&mut self, centre: [f64; 2], radius_px: f64) {
        if self.areas.len() < AREAS_MAX {
            self.areas.push(OpenArea {
                centre,
                radius_px,
                is_changed: false,
                empty_frames: 0,
            });
            self.draw();
        }
    }

    /// Checks which areas differ from the learned floor, and sets the labels in all areas to floor.
    pub(super) fn take_out(&mut self, labels: &mut [u8]) {
        for i in 0..self.areas.len() {
            let area = self.areas[i];
            let (mut n, mut n_changed) = (0_u32, 0_u32);
            area.for_each_pixel(self.size, |at| {
                n += 1;
                n_changed += u32::from(labels[at] != FLOOR);
            });
            self.areas[i].is_changed = n_changed as f32 > CHANGED_MIN * n as f32;
        }
        if !self.areas.is_empty() {
            for (label, &open) in labels.iter_mut().zip(&self.plane) {
                if open != 0 {
                    *label = FLOOR;
                }
            }
        }
    }

    /// Removes the areas that differed from the learned floor for `empty_frames_max` frames without
    /// a robot near them (`is_occupied`), and calls `left` with each.
    pub(super) fn update(
        &mut self,
        empty_frames_max: u32,
        is_occupied: impl Fn(&OpenArea) -> bool,
        mut left: impl FnMut(&OpenArea),
    ) {
        let before = self.areas.len();
        self.areas.retain_mut(|area| {
            if is_occupied(area) || !area.is_changed {
                area.empty_frames = 0;
                return true;
            }
            area.empty_frames += 1;
            let stays = area.empty_frames < empty_frames_max;
            if !stays {
                left(area);
            }
            stays
        });
        if self.areas.len() != before {
            self.draw();
        }
    }

    fn draw(&mut self) {
        self.plane.fill(0);
        for area in &self.areas {
            let plane = &mut self.plane;
            area.for_each_pixel(self.size, |at| plane[at] = 1);
        }
    }
}

impl OpenArea {
    /// Whether a point lies within the area or no farther than `reach_px` from it.
    pub(crate) fn is_near(&self, [x, y]: [f64; 2], reach_px: f64) -> bool {
        (x - self.centre[0]).hypot(y - self.centre[1]) <= self.radius_px + reach_px
    }

    /// The bounding square, clipped to the picture.
    pub(crate) fn bounds(&self, size: Size) -> Bounds {
        Bounds::around(self.centre, self.radius_px, size)
    }

    fn for_each_pixel(&self, size: Size, mut work: impl FnMut(usize)) {
        let bounds = self.bounds(size);
        for y in bounds.top..=bounds.bottom {
            for x in bounds.left..=bounds.right {
                if self.is_near([f64::from(x), f64::from(y)], 0.0) {
                    work(usize::from(y) * size.width + usize::from(x));
                }
            }
        }
    }

    /// Writes the area as a mask of its bounds.
    pub(super) fn mask(&self, size: Size, mask: &mut [u8]) {
        let bounds = self.bounds(size);
        let width = bounds.size().width;
        for (i, mask) in mask.iter_mut().enumerate() {
            let (x, y) = (i % width, i / width);
            let at = [
                (x + usize::from(bounds.left)) as f64,
                (y + usize::from(bounds.top)) as f64,
            ];
            *mask = u8::from(self.is_near(at, 0.0));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size {
        width: 40,
        height: 30,
    };

    #[test]
    fn an_area_is_given_back_once_its_robot_has_left() {
        let mut areas = OpenAreas::new(SIZE);
        areas.add([20.0, 15.0], 6.0);
        let mut left = Vec::new();
        // The robot stands there, as learned.
        let mut labels = vec![FLOOR; SIZE.area()];
        areas.take_out(&mut labels);
        areas.update(2, |_| false, |area| left.push(area.centre));
        // It moves on: the frame differs, and it is still near.
        for (occupied, n_left) in [(true, 0), (false, 0), (false, 1)] {
            let mut labels = vec![FLOOR + 1; SIZE.area()];
            areas.take_out(&mut labels);
            assert_eq!(labels[15 * SIZE.width + 20], FLOOR);
            assert_ne!(labels[0], FLOOR);
            areas.update(2, |_| occupied, |area| left.push(area.centre));
            assert_eq!(left.len(), n_left);
        }
        assert!(areas.plane().is_none());
    }
}
