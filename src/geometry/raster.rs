//! Polygon rasterisation with exact coverage of each pixel, and lens blur.
//!
//! The demo floor and the marker references are drawn with this, so their ground truth is exact to
//! fractions of a pixel. A pixel is a square of side 1 around its centre, which has integer
//! coordinates.
//!
//! # Method
//!
//! Row by row, each edge adds the signed area between itself and the right border of the picture to
//! the pixels it crosses; prefix sums along the row convert that into coverage. Polygons are filled
//! by winding number; areas with winding number two count once.

use imgproc::Size;

/// A point, (x, y) in pixels.
pub(crate) type Vertex = [f32; 2];

/// Writes to `coverage` the share of each pixel inside a closed polygon, 0 to 1. The polygon may
/// extend beyond the picture.
///
/// # Panics
///
/// If the length of `coverage` is not `size.area()`.
pub(crate) fn fill_polygon(polygon: &[Vertex], size: Size, coverage: &mut [f32]) {
    assert_eq!(
        coverage.len(),
        size.area(),
        "coverage does not fit its size"
    );
    for (y, row) in coverage.chunks_exact_mut(size.width).enumerate() {
        row.fill(0.0);
        let (top, bottom) = (y as f32 - 0.5, y as f32 + 0.5);
        for (a, b) in edges(polygon) {
            if let Some((a, b)) = clip(a, b, top, bottom) {
                add_edge(row, a, b);
            }
        }
        let mut sum = 0.0;
        for pixel in row {
            sum += *pixel;
            *pixel = sum.abs().min(1.0);
        }
    }
}

/// Radius of the kernel of [`blur`], in standard deviations.
const BLUR_REACH: f32 = 3.0;

/// Blurs a plane with a Gaussian; border pixels are repeated outwards. The content of `scratch`
/// does not matter.
///
/// # Panics
///
/// If the length of a slice is not `size.area()`.
pub(crate) fn blur(plane: &mut [f32], size: Size, sigma_px: f32, scratch: &mut [f32]) {
    assert_eq!(plane.len(), size.area(), "plane does not fit its size");
    assert_eq!(scratch.len(), size.area(), "scratch does not fit its size");
    if sigma_px <= 0.0 || size.area() == 0 {
        return;
    }
    let reach = (BLUR_REACH * sigma_px).ceil() as isize;
    let weight = |d: isize| (-((d * d) as f32) / (2.0 * sigma_px * sigma_px)).exp();
    let total: f32 = (-reach..=reach).map(weight).sum();
    let kernel: Vec<f32> = (-reach..=reach).map(|d| weight(d) / total).collect();
    let taps = kernel.len();
    // Rows padded with their end values, so that no tap is out of range.
    let mut padded = vec![0.0; size.width + taps - 1];
    for (source, out) in plane
        .chunks_exact(size.width)
        .zip(scratch.chunks_exact_mut(size.width))
    {
        let (left, rest) = padded.split_at_mut(taps / 2);
        let (middle, right) = rest.split_at_mut(size.width);
        left.fill(source[0]);
        middle.copy_from_slice(source);
        right.fill(source[size.width - 1]);
        out.fill(0.0);
        for (tap, k) in kernel.iter().enumerate() {
            for (out, value) in out.iter_mut().zip(&padded[tap..]) {
                *out += k * value;
            }
        }
    }
    for (y, out) in plane.chunks_exact_mut(size.width).enumerate() {
        out.fill(0.0);
        for (tap, k) in kernel.iter().enumerate() {
            let row = (y + tap).saturating_sub(taps / 2).min(size.height - 1);
            let source = &scratch[row * size.width..][..size.width];
            for (out, value) in out.iter_mut().zip(source) {
                *out += k * value;
            }
        }
    }
}

/// The edges of a polygon, closing edge last.
fn edges(polygon: &[Vertex]) -> impl Iterator<Item = (Vertex, Vertex)> + '_ {
    polygon
        .iter()
        .copied()
        .zip(polygon.iter().copied().cycle().skip(1))
}

/// The part of an edge between two y coordinates.
fn clip(a: Vertex, b: Vertex, top: f32, bottom: f32) -> Option<(Vertex, Vertex)> {
    let (low, high) = (a[1].min(b[1]), a[1].max(b[1]));
    if low == high || high <= top || low >= bottom {
        return None;
    }
    let at = |y: f32| {
        let y = y.clamp(top, bottom);
        [a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]), y]
    };
    Some((
        if a[1] < top || a[1] > bottom {
            at(a[1])
        } else {
            a
        },
        if b[1] < top || b[1] > bottom {
            at(b[1])
        } else {
            b
        },
    ))
}

/// Adds an edge inside one row: afterwards, the prefix sum over `row` includes the area to the
/// right of the edge.
fn add_edge(row: &mut [f32], a: Vertex, b: Vertex) {
    // From pixel centres to pixel borders: pixel i is between i and i + 1.
    let (from, to, down) = if a[0] <= b[0] {
        (a[0] + 0.5, b[0] + 0.5, b[1] - a[1])
    } else {
        (b[0] + 0.5, a[0] + 0.5, b[1] - a[1])
    };
    let mut add = |column: isize, height: f32, middle: f32| {
        // The share of the column's pixel to the right of the edge, and all of the pixels after it.
        let right = (column + 1) as f32 - middle;
        if column < 0 {
            row[0] += height;
        } else if (column as usize) < row.len() {
            row[column as usize] += height * right;
            if column as usize + 1 < row.len() {
                row[column as usize + 1] += height * (1.0 - right);
            }
        }
    };
    let (first, last) = (from.floor() as isize, to.floor() as isize);
    if first == last {
        add(first, down, (from + to) / 2.0);
        return;
    }
    let per_column = down / (to - from);
    for column in first..=last {
        let start = from.max(column as f32);
        let end = to.min((column + 1) as f32);
        add(column, per_column * (end - start), (start + end) / 2.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIZE: Size = Size {
        width: 12,
        height: 9,
    };

    fn coverage(polygon: &[Vertex]) -> Vec<f32> {
        let mut coverage = vec![0.5; SIZE.area()];
        fill_polygon(polygon, SIZE, &mut coverage);
        coverage
    }

    #[test]
    fn a_square_between_pixels_covers_quarters() {
        let coverage = coverage(&[[2.0, 3.0], [4.0, 3.0], [4.0, 5.0], [2.0, 5.0]]);
        let row = |y: usize| &coverage[y * SIZE.width + 1..][..5];
        assert_eq!(row(3), [0.0, 0.25, 0.5, 0.25, 0.0]);
        assert_eq!(row(4), [0.0, 0.5, 1.0, 0.5, 0.0]);
        assert_eq!(row(5), [0.0, 0.25, 0.5, 0.25, 0.0]);
        assert_eq!(row(6), [0.0; 5]);
    }

    #[test]
    fn what_reaches_out_of_the_picture_is_cut_off() {
        let coverage = coverage(&[[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]]);
        assert!(coverage.iter().all(|&c| (c - 1.0).abs() < 1e-4));
    }

    #[test]
    fn a_blurred_point_keeps_its_sum() {
        let mut plane = vec![0.0; SIZE.area()];
        plane[4 * SIZE.width + 6] = 1.0;
        blur(&mut plane, SIZE, 0.8, &mut vec![9.0; SIZE.area()]);
        assert!((plane.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        assert!(plane[4 * SIZE.width + 6] > plane[4 * SIZE.width + 5]);
        assert_eq!(plane[4 * SIZE.width + 5], plane[3 * SIZE.width + 6]);
    }

    proptest! {
        #[test]
        fn coverage_sums_up_to_the_area(points in proptest::collection::vec((0.5f32..10.5, 0.5f32..7.5), 3)) {
            let triangle: Vec<Vertex> = points.iter().map(|&(x, y)| [x, y]).collect();
            let area = fourier::contour::region(&triangle).area.abs();
            prop_assert!((coverage(&triangle).iter().sum::<f32>() - area).abs() < 1e-2);
        }
    }
}
