//! Renders the demo floor as a camera would see it: texture, soft shadows, lens blur, slowly
//! changing light, sensor noise.
//!
//! A frame is rendered in floating point from bottom to top: shadows darken the floor, layers are
//! composited with exact sub-pixel coverage and blurred, the light scales everything, and the
//! sensor adds noise that grows with the square root of the signal.

use std::f32::consts::TAU;

use imgproc::Size;
use random::SplitMix64;

use crate::geometry::raster::{Vertex, blur, fill_polygon};
use crate::image::frame::Picture;
use crate::marker::reference::placed;

/// Lens blur, standard deviation in pixels.
const LENS_BLUR_PX: f32 = 0.6;

/// Sensor noise at mid grey, standard deviation in grey levels.
const NOISE: f32 = 2.5;

/// Length of the noise table: rows start at different positions in it.
const NOISE_TABLE: usize = 1 << 16;

/// Maximum change of the light, as a share, and its period.
const LIGHT_DRIFT: f32 = 0.04;
const LIGHT_PERIOD_S: f32 = 40.0;

/// Shadows: remaining share of light at their centre, offset, and blur in pixels.
const SHADOW_LIGHT: f32 = 0.68;
const SHADOW_OFFSET_PX: [f32; 2] = [5.0, 4.0];
const SHADOW_BLUR_PX: f32 = 2.0;

/// Appearance of an object from above: layers from bottom to top, in pixels around its centre,
/// heading up.
#[derive(Debug)]
pub(crate) struct Appearance {
    pub(crate) layers: Vec<Layer>,
}

/// One part of an object, in one colour.
#[derive(Debug)]
pub(crate) struct Layer {
    pub(crate) outline: Vec<Vertex>,
    pub(crate) colour: [u8; 3],
}

/// The floor and the current frame.
#[derive(Debug)]
pub(crate) struct Renderer {
    size: Size,
    floor: [Vec<f32>; 3],
    canvas: [Vec<f32>; 3],
    light: f32,
    noise: Vec<f32>,
    seed: u64,
    coverage: Vec<f32>,
    scratch: Vec<f32>,
}

impl Renderer {
    pub(crate) fn new(size: Size, seed: u64) -> Self {
        let floor = floor(size, seed);
        let mut random = SplitMix64(seed ^ 0x006e_6f69_7365);
        let noise = (0..NOISE_TABLE).map(|_| gaussian(&mut random)).collect();
        Self {
            size,
            canvas: floor.clone(),
            floor,
            light: 1.0,
            noise,
            seed,
            coverage: vec![0.0; size.area()],
            scratch: vec![0.0; size.area()],
        }
    }

    /// Starts a frame with the empty floor, under the current light.
    pub(crate) fn begin(&mut self, time_s: f32) {
        for (canvas, floor) in self.canvas.iter_mut().zip(&self.floor) {
            canvas.copy_from_slice(floor);
        }
        self.light = 1.0 + LIGHT_DRIFT * (TAU * time_s / LIGHT_PERIOD_S).sin();
    }

    /// Draws an object with its shadow.
    pub(crate) fn draw(&mut self, appearance: &Appearance, at: Vertex, turn_rad: f32, scale: f32) {
        let Some(bottom) = appearance.layers.first() else {
            return;
        };
        self.shadow(&placed(&bottom.outline, at, turn_rad, scale), scale);
        for layer in &appearance.layers {
            self.cover(&placed(&layer.outline, at, turn_rad, scale), layer.colour);
        }
    }

    /// Darkens the floor next to an object.
    fn shadow(&mut self, outline: &[Vertex], scale: f32) {
        let [dx, dy] = SHADOW_OFFSET_PX.map(|offset| offset * scale);
        let moved: Vec<Vertex> = outline.iter().map(|[x, y]| [x + dx, y + dy]).collect();
        let Some(area) = self.coverage_of(&moved, SHADOW_BLUR_PX * scale) else {
            return;
        };
        for plane in &mut self.canvas {
            area.for_each_pixel(plane, self.size, &self.coverage, |pixel, share| {
                *pixel *= 1.0 - (1.0 - SHADOW_LIGHT) * share;
            });
        }
    }

    /// Paints a polygon.
    fn cover(&mut self, polygon: &[Vertex], colour: [u8; 3]) {
        let Some(area) = self.coverage_of(polygon, LENS_BLUR_PX) else {
            return;
        };
        for (plane, colour) in self.canvas.iter_mut().zip(colour) {
            area.for_each_pixel(plane, self.size, &self.coverage, |pixel, share| {
                *pixel += share * (f32::from(colour) - *pixel);
            });
        }
    }

    /// Writes the blurred coverage of each pixel by a polygon to `self.coverage`, and returns its
    /// bounding rectangle.
    fn coverage_of(&mut self, polygon: &[Vertex], blur_px: f32) -> Option<Area> {
        let margin = 1.0 + 3.0 * blur_px;
        let low = |axis: usize| {
            polygon
                .iter()
                .map(|p| p[axis])
                .fold(f32::INFINITY, f32::min)
                - margin
        };
        let high = |axis: usize| {
            polygon
                .iter()
                .map(|p| p[axis])
                .fold(f32::NEG_INFINITY, f32::max)
                + margin
        };
        let area = self.area([low(0), low(1)], [high(0), high(1)])?;
        let local: Vec<Vertex> = polygon
            .iter()
            .map(|p| [p[0] - area.left as f32, p[1] - area.top as f32])
            .collect();
        let pixels = area.size.area();
        fill_polygon(&local, area.size, &mut self.coverage[..pixels]);
        blur(
            &mut self.coverage[..pixels],
            area.size,
            blur_px,
            &mut self.scratch[..pixels],
        );
        Some(area)
    }

    /// The part of a rectangle inside the picture.
    fn area(&self, low: Vertex, high: Vertex) -> Option<Area> {
        let pixel = |c: f32, end: usize| (c.round().max(0.0) as usize).min(end);
        let (left, top) = (
            pixel(low[0], self.size.width),
            pixel(low[1], self.size.height),
        );
        let (right, bottom) = (
            pixel(high[0] + 1.0, self.size.width),
            pixel(high[1] + 1.0, self.size.height),
        );
        let size = Size {
            width: right - left,
            height: bottom - top,
        };
        (size.area() > 0).then_some(Area { left, top, size })
    }

    /// Finishes a frame: light, noise, quantisation to 8 bits; red, green and blue are interleaved.
    pub(crate) fn finish(&self, sequence: u64, bytes: &mut Vec<u8>) {
        bytes.resize(3 * self.size.area(), 0);
        let mut random = SplitMix64(self.seed ^ sequence.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        for (y, row) in bytes.chunks_exact_mut(3 * self.size.width).enumerate() {
            for (channel, plane) in self.canvas.iter().enumerate() {
                let offset = random.bits() as usize;
                let values = &plane[y * self.size.width..][..self.size.width];
                for (x, value) in values.iter().enumerate() {
                    let signal = value * self.light;
                    let sigma = NOISE * (0.5 + 0.5 * signal / 128.0).sqrt();
                    let noise = self.noise[(offset + x) % NOISE_TABLE];
                    row[3 * x + channel] = (signal + sigma * noise + 0.5) as u8;
                }
            }
        }
    }

    /// The empty floor without noise.
    pub(crate) fn background(&self) -> Picture {
        let [red, green, blue] = self
            .floor
            .each_ref()
            .map(|plane| plane.iter().map(|v| (v + 0.5) as u8).collect());
        Picture {
            size: self.size,
            red,
            green,
            blue,
        }
    }
}

/// A rectangle of pixels.
struct Area {
    left: usize,
    top: usize,
    size: Size,
}

impl Area {
    /// Calls `change` with each pixel of the rectangle in a plane and its coverage.
    fn for_each_pixel(
        &self,
        plane: &mut [f32],
        size: Size,
        coverage: &[f32],
        change: impl Fn(&mut f32, f32),
    ) {
        for (y, coverage) in coverage
            .chunks_exact(self.size.width)
            .take(self.size.height)
            .enumerate()
        {
            let row = &mut plane[(self.top + y) * size.width + self.left..][..self.size.width];
            row.iter_mut()
                .zip(coverage)
                .for_each(|(pixel, &share)| change(pixel, share));
        }
    }
}

/// Grey-brown tiles with joints and a grain, already blurred.
fn floor(size: Size, seed: u64) -> [Vec<f32>; 3] {
    const TILE_PX: usize = 96;
    const COLOUR: [f32; 3] = [158.0, 150.0, 138.0];
    let mut random = SplitMix64(seed);
    let grain: Vec<f32> = (0..size.area()).map(|_| gaussian(&mut random)).collect();
    let tile: Vec<f32> = (0..64)
        .map(|_| 1.0 + 0.02 * gaussian(&mut random))
        .collect();
    COLOUR.map(|base| {
        let pixel = |i: usize| {
            let (x, y) = (i % size.width, i / size.width);
            let joint = x % TILE_PX == 0 || y % TILE_PX == 0;
            let tile = tile[(x / TILE_PX + 8 * (y / TILE_PX)) % tile.len()];
            base * tile * if joint { 0.86 } else { 1.0 } + 4.0 * grain[i]
        };
        let mut plane: Vec<f32> = (0..size.area()).map(pixel).collect();
        blur(&mut plane, size, 1.0, &mut vec![0.0; size.area()]);
        plane
    })
}

/// Standard normal, by the transform of Box and Muller.
fn gaussian(random: &mut SplitMix64) -> f32 {
    let mut unit = || ((random.bits() >> 40) as f32 + 0.5) / (1u64 << 24) as f32;
    let (u, v) = (unit(), unit());
    (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
}
