//! Floors with plates on them, drawn point by point, with their truth.

use imgproc::Size;
use overcam::frame::{Frame, PixelFormat};

use crate::random::Random;

/// Points of a pixel along each axis, as distances from its centre.
const SUBSAMPLES: usize = 10;

/// What camera and light do.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Conditions {
    /// Side of the plates, pixels.
    pub(crate) plate_px: f32,
    /// Standard deviation of the lens's blur, pixels.
    pub(crate) blur_px: f32,
    /// Standard deviation of a pixel's noise, grey levels.
    pub(crate) noise: f32,
    /// By how much the light grows over 100 px to the right.
    pub(crate) slope: f32,
}

/// What lies under a plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Robot {
    /// The plate lies on the floor.
    None,
    /// A dark, round one.
    Dark,
    /// A frame of a grey level around the plate.
    Rim(f32),
}

/// A figure on its plate.
#[derive(Debug, Clone)]
pub(crate) struct Plate<'a> {
    pub(crate) figure: &'a [[f32; 2]],
    pub(crate) centre: [f32; 2],
    /// Turn of the drawing.
    pub(crate) turn_rad: f32,
    pub(crate) robot: Robot,
}

const FLOOR: f32 = 120.0;
const PAPER: f32 = 225.0;
const INK: f32 = 40.0;

impl Plate<'_> {
    /// Grey level at a point relative to the centre; `None` where the floor is seen.
    fn grey(&self, [x, y]: [f32; 2], plate_px: f32) -> Option<f32> {
        let (sin, cos) = self.turn_rad.sin_cos();
        let at = [
            (cos * x + sin * y) / plate_px,
            (cos * y - sin * x) / plate_px,
        ];
        let border = at[0].abs().max(at[1].abs());
        if border <= 0.5 {
            return Some(if contains(self.figure, at) {
                INK
            } else {
                PAPER
            });
        }
        match self.robot {
            Robot::None => None,
            Robot::Dark => (x.hypot(y) < plate_px * 0.75 + 3.0).then_some(25.0),
            Robot::Rim(grey) => (border <= 0.5 + 3.0 / plate_px).then_some(grey),
        }
    }
}

/// Whether a point lies inside a polygon.
fn contains(polygon: &[[f32; 2]], [x, y]: [f32; 2]) -> bool {
    let mut inside = false;
    let mut from = polygon[polygon.len() - 1];
    for &to in polygon {
        if (from[1] > y) != (to[1] > y)
            && x < from[0] + (y - from[1]) / (to[1] - from[1]) * (to[0] - from[0])
        {
            inside = !inside;
        }
        from = to;
    }
    inside
}

/// A grey camera's picture of plates.
pub(crate) fn picture(
    size: Size,
    plates: &[Plate<'_>],
    conditions: &Conditions,
    random: &mut Random,
    frame: &mut Frame,
) {
    let mut plane = vec![FLOOR; size.area()];
    for plate in plates {
        draw(&mut plane, size, plate, conditions.plate_px);
    }
    let mut plane = blurred(&plane, size, conditions.blur_px);
    frame.size = size;
    frame.format = PixelFormat::Grey;
    frame.full_range = true;
    frame.bytes.clear();
    for (i, grey) in plane.iter_mut().enumerate() {
        // Full light at the right border: white is not to be more than the sensor takes.
        let light = |x: f32| 1.0 + conditions.slope * (x - size.width as f32 / 2.0) / 100.0;
        let lit = *grey * light((i % size.width) as f32) / light(size.width as f32);
        let seen = lit + conditions.noise * random.normal();
        frame.bytes.push(seen.round().clamp(0.0, 255.0) as u8);
    }
}

fn draw(plane: &mut [f32], size: Size, plate: &Plate<'_>, plate_px: f32) {
    let reach = plate_px * 0.75 + 6.0;
    let span = |centre: f32, length: usize| {
        (centre - reach).max(0.0) as usize..((centre + reach).max(0.0) as usize + 1).min(length)
    };
    for y in span(plate.centre[1], size.height) {
        for x in span(plate.centre[0], size.width) {
            let pixel = &mut plane[y * size.width + x];
            let floor = *pixel;
            let mut sum = 0.0;
            for i in 0..SUBSAMPLES * SUBSAMPLES {
                let offset = |i: usize| (i as f32 + 0.5) / SUBSAMPLES as f32 - 0.5;
                let at = [
                    x as f32 + offset(i % SUBSAMPLES) - plate.centre[0],
                    y as f32 + offset(i / SUBSAMPLES) - plate.centre[1],
                ];
                sum += plate.grey(at, plate_px).unwrap_or(floor);
            }
            *pixel = sum / (SUBSAMPLES * SUBSAMPLES) as f32;
        }
    }
}

/// A plane through a Gaussian lens.
fn blurred(plane: &[f32], size: Size, sigma: f32) -> Vec<f32> {
    let reach = (4.0 * sigma).ceil() as isize;
    let weight = |d: isize| (-((d * d) as f32) / (2.0 * sigma * sigma)).exp();
    let total: f32 = (-reach..=reach).map(weight).sum();
    let mut out = plane.to_vec();
    for [dx, dy] in [[1isize, 0isize], [0, 1]] {
        let source = out.clone();
        for y in 0..size.height as isize {
            for x in 0..size.width as isize {
                let at = |d: isize| {
                    let x = (x + d * dx).clamp(0, size.width as isize - 1) as usize;
                    let y = (y + d * dy).clamp(0, size.height as isize - 1) as usize;
                    source[y * size.width + x]
                };
                let sum: f32 = (-reach..=reach).map(|d| weight(d) * at(d)).sum();
                out[y as usize * size.width + x as usize] = sum / total;
            }
        }
    }
    out
}
