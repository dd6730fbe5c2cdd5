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

/// Colours of what is drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Palette {
    pub(crate) floor: [f32; 3],
    pub(crate) paper: [f32; 3],
    pub(crate) ink: [f32; 3],
}

/// Black on white on grey, before a grey camera.
pub(crate) const GREY: Palette = Palette {
    floor: [120.0; 3],
    paper: [225.0; 3],
    ink: [40.0; 3],
};

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

impl Plate<'_> {
    /// Colour at a point relative to the centre.
    fn colour(&self, [x, y]: [f32; 2], plate_px: f32, palette: &Palette) -> [f32; 3] {
        let (sin, cos) = self.turn_rad.sin_cos();
        let at = [
            (cos * x + sin * y) / plate_px,
            (cos * y - sin * x) / plate_px,
        ];
        let border = at[0].abs().max(at[1].abs());
        if border <= 0.5 {
            return if contains(self.figure, at) {
                palette.ink
            } else {
                palette.paper
            };
        }
        match self.robot {
            Robot::Dark if x.hypot(y) < plate_px * 0.75 + 3.0 => [25.0; 3],
            Robot::Rim(grey) if border <= 0.5 + 3.0 / plate_px => [grey; 3],
            _ => palette.floor,
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

/// A camera's picture of plates: a grey one's where all colours are grey.
pub(crate) fn picture(
    size: Size,
    plates: &[Plate<'_>],
    palette: &Palette,
    conditions: &Conditions,
    random: &mut Random,
    frame: &mut Frame,
) {
    let colours = [palette.floor, palette.paper, palette.ink];
    let is_grey = colours.iter().all(|[r, g, b]| r == g && g == b);
    let channels = if is_grey { 1 } else { 3 };
    let mut planes: Vec<Vec<f32>> = (0..channels)
        .map(|channel| vec![palette.floor[channel]; size.area()])
        .collect();
    for plate in plates {
        draw(&mut planes, size, plate, palette, conditions.plate_px);
    }
    let planes: Vec<Vec<f32>> = planes
        .iter()
        .map(|plane| blurred(plane, size, conditions.blur_px))
        .collect();
    frame.size = size;
    frame.format = if is_grey {
        PixelFormat::Grey
    } else {
        PixelFormat::Rgb
    };
    frame.full_range = true;
    frame.bytes.clear();
    for i in 0..size.area() {
        // Full light at the right border: white is not to be more than the sensor takes.
        let light = |x: f32| 1.0 + conditions.slope * (x - size.width as f32 / 2.0) / 100.0;
        let lit = light((i % size.width) as f32) / light(size.width as f32);
        for plane in &planes {
            let seen = plane[i] * lit + conditions.noise * random.normal();
            frame.bytes.push(seen.round().clamp(0.0, 255.0) as u8);
        }
    }
}

fn draw(planes: &mut [Vec<f32>], size: Size, plate: &Plate<'_>, palette: &Palette, plate_px: f32) {
    let reach = plate_px * 0.75 + 6.0;
    let span = |centre: f32, length: usize| {
        (centre - reach).max(0.0) as usize..((centre + reach).max(0.0) as usize + 1).min(length)
    };
    for y in span(plate.centre[1], size.height) {
        for x in span(plate.centre[0], size.width) {
            let mut sums = [0.0; 3];
            for i in 0..SUBSAMPLES * SUBSAMPLES {
                let offset = |i: usize| (i as f32 + 0.5) / SUBSAMPLES as f32 - 0.5;
                let at = [
                    x as f32 + offset(i % SUBSAMPLES) - plate.centre[0],
                    y as f32 + offset(i / SUBSAMPLES) - plate.centre[1],
                ];
                let colour = plate.colour(at, plate_px, palette);
                for (sum, value) in sums.iter_mut().zip(colour) {
                    *sum += value / (SUBSAMPLES * SUBSAMPLES) as f32;
                }
            }
            for (plane, value) in planes.iter_mut().zip(sums) {
                plane[y * size.width + x] = value;
            }
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
