//! What the camera looks at, drawn with its truth.

use imgproc::Size;

use crate::body::{Body, Colour};
use crate::floor::Floor;
use crate::judge::Region;
use crate::shadow::Shadow;

/// Points of a pixel along each axis, as distances from its centre.
pub(crate) const SUBSAMPLES: [f32; 4] = [-0.375, -0.125, 0.125, 0.375];

/// A scene under full, even light, and what is where.
#[derive(Debug, Clone)]
pub(crate) struct Canvas {
    pub(crate) size: Size,
    pub(crate) pixels: Vec<Colour>,
    /// The bodies, in the order in which they were drawn.
    pub(crate) bodies: Vec<Region>,
    /// Points that lie in some body.
    pub(crate) truth: Vec<u16>,
    /// Share of the light that arrives on the floor at each pixel.
    pub(crate) light_left: Vec<f32>,
}

/// Pixels that a thing may touch.
struct Tile {
    left: usize,
    top: usize,
    width: usize,
    values: Vec<[f32; 4]>,
}

impl Canvas {
    /// A floor without anything.
    pub(crate) fn new(floor: Floor, size: Size) -> Self {
        Self {
            size,
            pixels: floor.pixels(size),
            bodies: Vec::new(),
            truth: vec![0; size.area()],
            light_left: vec![1.0; size.area()],
        }
    }

    /// This floor with things: shadows lie on the floor, bodies stand above it in their order.
    pub(crate) fn with(&self, bodies: &[Body], shadows: &[Shadow]) -> Self {
        let mut canvas = self.clone();
        for shadow in shadows {
            canvas.cast(shadow);
        }
        for body in bodies {
            canvas.draw(body);
            let region = Region::of_body(body, self.size);
            region.add_to(&mut canvas.truth, self.size.width);
            canvas.bodies.push(region);
        }
        canvas
    }

    /// A floor to which all belongs that stands here now.
    pub(crate) fn as_floor(&self) -> Self {
        Self {
            bodies: Vec::new(),
            truth: vec![0; self.size.area()],
            ..self.clone()
        }
    }

    /// Mean colour of all pixels.
    pub(crate) fn mean(&self) -> Colour {
        let mut sum = [0.0; 3];
        for pixel in &self.pixels {
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += f64::from(*value);
            }
        }
        sum.map(|sum| (sum / self.pixels.len() as f64) as f32)
    }

    fn cast(&mut self, shadow: &Shadow) {
        let covered = shadow.covered();
        let tile = sampled(self.size, shadow.at, shadow.reach(), |point| {
            [covered(point), 0.0, 0.0, 0.0]
        });
        self.for_each(&tile, |pixel, light_left, [covered, ..]| {
            for (value, left) in pixel.iter_mut().zip(shadow.left) {
                *value *= 1.0 - covered * (1.0 - left);
            }
            *light_left *= 1.0 - covered * (1.0 - shadow.left[1]);
        });
    }

    fn draw(&mut self, body: &Body) {
        let colour = body.colours();
        let tile = sampled(self.size, body.at, body.shape.reach(), |point| {
            colour(point).map_or([0.0; 4], |[r, g, b]| [r, g, b, 1.0])
        });
        self.for_each(&tile, |pixel, _, [r, g, b, opacity]| {
            for (value, own) in pixel.iter_mut().zip([r, g, b]) {
                *value = *value * (1.0 - opacity) + own;
            }
        });
    }

    fn for_each(&mut self, tile: &Tile, mut apply: impl FnMut(&mut Colour, &mut f32, [f32; 4])) {
        for (y, row) in tile.values.chunks_exact(tile.width.max(1)).enumerate() {
            let start = (tile.top + y) * self.size.width + tile.left;
            for (x, &value) in row.iter().enumerate() {
                apply(
                    &mut self.pixels[start + x],
                    &mut self.light_left[start + x],
                    value,
                );
            }
        }
    }
}

/// Rows or columns of a picture within `reach` of a centre, and 3 more for the lens.
pub(crate) fn span(centre: f32, reach: f32, length: usize) -> std::ops::Range<usize> {
    let from = (centre - reach - 3.0).floor().max(0.0) as usize;
    let to = (centre + reach + 4.0).ceil().max(0.0) as usize;
    from.min(length)..to.min(length)
}

/// Means of a function over the points of each pixel, through the lens.
fn sampled(size: Size, at: [f32; 2], reach: f32, value: impl Fn([f32; 2]) -> [f32; 4]) -> Tile {
    let (columns, rows) = (
        span(at[0], reach, size.width),
        span(at[1], reach, size.height),
    );
    let mut values = Vec::with_capacity(columns.len() * rows.len());
    for y in rows.clone() {
        for x in columns.clone() {
            let mut sum = [0.0; 4];
            for dy in SUBSAMPLES {
                for dx in SUBSAMPLES {
                    let sample = value([x as f32 + dx, y as f32 + dy]);
                    for (sum, sample) in sum.iter_mut().zip(sample) {
                        *sum += sample / 16.0;
                    }
                }
            }
            values.push(sum);
        }
    }
    blur(&mut values, columns.len());
    Tile {
        left: columns.start,
        top: rows.start,
        width: columns.len(),
        values,
    }
}

/// A Gaussian of sigma 0.6 px at distances of 0, 1 and 2: an ordinary lens in focus.
const LENS: [f32; 3] = [0.6638, 0.1655, 0.0026];

/// Blurs rows and columns; at the border, the border goes on.
pub(crate) fn blur(pixels: &mut [[f32; 4]], width: usize) {
    if pixels.is_empty() {
        return;
    }
    let height = pixels.len() / width;
    let (mut row, mut column) = (vec![[0.0; 4]; width], vec![[0.0; 4]; height]);
    for y in 0..height {
        let line = &mut pixels[y * width..][..width];
        row.copy_from_slice(line);
        for (x, pixel) in line.iter_mut().enumerate() {
            *pixel = weighted(&row, x);
        }
    }
    for x in 0..width {
        for (y, value) in column.iter_mut().enumerate() {
            *value = pixels[y * width + x];
        }
        for y in 0..height {
            pixels[y * width + x] = weighted(&column, y);
        }
    }
}

fn weighted(line: &[[f32; 4]], at: usize) -> [f32; 4] {
    let last = line.len() - 1;
    let mut sum = line[at].map(|value| LENS[0] * value);
    for (distance, weight) in LENS.iter().enumerate().skip(1) {
        let before = line[at.saturating_sub(distance)];
        let after = line[(at + distance).min(last)];
        for (i, sum) in sum.iter_mut().enumerate() {
            *sum += weight * (before[i] + after[i]);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::{Paint, Shape, WHITE};
    use crate::shadow::neutral;

    #[test]
    fn things_and_their_truth_are_where_they_should_be() {
        let size = Size {
            width: 80,
            height: 60,
        };
        let body = Body {
            shape: Shape::Disc(10.0),
            paint: Paint::Plain(WHITE),
            at: [20.3, 30.6],
            heading_rad: 1.0,
        };
        let shadow = Shadow::of(&body, [30.0, 0.0], neutral(0.6), 4.0);
        let canvas = Canvas::new(Floor::Grey, size).with(&[body], &[shadow]);
        let area_px = canvas.bodies[0].area() as f32 / 16.0;
        assert!(
            (area_px / (100.0 * std::f32::consts::PI) - 1.0).abs() < 0.01,
            "{area_px}"
        );
        let at = |x: usize, y: usize| canvas.pixels[y * size.width + x][0];
        assert!((at(20, 30) - WHITE[0]).abs() < 0.1);
        assert!((at(50, 30) - 72.0).abs() < 0.1);
        assert!((at(75, 30) - 120.0).abs() < 0.1);
        // Brightness is neither won nor lost at the edge: what the disc adds is its area times its
        // contrast.
        let added: f32 = canvas.pixels[..]
            .chunks_exact(size.width)
            .flat_map(|row| &row[..35])
            .map(|pixel| pixel[0] - 120.0)
            .sum();
        let expected = area_px * (WHITE[0] - 120.0);
        assert!(
            (added / expected - 1.0).abs() < 0.01,
            "{added}, not {expected}"
        );
        // Half of the light that the shadow takes is missing at its edge, 10 px from its centre.
        let left = canvas.light_left[31 * size.width + 60];
        assert!((left - 0.8).abs() < 0.05, "{left}");
        assert!((canvas.light_left[31 * size.width + 50] - 0.6).abs() < 1e-3);
    }
}
