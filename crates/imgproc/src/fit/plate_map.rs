//! Where the pixels of a picture lie on a plate that is seen at an angle or through a wide lens.

use super::Pose;

/// Number of coefficients of a polynomial of second degree in x and y.
pub(super) const TERMS: usize = 6;

/// From pixels to points of a plate: a polynomial of second degree. Its linear part is the
/// perspective of a small plate; the rest is how the perspective, or a lens, changes across it.
///
/// Points of the plate are in units of its side from its centre, in the axes of the drawing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateMap {
    /// Where x and y are zero, pixels.
    pub origin: [f32; 2],
    /// Number of pixels that x or y counts as 1.
    pub unit_px: f32,
    /// Factors of 1, x, y, x², xy and y² for the two coordinates on the plate.
    pub factors: [[f32; TERMS]; 2],
}

/// The terms of the polynomial.
#[inline(always)]
pub(super) fn terms(x: f32, y: f32) -> [f32; TERMS] {
    [1.0, x, y, x * x, x * y, y * y]
}

pub(super) fn product(factors: &[f32; TERMS], terms: &[f32; TERMS]) -> f32 {
    factors.iter().zip(terms).map(|(a, b)| a * b).sum()
}

impl PlateMap {
    /// The map of an affine picture of a plate: `to_pixels` turns units of the plate's side into
    /// pixels, column by column. `None` if its determinant is not positive.
    #[must_use]
    pub fn affine(centre: [f32; 2], to_pixels: [[f32; 2]; 2]) -> Option<Self> {
        let [[a, b], [c, d]] = to_pixels;
        let determinant = a * d - b * c;
        if !(determinant > 1e-6 && determinant.is_finite()) {
            return None;
        }
        let unit_px = libm::sqrtf(determinant);
        let s = unit_px / determinant;
        Some(Self {
            origin: centre,
            unit_px,
            factors: [
                [0.0, d * s, -c * s, 0.0, 0.0, 0.0],
                [0.0, -b * s, a * s, 0.0, 0.0, 0.0],
            ],
        })
    }

    /// The map of a plate that is a square in the picture.
    #[must_use]
    pub fn upright(pose: &Pose) -> Self {
        let (sin, cos) = libm::sincosf(pose.turn_rad);
        Self {
            origin: pose.centre,
            unit_px: pose.plate_px,
            factors: [
                [0.0, cos, sin, 0.0, 0.0, 0.0],
                [0.0, -sin, cos, 0.0, 0.0, 0.0],
            ],
        }
    }

    /// The map of a plate with a stretch, as [`stretch`](Self::stretch) returns it.
    #[must_use]
    pub fn stretched(pose: &Pose, [s, t]: [f32; 2]) -> Self {
        // The exponential of the symmetric matrix of the stretch, and its inverse.
        let norm = libm::hypotf(s, t).max(1e-6);
        let (cosh, sinh) = (libm::coshf(norm), libm::sinhf(norm) / norm);
        let [to, back] = [sinh, -sinh].map(|d| [[cosh + d * s, d * t], [d * t, cosh - d * s]]);
        let apply = |m: [[f32; 2]; 2], [x, y]: [f32; 2]| m.map(|row| row[0] * x + row[1] * y);
        // The axis of the drawing keeps its direction in the picture.
        let (sin, cos) = libm::sincosf(pose.turn_rad);
        let [x, y] = apply(back, [-sin, cos]);
        let length = libm::hypotf(x, y);
        let (sin, cos) = (-x / length, y / length);
        let [u, v] = [[cos, sin], [-sin, cos]].map(|axis| apply(to, axis));
        let column = |axis: [f32; 2]| axis.map(|c| c * pose.plate_px);
        Self::affine(pose.centre, [column(u), column(v)]).unwrap_or_else(|| Self::upright(pose))
    }

    /// The plate's centre in the picture, in the polynomial's x and y.
    pub(super) fn centre(&self) -> [f32; 2] {
        let mut at = [0.0; 2];
        // The plate's centre is within a pixel of the origin, and the curvature is small.
        for _ in 0..3 {
            let terms = terms(at[0], at[1]);
            let off = self.factors.map(|factors| product(&factors, &terms));
            let [[a, b], [c, d]] = self.slopes(at);
            let determinant = a * d - b * c;
            at[0] -= (d * off[0] - b * off[1]) / determinant;
            at[1] -= (a * off[1] - c * off[0]) / determinant;
        }
        at
    }

    /// Derivatives of u with respect to x and y, and of v.
    pub(super) fn slopes(&self, [x, y]: [f32; 2]) -> [[f32; 2]; 2] {
        self.factors
            .map(|[_, a, b, aa, ab, bb]| [a + 2.0 * aa * x + ab * y, b + ab * x + 2.0 * bb * y])
    }

    /// The inverse of the slopes: derivatives of x with respect to u and v, and of y.
    pub(super) fn inverse_slopes(&self, at: [f32; 2]) -> [[f32; 2]; 2] {
        let [[a, b], [c, d]] = self.slopes(at);
        let determinant = a * d - b * c;
        [[d, -b], [-c, a]].map(|row| row.map(|c| c / determinant))
    }

    /// Pose of the plate in the picture: its centre, the direction of its drawing's axis there, and
    /// the square root of its area.
    pub(super) fn pose(&self, blur_px: f32) -> Pose {
        let at = self.centre();
        let [[_, across], [_, along]] = self.inverse_slopes(at);
        let [[a, b], [c, d]] = self.slopes(at);
        Pose {
            centre: [0, 1].map(|i| self.origin[i] + self.unit_px * at[i]),
            // The plate's v axis points down; a turn is that of its u axis.
            turn_rad: libm::atan2f(-across, along),
            plate_px: self.unit_px / libm::sqrtf(a * d - b * c),
            blur_px,
        }
    }

    /// How the picture of the plate is stretched in the axes of the picture: the logarithm of the
    /// symmetric part of its affine map, apart from its size, is `[[s, t], [t, -s]]` for the result
    /// `[s, t]`.
    #[must_use]
    pub fn stretch(&self) -> [f32; 2] {
        let [[a, b], [c, d]] = self.inverse_slopes(self.centre());
        let determinant = a * d - b * c;
        // The map times its transpose, with determinant 1.
        let xx = (a * a + b * b) / determinant;
        let xy = (a * c + b * d) / determinant;
        let yy = (c * c + d * d) / determinant;
        // Its logarithm; twice that of the symmetric part.
        let hyperbolic_cos = f32::max((xx + yy) / 2.0, 1.0);
        let hyperbolic_sin = libm::sqrtf(hyperbolic_cos * hyperbolic_cos - 1.0);
        let twice = libm::logf(hyperbolic_cos + hyperbolic_sin);
        let ratio = if twice > 1e-3 {
            twice / hyperbolic_sin
        } else {
            1.0
        };
        [(xx - yy) / 4.0 * ratio, xy / 2.0 * ratio]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stretched_map_has_its_pose_and_stretch() {
        for (turn_rad, stretch) in [(0.4, [0.0, 0.0]), (-2.0, [0.2, -0.1]), (3.0, [-0.3, 0.3])] {
            let pose = Pose {
                centre: [40.0, 30.0],
                turn_rad,
                plate_px: 24.0,
                blur_px: 0.6,
            };
            let map = PlateMap::stretched(&pose, stretch);
            let found = map.pose(0.6);
            assert!((found.turn_rad - turn_rad).abs() < 1e-4, "{found:?}");
            assert!((found.plate_px - 24.0).abs() < 1e-3 && found.centre == pose.centre);
            for (found, stretch) in map.stretch().into_iter().zip(stretch) {
                assert!((found - stretch).abs() < 1e-3, "{found}, not {stretch}");
            }
        }
    }

    #[test]
    fn pose_and_stretch_of_an_affine_map() {
        let (turn, plate_px, along) = (0.7f32, 30.0, 0.4f32);
        // Turned, then longer by exp(0.3) than wide along a direction.
        let (sin, cos) = (2.0 * along).sin_cos();
        let stretch = [0.15 * cos, 0.15 * sin];
        let (cosh, sinh) = (0.15f32.cosh(), 0.15f32.sinh());
        let of_stretch = [
            [cosh + sinh * cos, sinh * sin],
            [sinh * sin, cosh - sinh * cos],
        ];
        let column = |[x, y]: [f32; 2]| {
            [0, 1].map(|i: usize| plate_px * (of_stretch[i][0] * x + of_stretch[i][1] * y))
        };
        let (sin, cos) = turn.sin_cos();
        let columns = [column([cos, sin]), column([-sin, cos])];
        let map = PlateMap::affine([8.0, 9.0], columns).expect("not mirrored");
        let pose = map.pose(0.6);
        assert!((pose.centre[0] - 8.0).hypot(pose.centre[1] - 9.0) < 1e-4);
        assert!((pose.plate_px - plate_px).abs() < 1e-3);
        let [x, y] = columns[1];
        assert!((pose.turn_rad - (-x).atan2(y)).abs() < 1e-5);
        for (found, expected) in map.stretch().into_iter().zip(stretch) {
            assert!((found - expected).abs() < 1e-5, "{found}, not {expected}");
        }
        assert_eq!(PlateMap::affine([0.0; 2], [columns[1], columns[0]]), None);
    }

    #[test]
    fn an_upright_map_is_its_pose() {
        let pose = Pose {
            centre: [50.0, 40.0],
            turn_rad: -2.0,
            plate_px: 24.0,
            blur_px: 0.5,
        };
        let map = PlateMap::upright(&pose);
        let found = map.pose(0.5);
        assert_eq!(found.centre, pose.centre);
        assert!((found.turn_rad - pose.turn_rad).abs() < 1e-5);
        assert!(map.stretch().iter().all(|s| s.abs() < 1e-4));
    }

    #[test]
    fn the_centre_of_a_curved_map_is_where_the_plate_is_zero() {
        let mut map = PlateMap::upright(&Pose {
            centre: [50.0, 40.0],
            turn_rad: 0.3,
            plate_px: 40.0,
            blur_px: 0.5,
        });
        map.factors[0] = [0.02, 0.9, 0.1, 0.05, -0.03, 0.02];
        map.factors[1] = [-0.03, -0.1, 1.1, 0.02, 0.06, -0.04];
        let at = map.centre();
        let terms = terms(at[0], at[1]);
        for factors in &map.factors {
            assert!(product(factors, &terms).abs() < 1e-6);
        }
        const STEP: f32 = 1e-2;
        for (factors, slopes) in map.factors.iter().zip(map.slopes(at)) {
            let value = |x: f32, y: f32| product(factors, &super::terms(at[0] + x, at[1] + y));
            assert!(
                ((value(STEP, 0.0) - value(-STEP, 0.0)) / (2.0 * STEP) - slopes[0]).abs() < 1e-4
            );
            assert!(
                ((value(0.0, STEP) - value(0.0, -STEP)) / (2.0 * STEP) - slopes[1]).abs() < 1e-4
            );
        }
    }
}
