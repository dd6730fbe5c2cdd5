//! The colour that separates a marker from its plate.
//!
//! The paper separates by intensity, which is one direction of colour space. A red marker on white
//! is as bright as a shadow on it, but along the line from white to red the two are far apart. That
//! line is found as the principal axis of the shape's chromaticities.

use imgproc::Bounds;

use crate::image::frame::Picture;

/// Minimum standard deviation of the chromaticities along their principal axis, grey levels. Below
/// it there is no colour.
const SPREAD_MIN: f32 = 10.0;

/// Levels of plate and marker in the projection.
const PLATE_LEVEL: f32 = 230.0;
const MARKER_LEVEL: f32 = 40.0;

/// Maximum amplification of colour differences, and thus of their noise.
const GAIN_MAX: f32 = 2.0;

/// Sums over a set of pixels: of 1, the saturation, the chromaticity and its products.
#[derive(Debug, Default, Clone, Copy)]
struct Moments {
    n: i64,
    saturation: i64,
    u: i64,
    v: i64,
    uu: i64,
    uv: i64,
    vv: i64,
}

/// Intensity of a rectangle of the picture: luma in 8 bits (BT.601).
pub(crate) fn intensity(picture: &Picture, bounds: Bounds, grey: &mut [u8]) {
    let width = bounds.size().width;
    for (y, grey) in grey.chunks_exact_mut(width).enumerate() {
        let start = (usize::from(bounds.top) + y) * picture.size.width + usize::from(bounds.left);
        let row = start..start + width;
        let (red, green, blue) = (
            &picture.red[row.clone()],
            &picture.green[row.clone()],
            &picture.blue[row],
        );
        for (((grey, &r), &g), &b) in grey.iter_mut().zip(red).zip(green).zip(blue) {
            *grey = ((77 * u32::from(r) + 150 * u32::from(g) + 29 * u32::from(b) + 128) >> 8) as u8;
        }
    }
}

/// Projects the colours of a rectangle so that colourless pixels are light and coloured ones are
/// dark. `mask` selects the pixels used to choose the direction; all pixels are projected.
///
/// Returns the factor by which the noise of a channel grows; `None` if there is no colour.
pub(crate) fn project(
    picture: &Picture,
    bounds: Bounds,
    mask: &[u8],
    out: &mut [u8],
) -> Option<f32> {
    let size = bounds.size();
    assert_eq!(mask.len(), size.area(), "mask does not fit the rectangle");
    assert_eq!(out.len(), size.area(), "out does not fit the rectangle");

    let mut all = Moments::default();
    each_counted(picture, bounds, mask, |colour| all.add(colour));
    let n = all.n as f32;
    let [u, v] = [all.u, all.v].map(|sum| sum as f32 / n);
    let uu = all.uu as f32 / n - u * u;
    let uv = all.uv as f32 / n - u * v;
    let vv = all.vv as f32 / n - v * v;
    let root = ((uu - vv) * (uu - vv) / 4.0 + uv * uv).sqrt();
    let spread = (uu + vv) / 2.0 + root;
    // NaN if the mask is empty.
    if spread.is_nan() || spread < SPREAD_MIN * SPREAD_MIN {
        return None;
    }
    let angle = 0.5 * (2.0 * uv).atan2(uu - vv);
    let (b, a) = angle.sin_cos();
    let along = |colour: [u8; 3]| {
        let [u, v] = chromaticity(colour);
        a * u as f32 + b * v as f32
    };
    let middle = a * u + b * v;

    let mut sides = [Moments::default(); 2];
    each_counted(picture, bounds, mask, |colour| {
        sides[usize::from(along(colour) >= middle)].add(colour);
    });
    let mean = |m: Moments| (a * m.u as f32 + b * m.v as f32) / m.n.max(1) as f32;
    let grey = |m: Moments| -m.saturation as f32 / m.n.max(1) as f32;
    let [before, beyond] = sides;
    let (plate, marker) = if grey(beyond) >= grey(before) {
        (mean(beyond), mean(before))
    } else {
        (mean(before), mean(beyond))
    };
    let apart = marker - plate;
    let gain = ((PLATE_LEVEL - MARKER_LEVEL) / apart.abs()).min(GAIN_MAX);
    for (out, colours) in out.chunks_exact_mut(size.width).zip(rows(picture, bounds)) {
        for (out, colour) in out.iter_mut().zip(colours) {
            let towards_marker = (along(colour) - plate) * apart.signum();
            // Rounded; the cast turns negative values into zero.
            *out = (PLATE_LEVEL - gain * towards_marker + 0.5) as u8;
        }
    }
    Some(gain * (a * a + b * b + (a + b) * (a + b)).sqrt())
}

/// The colours of a rectangle, row by row.
fn rows(
    picture: &Picture,
    bounds: Bounds,
) -> impl Iterator<Item = impl Iterator<Item = [u8; 3]> + '_> + '_ {
    let (left, width) = (usize::from(bounds.left), bounds.size().width);
    (bounds.top..=bounds.bottom).map(move |y| {
        let start = usize::from(y) * picture.size.width + left;
        let [red, green, blue] =
            [&picture.red, &picture.green, &picture.blue].map(|plane| &plane[start..start + width]);
        let colours = red.iter().zip(green).zip(blue);
        colours.map(|((&red, &green), &blue)| [red, green, blue])
    })
}

/// Calls `found` with the colours of the masked pixels of a rectangle.
fn each_counted(picture: &Picture, bounds: Bounds, mask: &[u8], mut found: impl FnMut([u8; 3])) {
    let width = bounds.size().width;
    for (mask, colours) in mask.chunks_exact(width).zip(rows(picture, bounds)) {
        let counted = mask.iter().zip(colours).filter(|(mask, _)| **mask != 0);
        counted.for_each(|(_, colour)| found(colour));
    }
}

/// Red minus green, and blue minus green.
fn chromaticity([red, green, blue]: [u8; 3]) -> [i32; 2] {
    [red, blue].map(|channel| i32::from(channel) - i32::from(green))
}

impl Moments {
    fn add(&mut self, colour: [u8; 3]) {
        let [u, v] = chromaticity(colour);
        let [red, green, blue] = colour;
        let saturation = red.max(green).max(blue) - red.min(green).min(blue);
        self.n += 1;
        self.saturation += i64::from(saturation);
        self.u += i64::from(u);
        self.v += i64::from(v);
        self.uu += i64::from(u * u);
        self.uv += i64::from(u * v);
        self.vv += i64::from(v * v);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imgproc::{Point, Size};

    /// A row of pixels.
    fn projected(colours: &[[u8; 3]]) -> Option<Vec<u8>> {
        let size = Size {
            width: colours.len(),
            height: 1,
        };
        let mut picture = Picture::new(size);
        for (i, &[r, g, b]) in colours.iter().enumerate() {
            (picture.red[i], picture.green[i], picture.blue[i]) = (r, g, b);
        }
        let bounds = Bounds::of(Point { x: 0, y: 0 }).with(Point {
            x: colours.len() as u16 - 1,
            y: 0,
        });
        let mut out = vec![0; colours.len()];
        project(&picture, bounds, &vec![1; colours.len()], &mut out).map(|_| out)
    }

    #[test]
    fn white_is_light_and_colours_are_dark_in_light_and_shade() {
        for colour in [[200, 40, 40], [40, 60, 190], [30, 140, 60], [220, 190, 30]] {
            let white = [230, 230, 230];
            let shaded = [140, 140, 140];
            let row = [white, white, shaded, colour, colour];
            let out = projected(&row).expect("a colour");
            assert!(out[..3].iter().all(|&v| v > 200), "{colour:?}: {out:?}");
            assert!(out[3..].iter().all(|&v| v < 80), "{colour:?}: {out:?}");
        }
    }

    #[test]
    fn grey_has_no_colour() {
        assert_eq!(projected(&[[230; 3], [40; 3], [120, 122, 119]]), None);
    }
}
