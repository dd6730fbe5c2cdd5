//! The colour that tells a marker from its plate.
//!
//! The paper splits by intensity, which is one direction of colour space. A red marker on white is as bright as a shadow on it; along
//! the line from white to red the two are far apart. Here that line is the main direction of the shape's chromaticities.

use imgproc::{Bounds, Size};

use crate::frame::Picture;

/// Standard deviation of the chromaticities along their main direction, grey levels, from which on there is a colour.
const SPREAD_MIN: f32 = 10.0;

/// Levels of the plate and of the marker in the projection.
const PLATE_LEVEL: f32 = 230.0;
const MARKER_LEVEL: f32 = 40.0;

/// Differences of colour are not magnified more than this, and their noise with them.
const GAIN_MAX: f32 = 2.0;

/// Sums over some pixels.
#[derive(Debug, Default, Clone, Copy)]
struct Moments {
    n: f32,
    saturation: f32,
    u: f32,
    v: f32,
    uu: f32,
    uv: f32,
    vv: f32,
}

/// Projects the colours of a rectangle so that what is colourless is light and what is not is dark. `mask` says which pixels of the rectangle
/// count for the choice of the direction; all are projected.
///
/// Returns by how much the noise of a channel grows; `None` where there is no colour.
pub(crate) fn project(
    picture: &Picture,
    bounds: Bounds,
    mask: &[u8],
    out: &mut [u8],
) -> Option<f32> {
    let size = bounds.size();
    assert_eq!(mask.len(), size.area(), "mask does not fit the rectangle");
    assert_eq!(out.len(), size.area(), "out does not fit the rectangle");
    let pixel = |i: usize| colour(picture, bounds, size, i);
    let counted = || (0..mask.len()).filter(|&i| mask[i] != 0).map(pixel);

    let all = moments(counted());
    let (u, v) = (all.u / all.n, all.v / all.n);
    let (uu, uv, vv) = (
        all.uu / all.n - u * u,
        all.uv / all.n - u * v,
        all.vv / all.n - v * v,
    );
    let root = ((uu - vv) * (uu - vv) / 4.0 + uv * uv).sqrt();
    let spread = (uu + vv) / 2.0 + root;
    // Without pixels it is not a number.
    if spread.is_nan() || spread < SPREAD_MIN * SPREAD_MIN {
        return None;
    }
    let angle = 0.5 * (2.0 * uv).atan2(uu - vv);
    let (b, a) = angle.sin_cos();
    let along = |[r, g, blue]: [f32; 3]| a * (r - g) + b * (blue - g);
    let middle = a * u + b * v;

    let beyond = moments(counted().filter(|&c| along(c) >= middle));
    let before = moments(counted().filter(|&c| along(c) < middle));
    let mean = |m: Moments| (a * m.u + b * m.v) / m.n.max(1.0);
    let grey = |m: Moments| -m.saturation / m.n.max(1.0);
    let (plate, marker) = if grey(beyond) >= grey(before) {
        (mean(beyond), mean(before))
    } else {
        (mean(before), mean(beyond))
    };
    let apart = marker - plate;
    let gain = ((PLATE_LEVEL - MARKER_LEVEL) / apart.abs()).min(GAIN_MAX);
    for (i, out) in out.iter_mut().enumerate() {
        let towards_marker = (along(pixel(i)) - plate) * apart.signum();
        *out = (PLATE_LEVEL - gain * towards_marker).round() as u8;
    }
    Some(gain * (a * a + b * b + (a + b) * (a + b)).sqrt())
}

fn colour(picture: &Picture, bounds: Bounds, size: Size, i: usize) -> [f32; 3] {
    let (x, y) = (i % size.width, i / size.width);
    let at = (usize::from(bounds.top) + y) * picture.size.width + usize::from(bounds.left) + x;
    [&picture.red, &picture.green, &picture.blue].map(|plane| f32::from(plane[at]))
}

/// Chromaticity is red and blue, each less green.
fn moments(colours: impl Iterator<Item = [f32; 3]>) -> Moments {
    let mut sums = Moments::default();
    for [r, g, b] in colours {
        let (u, v) = (r - g, b - g);
        sums.n += 1.0;
        sums.saturation += r.max(g).max(b) - r.min(g).min(b);
        sums.u += u;
        sums.v += v;
        sums.uu += u * u;
        sums.uv += u * v;
        sums.vv += v * v;
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use imgproc::Point;

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
