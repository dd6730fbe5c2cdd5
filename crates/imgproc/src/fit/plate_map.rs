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
