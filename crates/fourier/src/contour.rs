//! Closed contours as polygons: length, area, centre, and samples at equal distances.

use crate::{Complex32, N};

/// Area and centroid of a polygon, by Green's theorem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Square pixels; positive if the contour runs clockwise on the screen.
    pub area: f32,
    /// Centroid; the mean of the points if the area is zero.
    pub centre: [f32; 2],
}

/// Area and centroid of a closed polygon.
///
/// # Panics
///
/// If there is no point.
#[must_use]
pub fn region(points: &[[f32; 2]]) -> Region {
    assert!(!points.is_empty(), "a region needs points");
    // Relative to a point of the contour: far from the origin the products would lose precision.
    let [x0, y0] = points[0];
    let (mut twice_area, mut x, mut y) = (0.0f64, 0.0f64, 0.0f64);
    let (mut mean_x, mut mean_y) = (0.0f64, 0.0f64);
    for (a, b) in edges(points) {
        let (ax, ay) = (f64::from(a[0] - x0), f64::from(a[1] - y0));
        let (bx, by) = (f64::from(b[0] - x0), f64::from(b[1] - y0));
        let cross = ax * by - bx * ay;
        twice_area += cross;
        x += (ax + bx) * cross;
        y += (ay + by) * cross;
        mean_x += ax;
        mean_y += ay;
    }
    let n = points.len() as f64;
    let (x, y) = if twice_area.abs() > 1e-9 {
        (x / (3.0 * twice_area), y / (3.0 * twice_area))
    } else {
        (mean_x / n, mean_y / n)
    };
    Region {
        area: (twice_area / 2.0) as f32,
        centre: [x0 + x as f32, y0 + y as f32],
    }
}

/// Samples a closed polygon at [`N`] points with equal spacing along the contour, starting at its
/// first point.
///
/// A contour of zero length gives [`N`] times its first point.
///
/// # Panics
///
/// If there is no point.
#[must_use]
pub fn resample(points: &[[f32; 2]]) -> [Complex32; N] {
    resample_mapped(points, |point| point)
}

/// [`resample`] for the polygon of mapped points.
pub(crate) fn resample_mapped(
    points: &[[f32; 2]],
    map: impl Fn([f32; 2]) -> [f32; 2],
) -> [Complex32; N] {
    assert!(!points.is_empty(), "a contour needs points");
    let mapped_edges = || edges(points).map(|(a, b)| (map(a), map(b)));
    let length: f32 = mapped_edges().map(|(a, b)| distance(a, b)).sum();
    let step = length / N as f32;
    let [x, y] = map(points[0]);
    let mut samples = [Complex32::new(x, y); N];
    let mut n = 1;
    let mut walked = 0.0;
    for (a, b) in mapped_edges() {
        let edge = distance(a, b);
        while n < N && step * n as f32 <= walked + edge && edge > 0.0 {
            let share = (step * n as f32 - walked) / edge;
            samples[n] = Complex32::new(a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]));
            n += 1;
        }
        walked += edge;
    }
    samples
}

/// The edges of the polygon, the closing one last.
pub(crate) fn edges(points: &[[f32; 2]]) -> impl Iterator<Item = ([f32; 2], [f32; 2])> + '_ {
    points
        .iter()
        .copied()
        .zip(points.iter().copied().cycle().skip(1))
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    libm::sqrtf((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f32; 2]; 4] = [
        [1000.0, 2000.0],
        [1008.0, 2000.0],
        [1008.0, 2008.0],
        [1000.0, 2008.0],
    ];

    #[test]
    fn a_clockwise_square_has_positive_area() {
        assert_eq!(
            region(&SQUARE),
            Region {
                area: 64.0,
                centre: [1004.0, 2004.0]
            }
        );
        let mut backwards = SQUARE;
        backwards.reverse();
        assert_eq!(
            region(&backwards),
            Region {
                area: -64.0,
                centre: [1004.0, 2004.0]
            }
        );
    }

    #[test]
    fn a_line_has_its_mean_as_centre() {
        assert_eq!(
            region(&[[1.0, 1.0], [5.0, 1.0]]),
            Region {
                area: 0.0,
                centre: [3.0, 1.0]
            }
        );
    }

    #[test]
    fn samples_are_a_thirty_second_of_the_contour_apart() {
        let samples = resample(&SQUARE);
        assert_eq!(samples[0], Complex32::new(1000.0, 2000.0));
        assert_eq!(samples[1], Complex32::new(1001.0, 2000.0));
        assert_eq!(samples[8], Complex32::new(1008.0, 2000.0));
        assert_eq!(samples[31], Complex32::new(1000.0, 2001.0));
    }

    #[test]
    fn a_single_point_is_sampled_as_itself() {
        assert_eq!(resample(&[[3.0, 4.0]]), [Complex32::new(3.0, 4.0); N]);
    }
}
