//! Floors with plates, drawn point by point, with their truth.

use imgproc::Size;
use overcam::image::frame::{Frame, PixelFormat};

use crate::random::Random;
use crate::viewpoint::Viewpoint;

/// Sample points per pixel along each axis.
const SUBSAMPLES: usize = 10;

/// Effects of camera and light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Conditions {
    /// Side of the plates, in pixels.
    pub(crate) plate_px: f32,
    /// Standard deviation of the lens blur, in pixels.
    pub(crate) blur_px: f32,
    /// Standard deviation of the noise of a pixel, in grey levels.
    pub(crate) noise: f32,
    /// Increase of the light over 100 px to the right.
    pub(crate) slope: f32,
    /// Any other disturbance.
    pub(crate) disturbance: Disturbance,
    /// Where the camera looks from, and through what.
    pub(crate) viewpoint: Viewpoint,
    /// Light is this power of a grey level.
    pub(crate) gamma: f32,
    /// Share of its difference from a softer picture that the camera adds.
    pub(crate) sharpening: f32,
}

/// Disturbances on real floors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Disturbance {
    None,
    /// Everything moves by this many pixels during the exposure, in any direction.
    Motion(f32),
    /// The lens is out of focus: radius in pixels of the disc that a point becomes.
    Defocus(f32),
    /// The edge of a shadow crosses every plate; the share of light in it.
    Shadow(f32),
    /// Light falls off across every plate; the share of light at the dark side.
    Falloff(f32),
    /// A lamp is reflected on every plate; radius of the white spot, as a share of the plate's
    /// side.
    Glare(f32),
    /// Something of any grey level lies across the side or a corner of every plate; the share of
    /// the plate under it.
    Covered(f32),
    /// Frames are JPEG of this quality.
    Jpeg(u8),
    /// Groups of four pixels share their chroma.
    Subsampled,
    /// Plates are at the left border, with up to half of them outside the picture.
    Border,
    /// Markers are so large that they touch the edges of their plates.
    Touching,
}

/// Colours of the scene.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Palette {
    pub(crate) floor: [f32; 3],
    pub(crate) paper: [f32; 3],
    pub(crate) ink: [f32; 3],
}

/// Black on white on grey, seen by a grey camera.
pub(crate) const GREY: Palette = Palette {
    floor: [120.0; 3],
    paper: [225.0; 3],
    ink: [40.0; 3],
};

/// The robot under a plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Robot {
    /// The plate lies on the floor.
    None,
    /// A dark, round robot.
    Dark,
    /// A frame of this grey level around the plate.
    Rim(f32),
}

/// A figure on its plate.
#[derive(Debug, Clone)]
pub(crate) struct Plate<'a> {
    pub(crate) figure: &'a [[f32; 2]],
    pub(crate) centre: [f32; 2],
    /// Rotation of the drawing.
    pub(crate) turn_rad: f32,
    pub(crate) robot: Robot,
    /// Where shadow, light and glare come from, relative to this plate: any direction, and a
    /// distance from 0 to 1.
    pub(crate) light: [f32; 2],
}

/// Light that a camera with a tone curve shows as a grey level; both 0 to 255.
fn light_of(grey: f32, gamma: f32) -> f32 {
    255.0 * (grey / 255.0).powf(gamma)
}

fn grey_of(light: f32, gamma: f32) -> f32 {
    if gamma == 1.0 {
        light
    } else {
        255.0 * (light / 255.0).powf(1.0 / gamma)
    }
}

impl Palette {
    fn lit(&self, gamma: f32) -> Self {
        let lit = |colour: [f32; 3]| colour.map(|grey| light_of(grey, gamma));
        Self {
            floor: lit(self.floor),
            paper: lit(self.paper),
            ink: lit(self.ink),
        }
    }
}

impl Plate<'_> {
    /// Light at a point relative to the centre; `None` beside the plate and its robot. The sine
    /// and cosine are those of its rotation.
    fn colour(
        &self,
        [x, y]: [f32; 2],
        (sin, cos): (f32, f32),
        plate_px: f32,
        palette: &Palette,
        gamma: f32,
    ) -> Option<[f32; 3]> {
        let at = [
            (cos * x + sin * y) / plate_px,
            (cos * y - sin * x) / plate_px,
        ];
        let border = at[0].abs().max(at[1].abs());
        if border <= 0.5 {
            return Some(if contains(self.figure, at) {
                palette.ink
            } else {
                palette.paper
            });
        }
        match self.robot {
            Robot::Dark if x.hypot(y) < plate_px * 0.75 + 3.0 => Some([light_of(25.0, gamma); 3]),
            Robot::Rim(grey) if border <= 0.5 + 3.0 / plate_px => Some([light_of(grey, gamma); 3]),
            _ => None,
        }
    }
}

/// Whether a point is inside a polygon.
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

/// A camera's picture of plates: a grey camera if all colours are grey.
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
    let palette = &palette.lit(conditions.gamma);
    let mut planes: Vec<Vec<f32>> = (0..channels)
        .map(|channel| vec![palette.floor[channel]; size.area()])
        .collect();
    for plate in plates {
        draw(&mut planes, size, plate, palette, conditions);
    }
    for plate in plates {
        light(&mut planes, size, plate, conditions);
    }
    let direction = random.uniform(0.0, std::f32::consts::TAU);
    for plane in &mut planes {
        *plane = blurred(plane, size, conditions.blur_px);
        match conditions.disturbance {
            Disturbance::Motion(length) => *plane = smeared(plane, size, length, direction),
            Disturbance::Defocus(radius) => *plane = defocused(plane, size, radius),
            _ => {}
        }
    }
    frame.size = size;
    frame.format = if is_grey {
        PixelFormat::Grey
    } else {
        PixelFormat::Rgb
    };
    frame.full_range = true;
    frame.bytes.clear();
    // Full light at the right border, so that white does not exceed the sensor's range.
    let light_at = |x: f32| 1.0 + conditions.slope * (x - size.width as f32 / 2.0) / 100.0;
    for plane in &mut planes {
        for (i, value) in plane.iter_mut().enumerate() {
            let lit = light_at((i % size.width) as f32) / light_at(size.width as f32);
            let grey = grey_of(*value * lit, conditions.gamma);
            *value = grey + conditions.noise * random.normal();
        }
        if conditions.sharpening != 0.0 {
            let soft = blurred(plane, size, 1.0);
            for (value, soft) in plane.iter_mut().zip(soft) {
                *value += conditions.sharpening * (*value - soft);
            }
        }
    }
    for i in 0..size.area() {
        let seen = planes
            .iter()
            .map(|plane| plane[i].round().clamp(0.0, 255.0) as u8);
        frame.bytes.extend(seen);
    }
    match conditions.disturbance {
        Disturbance::Jpeg(quality) => compress(frame, quality),
        Disturbance::Subsampled => subsample(frame),
        _ => {}
    }
}

/// Adds shadow, falloff and glare around one plate.
fn light(planes: &mut [Vec<f32>], size: Size, plate: &Plate<'_>, conditions: &Conditions) {
    let side = conditions.plate_px;
    let [direction, distance] = plate.light;
    let (sin, cos) = direction.sin_cos();
    let reach = side * 0.75 + 12.0;
    let cover = match conditions.disturbance {
        Disturbance::Covered(share) => Some(cover_from(share, direction - plate.turn_rad) * side),
        _ => None,
    };
    let cover_light = light_of(20.0 + 200.0 * distance, conditions.gamma);
    for y in span(plate.centre[1], reach, size.height) {
        for x in span(plate.centre[0], reach, size.width) {
            let [dx, dy] = [x as f32 - plate.centre[0], y as f32 - plate.centre[1]];
            let along = cos * dx + sin * dy;
            let across = cos * dy - sin * dx;
            if cover.is_some_and(|from| along > from) && across.abs() < 0.7 * side {
                for plane in &mut *planes {
                    plane[y * size.width + x] = cover_light;
                }
                continue;
            }
            let lit = |value: f32| match conditions.disturbance {
                Disturbance::Shadow(share) if along > (distance - 0.5) * side * 0.7 => {
                    value * share
                }
                Disturbance::Falloff(share) => {
                    let at = (along / side + 0.5).clamp(0.0, 1.0);
                    value * (1.0 + at * (share - 1.0))
                }
                Disturbance::Glare(radius) => {
                    let [gx, gy] = [cos, sin].map(|d| d * distance * side * 0.5);
                    let r = (dx - gx).hypot(dy - gy) / (radius * side);
                    // White in its middle, and zero at its radius.
                    value + 400.0 * (1.0 - r).clamp(0.0, 0.6)
                }
                _ => value,
            };
            for plane in &mut *planes {
                let value = &mut plane[y * size.width + x];
                *value = lit(*value).min(255.0);
            }
        }
    }
}

/// Distance from the centre of a plate, in units of its side, beyond which this share of it lies in a
/// direction.
fn cover_from(share: f32, direction: f32) -> f32 {
    const ACROSS: usize = 60;
    let (sin, cos) = direction.sin_cos();
    let at = |i: usize| (i as f32 + 0.5) / ACROSS as f32 - 0.5;
    let mut along: Vec<f32> = (0..ACROSS * ACROSS)
        .map(|i| cos * at(i % ACROSS) + sin * at(i / ACROSS))
        .collect();
    along.sort_by(f32::total_cmp);
    along[((1.0 - share) * (along.len() - 1) as f32) as usize]
}

/// Indices of a row or column that are at most `reach` from a point.
fn span(centre: f32, reach: f32, length: usize) -> std::ops::Range<usize> {
    (centre - reach).max(0.0) as usize..((centre + reach).max(0.0) as usize + 1).min(length)
}

/// A plane with motion blur along a straight line.
fn smeared(plane: &[f32], size: Size, length: f32, direction: f32) -> Vec<f32> {
    const STEPS: usize = 9;
    let (sin, cos) = direction.sin_cos();
    let offsets: Vec<[f32; 2]> = (0..STEPS)
        .map(|i| length * ((i as f32 + 0.5) / STEPS as f32 - 0.5))
        .map(|d| [d * cos, d * sin])
        .collect();
    mean_of_shifted(plane, size, &offsets)
}

/// A plane through a defocused lens, which turns points into discs.
fn defocused(plane: &[f32], size: Size, radius: f32) -> Vec<f32> {
    const ACROSS: usize = 9;
    let at = |i: usize| radius * (2.0 * (i as f32 + 0.5) / ACROSS as f32 - 1.0);
    let offsets: Vec<[f32; 2]> = (0..ACROSS * ACROSS)
        .map(|i| [at(i % ACROSS), at(i / ACROSS)])
        .filter(|[x, y]| x.hypot(*y) <= radius)
        .collect();
    mean_of_shifted(plane, size, &offsets)
}

fn mean_of_shifted(plane: &[f32], size: Size, offsets: &[[f32; 2]]) -> Vec<f32> {
    let row = |y: isize| {
        let y = y.clamp(0, size.height as isize - 1) as usize;
        &plane[y * size.width..][..size.width]
    };
    let mut out = vec![0.0; plane.len()];
    for &[dx, dy] in offsets {
        let [left, top] = [dx, dy].map(|d| d.floor() as isize);
        let [fx, fy] = [dx - dx.floor(), dy - dy.floor()];
        for (y, out) in out.chunks_exact_mut(size.width).enumerate() {
            let y = y as isize + top;
            let rows = [row(y), row(y + 1)];
            for (x, out) in out.iter_mut().enumerate() {
                let x = x as isize + left;
                let [x, next] = [x, x + 1].map(|x| x.clamp(0, size.width as isize - 1) as usize);
                let [above, below] = rows.map(|row| row[x] * (1.0 - fx) + row[next] * fx);
                *out += (above * (1.0 - fy) + below * fy) / offsets.len() as f32;
            }
        }
    }
    out
}

/// Compresses the frame as a camera with a JPEG encoder does.
fn compress(frame: &mut Frame, quality: u8) {
    let [width, height] = [frame.size.width, frame.size.height].map(|side| side as u32);
    let colours = match frame.format {
        PixelFormat::Grey => image::ExtendedColorType::L8,
        _ => image::ExtendedColorType::Rgb8,
    };
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(&frame.bytes, width, height, colours)
        .expect("a picture that can be compressed");
    frame.bytes = bytes;
    frame.format = PixelFormat::Jpeg;
}

/// Converts RGB to luma and quarter-resolution chroma, by BT.601 with full range.
fn subsample(frame: &mut Frame) {
    let [width, height] = [frame.size.width, frame.size.height];
    let rgb = |x: usize, y: usize| {
        let i = 3 * (y * width + x);
        [0, 1, 2].map(|channel| f32::from(frame.bytes[i + channel]))
    };
    let byte = |value: f32| value.round().clamp(0.0, 255.0) as u8;
    let mut out = Vec::with_capacity(width * height * 3 / 2);
    for i in 0..width * height {
        let [r, g, b] = rgb(i % width, i / width);
        out.push(byte(0.299 * r + 0.587 * g + 0.114 * b));
    }
    for chroma in [[-0.168_736, -0.331_264, 0.5], [0.5, -0.418_688, -0.081_312]] {
        for i in 0..width / 2 * (height / 2) {
            let [x, y] = [2 * (i % (width / 2)), 2 * (i / (width / 2))];
            let of = |x: usize, y: usize| {
                let rgb = rgb(x, y);
                (0..3).map(|c| chroma[c] * rgb[c]).sum::<f32>()
            };
            let sum = of(x, y) + of(x + 1, y) + of(x, y + 1) + of(x + 1, y + 1);
            out.push(byte(128.0 + sum / 4.0));
        }
    }
    frame.bytes = out;
    frame.format = PixelFormat::I420;
}

fn draw(
    planes: &mut [Vec<f32>],
    size: Size,
    plate: &Plate<'_>,
    palette: &Palette,
    conditions: &Conditions,
) {
    let Conditions {
        plate_px,
        viewpoint,
        gamma,
        ..
    } = *conditions;
    let to_floor = |point: [f32; 2]| viewpoint.to_floor(point, size);
    let centre = to_floor(plate.centre);
    // As large in the picture everywhere.
    let side = plate_px * viewpoint.floor_per_px(plate.centre, size);
    let turn = plate.turn_rad.sin_cos();
    let reach = if viewpoint == Viewpoint::ABOVE {
        plate_px * 0.75 + 6.0
    } else {
        plate_px * 1.2 + 9.0
    };
    for y in span(plate.centre[1], reach, size.height) {
        for x in span(plate.centre[0], reach, size.width) {
            let at = y * size.width + x;
            let mut before = [0.0; 3];
            for (before, plane) in before.iter_mut().zip(&*planes) {
                *before = plane[at];
            }
            // Within a pixel, every camera is affine to a thousandth of a pixel.
            let [left, right, top, bottom] = [[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]]
                .map(|[dx, dy]| to_floor([x as f32 + dx, y as f32 + dy]));
            let of_x = [0, 1].map(|i: usize| right[i] - left[i]);
            let of_y = [0, 1].map(|i: usize| bottom[i] - top[i]);
            let from_centre =
                [0, 1].map(|i: usize| (left[i] + right[i] + top[i] + bottom[i]) / 4.0 - centre[i]);
            let mut sums = [0.0; 3];
            for i in 0..SUBSAMPLES * SUBSAMPLES {
                let offset = |i: usize| (i as f32 + 0.5) / SUBSAMPLES as f32 - 0.5;
                let [dx, dy] = [offset(i % SUBSAMPLES), offset(i / SUBSAMPLES)];
                let point = [0, 1].map(|i: usize| from_centre[i] + dx * of_x[i] + dy * of_y[i]);
                let colour = plate
                    .colour(point, turn, side, palette, gamma)
                    .unwrap_or(before);
                for (sum, value) in sums.iter_mut().zip(colour) {
                    *sum += value / (SUBSAMPLES * SUBSAMPLES) as f32;
                }
            }
            for (plane, value) in planes.iter_mut().zip(sums) {
                plane[at] = value;
            }
        }
    }
}

/// A plane through a Gaussian lens.
fn blurred(plane: &[f32], size: Size, sigma: f32) -> Vec<f32> {
    let reach = (4.0 * sigma).ceil() as isize;
    let weights: Vec<(isize, f32)> = (-reach..=reach)
        .map(|d| (d, (-((d * d) as f32) / (2.0 * sigma * sigma)).exp()))
        .collect();
    let total: f32 = weights.iter().map(|(_, weight)| weight).sum();
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
                let sum: f32 = weights.iter().map(|&(d, weight)| weight * at(d)).sum();
                out[y as usize * size.width + x as usize] = sum / total;
            }
        }
    }
    out
}
