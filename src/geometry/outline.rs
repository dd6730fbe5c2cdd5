//! Contours as polygons with few corners, for path planners.

use imgproc::Point;

/// Maximum number of corners.
pub(crate) const CAPACITY: usize = scene::MAX_OUTLINE;

/// Initial maximum distance between contour and polygon: below the resolution of the pixels.
const TOLERANCE_PX: f32 = 0.75;

/// The corners of a polygon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Outline {
    points: [[f64; 2]; CAPACITY],
    len: usize,
}

impl Outline {
    /// The square with this centre, side and direction of one side.
    pub(crate) fn square([x, y]: [f64; 2], side: f64, direction_rad: f64) -> Self {
        let (sin, cos) = direction_rad.sin_cos();
        let mut points = [[0.0; 2]; CAPACITY];
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        for (point, [u, v]) in points.iter_mut().zip(corners) {
            *point = [
                x + side * (cos * u - sin * v),
                y + side * (sin * u + cos * v),
            ];
        }
        Self { points, len: 4 }
    }

    /// The corners in order, pixels.
    pub(crate) fn points(&self) -> &[[f64; 2]] {
        &self.points[..self.len]
    }

    /// The corners mapped by `to`, without those for which it returns `None`.
    pub(crate) fn mapped(&self, to: impl Fn([f64; 2]) -> Option<[f64; 2]>) -> Self {
        let mut mapped = Self {
            points: [[0.0; 2]; CAPACITY],
            len: 0,
        };
        for point in self.points().iter().filter_map(|&point| to(point)) {
            mapped.points[mapped.len] = point;
            mapped.len += 1;
        }
        mapped
    }

    /// Distance of the farthest corner from a point, and the area, px and px².
    pub(crate) fn extent(&self, centre: [f64; 2]) -> (f64, f64) {
        let from_centre = |&[x, y]: &[f64; 2]| [x - centre[0], y - centre[1]];
        let (mut reach, mut twice_area) = (0.0_f64, 0.0);
        let mut before = self.points().last().map_or([0.0; 2], from_centre);
        for [x, y] in self.points().iter().map(from_centre) {
            reach = reach.max(x.hypot(y));
            twice_area += before[0] * y - before[1] * x;
            before = [x, y];
        }
        (reach, 0.5 * twice_area.abs())
    }
}

/// The polygon that stays within [`TOLERANCE_PX`] of a closed contour, or within the larger
/// tolerance required by [`CAPACITY`] (Douglas and Peucker 1973). It is then grown by half a pixel,
/// to the borders of the contour's pixels.
pub(crate) fn simplified(contour: &[Point]) -> Outline {
    let mut outline = Outline {
        points: [[0.0; 2]; CAPACITY],
        len: 0,
    };
    let mut tolerance = TOLERANCE_PX;
    while !simplify_within(contour, tolerance, &mut outline) {
        tolerance *= 1.5;
    }
    outline.grow();
    outline
}

impl Outline {
    /// Moves every side outwards by half a pixel: contours run through pixel centres, objects end
    /// at pixel borders.
    fn grow(&mut self) {
        const HALF_PX: f64 = 0.5;
        let n = self.len;
        if n < 3 {
            return;
        }
        let corners = self.points;
        // The contour is clockwise on the screen, so outwards is to the left of a side.
        let outwards = |i: usize| {
            let ([x0, y0], [x1, y1]) = (corners[i % n], corners[(i + 1) % n]);
            let length = (x1 - x0).hypot(y1 - y0);
            (length > 0.0).then(|| [(y1 - y0) / length, (x0 - x1) / length])
        };
        for (i, point) in self.points[..n].iter_mut().enumerate() {
            let (Some(a), Some(b)) = (outwards(i + n - 1), outwards(i)) else {
                continue;
            };
            // To the intersection of both sides; at a sharp corner at most two half pixels away.
            let sum = [a[0] + b[0], a[1] + b[1]];
            let scale = HALF_PX / (1.0 + a[0] * b[0] + a[1] * b[1]).max(0.5);
            *point = [point[0] + scale * sum[0], point[1] + scale * sum[1]];
        }
    }
}

/// Returns whether the polygon fits.
fn simplify_within(contour: &[Point], tolerance: f32, outline: &mut Outline) -> bool {
    outline.len = 0;
    let n = contour.len();
    // Ends of the remaining stretches, nearest on top. A closed contour ends where it starts.
    let mut ends = [0; CAPACITY];
    let mut depth = 1;
    ends[0] = n;
    let mut from = 0;
    while depth > 0 {
        let to = ends[depth - 1];
        match farthest(contour, from, to).filter(|&(_, distance)| distance > tolerance) {
            Some((middle, _)) if depth < CAPACITY => {
                ends[depth] = middle;
                depth += 1;
            }
            Some(_) => return false,
            None => {
                if outline.len == CAPACITY {
                    return false;
                }
                let Point { x, y } = contour[from];
                outline.points[outline.len] = [f64::from(x), f64::from(y)];
                outline.len += 1;
                from = to;
                depth -= 1;
            }
        }
    }
    true
}

/// The point of the contour between two others that is farthest from the line through them, and its
/// distance.
fn farthest(contour: &[Point], from: usize, to: usize) -> Option<(usize, f32)> {
    let at = |i: usize| {
        let Point { x, y } = contour[i % contour.len()];
        [f32::from(x), f32::from(y)]
    };
    let (a, b) = (at(from), at(to));
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length = dx.hypot(dy);
    let distance = |i: usize| {
        let p = at(i);
        let (px, py) = (p[0] - a[0], p[1] - a[1]);
        if length > 0.0 {
            (px * dy - py * dx).abs() / length
        } else {
            px.hypot(py)
        }
    };
    (from + 1..to)
        .map(|i| (i, distance(i)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(side: u16) -> Vec<Point> {
        let along = 0..side;
        let mut points: Vec<Point> = along.clone().map(|i| Point { x: i, y: 0 }).collect();
        points.extend(along.clone().map(|i| Point { x: side, y: i }));
        points.extend(along.clone().map(|i| Point {
            x: side - i,
            y: side,
        }));
        points.extend(along.map(|i| Point { x: 0, y: side - i }));
        points
    }

    #[test]
    fn a_square_has_four_corners() {
        assert_eq!(
            simplified(&square(20)).points(),
            [[-0.5, -0.5], [20.5, -0.5], [20.5, 20.5], [-0.5, 20.5]]
        );
    }

    #[test]
    fn the_extent_of_a_square_is_that_of_its_corners() {
        let (reach, area) = simplified(&square(20)).extent([20.0, 5.0]);
        // From (20, 5) to the corner at (-0.5, 20.5).
        assert!((reach - 20.5f64.hypot(15.5)).abs() < 1e-9, "{reach}");
        assert!((area - 441.0).abs() < 1e-9, "{area}");
        assert_eq!(
            simplified(&[Point { x: 3, y: 4 }]).extent([3.0, 4.0]),
            (0.0, 0.0)
        );
    }

    #[test]
    fn one_point_is_its_own_outline() {
        assert_eq!(simplified(&[Point { x: 3, y: 4 }]).points(), [[3.0, 4.0]]);
    }

    #[test]
    fn a_comb_of_a_thousand_teeth_still_fits() {
        let comb: Vec<Point> = (0..4000)
            .map(|i| Point {
                x: i / 2,
                y: 300 + 40 * u16::from(i % 4 > 1),
            })
            .collect();
        let outline = simplified(&comb);
        assert!((1..=CAPACITY).contains(&outline.points().len()));
    }
}
