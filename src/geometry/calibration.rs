//! From pixels to metres on the floor.
//!
//! The user measures a few points, both in the image and on the floor. A homography, the
//! perspective map between two planes, is fitted to them (`homography`). It maps positions; its
//! derivative at a point maps headings, velocities and covariances. If the points contradict each
//! other, `outliers` finds the wrong ones.
//!
//! ```toml
//! [[points]]
//! pixel = [101.5, 88.0]   # x right, y down, (0, 0) is the centre of the top left pixel
//! floor = [0.0, 2.0]      # metres, z up: from above, y is a quarter turn counter-clockwise from x
//! ```
//!
//! Lens distortion is not modelled. At least four points are needed; with more points the residual
//! shows whether the lens bends straight lines. Four points always fit; for them, only the effect
//! of a click error on positions can be given.

mod exactness;
mod homography;
mod outliers;

use std::path::Path;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::Deserialize;

use crate::geometry::calibration::exactness::{CLICKED_PX, INEXACT_MAX_PX, Inexactness};
use crate::geometry::calibration::homography::{INDEPENDENCE_MIN, homography};
use crate::geometry::calibration::outliers::{Suspects, is_contradicted, suspects};

/// Maximum RMS residual, in pixels.
const RESIDUAL_MAX_PX: f64 = 3.0;

/// A plane homography, row by row.
pub type Homography = [[f64; 3]; 3];

/// The mapping between image and floor.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    floor_from_image: Matrix3<f64>,
    residual_px: f64,
    n_points: usize,
    /// Mean of the measured pixels.
    middle_px: [f64; 2],
    inexactness: Inexactness,
}

/// Reasons why points give no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Not the expected TOML.
    #[error("calibration: {0}; write [[points]] with pixel = [x, y] and floor = [x_m, y_m]")]
    Syntax(String),
    /// Fewer than four.
    #[error("calibration: {0} points are given, at least 4 are needed")]
    TooFew(usize),
    /// A number is not finite.
    #[error("calibration: point {0} has a coordinate that is no finite number")]
    NotFinite(usize),
    /// The points do not span a plane.
    #[error(
        "calibration: the points determine no map (independence {0:.1e}, at least {INDEPENDENCE_MIN:.0e} is needed); \
         no three of four points may lie on one line"
    )]
    Degenerate(f64),
    /// The points contradict each other.
    #[error(
        "calibration: the points do not fit together, {rms_px:.1} px root mean square, at most {RESIDUAL_MAX_PX} px are \
         accepted; {suspects}"
    )]
    BadFit {
        /// RMS of all residuals, in pixels.
        rms_px: f64,
        /// The points at fault.
        suspects: Suspects,
    },
    /// The homography is poorly determined by the points.
    #[error(
        "calibration: the points lie nearly on a line or close together: a click {CLICKED_PX} px off would move positions among \
         them by up to {metres:.2} m ({pixels:.0} px); choose points near the corners of the floor"
    )]
    Inexact {
        /// Error of positions, metres.
        metres: f64,
        /// The same in image pixels.
        pixels: f64,
    },
    /// The floor axes are mirrored.
    #[error(
        "calibration: the floor's axes are mirrored; seen from above, the y axis must point a quarter turn \
         counter-clockwise from the x axis"
    )]
    Mirrored,
    /// The horizon runs between the points.
    #[error(
        "calibration: the points lie on both sides of the horizon of their own map; check for exchanged points"
    )]
    Horizon,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    points: Vec<PointPair>,
}

/// One point in both frames.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointPair {
    /// Pixels.
    pub pixel: [f64; 2],
    /// Metres.
    pub floor: [f64; 2],
}

/// A position on the floor, with the local derivative of the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FloorPoint {
    /// Metres.
    pub at: [f64; 2],
    /// Derivative of (x, y) in metres by (x, y) in pixels.
    pub jacobian: [[f64; 2]; 2],
}

/// Reads the text of a calibration file.
///
/// # Errors
///
/// If the file cannot be read.
pub(crate) fn read_text(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).map_err(|source| {
        let path = path.display();
        anyhow::anyhow!(
            "calibration {path} cannot be read ({source}); name a TOML file with [[points]]"
        )
    })
}

impl Calibration {
    /// Reads the points of a TOML file and fits the homography.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`], each with its remedy.
    pub fn from_toml(text: &str) -> Result<Self, CalibrationError> {
        // The first line has the message and the location; the rest of it draws the location.
        let file: File = toml::from_str(text).map_err(|e| {
            let line = 1 + e
                .span()
                .map_or(0, |span| text[..span.start].matches('\n').count());
            CalibrationError::Syntax(format!("line {line}: {}", e.message()))
        })?;
        Self::fit(&file.points)
    }

    /// Width of a pixel on the floor at the centre of the measured points, metres.
    #[must_use]
    pub fn metres_per_px(&self) -> Option<f64> {
        Some(self.to_floor(self.middle_px)?.metres_per_px())
    }

    /// Fits the homography to points.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`], each with its remedy.
    pub fn fit(points: &[PointPair]) -> Result<Self, CalibrationError> {
        if points.len() < 4 {
            return Err(CalibrationError::TooFew(points.len()));
        }
        let finite = |p: &PointPair| p.pixel.iter().chain(&p.floor).all(|c| c.is_finite());
        if let Some(bad) = points.iter().position(|p| !finite(p)) {
            return Err(CalibrationError::NotFinite(bad + 1));
        }
        let calibration = Self::fit_map(points)?;
        let residuals = calibration.residuals_px(points)?;
        let rms_px = root_mean_square(&residuals);
        if rms_px.is_nan() || rms_px > RESIDUAL_MAX_PX || is_contradicted(points) {
            let suspects = suspects(points, &residuals);
            return Err(CalibrationError::BadFit { rms_px, suspects });
        }
        let inexactness = calibration.inexactness(points);
        let Inexactness { metres, pixels } = inexactness;
        if pixels.is_nan() || pixels > INEXACT_MAX_PX {
            return Err(CalibrationError::Inexact { metres, pixels });
        }
        Ok(Self {
            residual_px: rms_px,
            inexactness,
            ..calibration
        })
    }

    /// The best fit, without a check of its quality.
    fn fit_map(points: &[PointPair]) -> Result<Self, CalibrationError> {
        let middle =
            |axis: usize| points.iter().map(|p| p.pixel[axis]).sum::<f64>() / points.len() as f64;
        Ok(Self {
            floor_from_image: homography(points)?,
            residual_px: 0.0,
            n_points: points.len(),
            middle_px: [0, 1].map(middle),
            inexactness: Inexactness::default(),
        })
    }

    /// RMS of the residuals, in pixels; zero for exactly four points.
    #[must_use]
    pub fn residual_px(&self) -> f64 {
        self.residual_px
    }

    /// The homography.
    #[must_use]
    pub fn floor_from_image(&self) -> Homography {
        let m = &self.floor_from_image;
        std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)]))
    }

    /// Position of a pixel on the floor; `None` on and beyond the horizon.
    #[must_use]
    pub fn to_floor(&self, pixel: [f64; 2]) -> Option<FloorPoint> {
        let m = &self.floor_from_image;
        let h = m * Vector3::new(pixel[0], pixel[1], 1.0);
        // The sign of the homography is chosen so that the points' side of the horizon is positive.
        if h.z <= 1e-9 {
            return None;
        }
        let at = [h.x / h.z, h.y / h.z];
        let derivative =
            |row: usize, column: usize| (m[(row, column)] - at[row] * m[(2, column)]) / h.z;
        let jacobian = [
            [derivative(0, 0), derivative(0, 1)],
            [derivative(1, 0), derivative(1, 1)],
        ];
        Some(FloorPoint { at, jacobian })
    }

    /// Distances in the image between the points and their mapped floor positions.
    fn residuals_px(&self, points: &[PointPair]) -> Result<Vec<f64>, CalibrationError> {
        points
            .iter()
            .map(|pair| {
                let floor = self.to_floor(pair.pixel).ok_or(CalibrationError::Horizon)?;
                let jacobian = Matrix2::from_fn(|row, column| floor.jacobian[row][column]);
                if jacobian.determinant() >= 0.0 {
                    return Err(CalibrationError::Mirrored);
                }
                let error_m =
                    Vector2::new(floor.at[0] - pair.floor[0], floor.at[1] - pair.floor[1]);
                let error_px = jacobian
                    .try_inverse()
                    .ok_or(CalibrationError::Degenerate(0.0))?
                    * error_m;
                Ok(error_px.norm())
            })
            .collect()
    }
}

fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

impl FloorPoint {
    /// Width of a pixel in metres: square root of the floor area that it covers.
    #[must_use]
    pub fn metres_per_px(&self) -> f64 {
        let [[a, b], [c, d]] = self.jacobian;
        (a * d - b * c).abs().sqrt()
    }

    /// Maps a heading from image to floor, with the factor by which its standard deviation grows.
    #[must_use]
    pub fn heading(&self, heading_rad: f64) -> (f64, f64) {
        let [[a, b], [c, d]] = self.jacobian;
        let (sin, cos) = heading_rad.sin_cos();
        let (x, y) = (a * cos + b * sin, c * cos + d * sin);
        let growth = (a * d - b * c).abs() / (x * x + y * y);
        (y.atan2(x), growth)
    }

    /// Maps the covariances of position and heading from image to floor: x with heading, y with
    /// heading.
    #[must_use]
    pub fn covariance_with_heading(&self, heading_rad: f64, [x, y]: [f64; 2]) -> [f64; 2] {
        let [[a, b], [c, d]] = self.jacobian;
        let (_, growth) = self.heading(heading_rad);
        // If the floor's y axis points up in the image, headings increase in the opposite
        // direction.
        let growth = growth.copysign(a * d - b * c);
        [growth * (a * x + b * y), growth * (c * x + d * y)]
    }

    /// Maps the covariance of a position from image to floor.
    #[must_use]
    pub fn covariance(&self, covariance_px2: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
        let [[xx, xy], [_, yy]] = covariance_px2;
        let across =
            |[a, b]: [f64; 2], [c, d]: [f64; 2]| a * (xx * c + xy * d) + b * (xy * c + yy * d);
        let [x, y] = self.jacobian;
        [[across(x, x), across(x, y)], [across(y, x), across(y, y)]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A tilted camera: a hundred pixels per metre, x right, y up, with some perspective.
    fn floor_of([x, y]: [f64; 2]) -> [f64; 2] {
        let w = 1.0 + 1e-4 * x - 2e-4 * y;
        [(0.01 * x - 1.0) / w, (4.0 - 0.01 * y) / w]
    }

    pub(in crate::geometry::calibration) fn pairs(pixels: &[[f64; 2]]) -> Vec<PointPair> {
        pixels
            .iter()
            .map(|&pixel| PointPair {
                pixel,
                floor: floor_of(pixel),
            })
            .collect()
    }

    pub(in crate::geometry::calibration) const CORNERS: [[f64; 2]; 4] =
        [[20.0, 30.0], [600.0, 40.0], [610.0, 450.0], [15.0, 460.0]];

    #[test]
    fn four_points_are_enough() {
        let calibration = Calibration::fit(&pairs(&CORNERS)).expect("a good fit");
        let floor = calibration.to_floor([320.0, 240.0]).expect("on the floor");
        let expected = floor_of([320.0, 240.0]);
        assert!(
            (floor.at[0] - expected[0]).abs() < 1e-9 && (floor.at[1] - expected[1]).abs() < 1e-9
        );
        assert!(calibration.residual_px() < 1e-6);
    }

    #[test]
    fn a_heading_down_the_picture_points_along_minus_y() {
        let scale = |[x, y]: [f64; 2]| [0.01 * x, -0.01 * y];
        let points: Vec<_> = CORNERS
            .iter()
            .map(|&pixel| PointPair {
                pixel,
                floor: scale(pixel),
            })
            .collect();
        let floor = Calibration::fit(&points)
            .expect("a good fit")
            .to_floor([100.0, 100.0])
            .expect("on the floor");
        let (heading, growth) = floor.heading(std::f64::consts::FRAC_PI_2);
        assert!((heading + std::f64::consts::FRAC_PI_2).abs() < 1e-9);
        assert!((growth - 1.0).abs() < 1e-9);
        assert!((floor.metres_per_px() - 0.01).abs() < 1e-9);
        let [[xx, xy], [_, yy]] = floor.covariance([[4.0, 0.0], [0.0, 4.0]]);
        assert!((xx - 4e-4).abs() < 1e-9 && (yy - 4e-4).abs() < 1e-9 && xy.abs() < 1e-9);
        // A clockwise rotation in the image is clockwise on the floor, where that is negative.
        let [x, y] = floor.covariance_with_heading(1.0, [0.2, 0.1]);
        assert!(
            (x + 0.002).abs() < 1e-9 && (y - 0.001).abs() < 1e-9,
            "{x} {y}"
        );
    }

    #[test]
    fn useless_points_are_refused_with_numbers() {
        let message =
            |points: &[PointPair]| Calibration::fit(points).expect_err("useless").to_string();
        assert_eq!(
            message(&pairs(&CORNERS[..3])),
            "calibration: 3 points are given, at least 4 are needed"
        );
        let line: Vec<[f64; 2]> = (0..6)
            .map(|i| [100.0 * f64::from(i), 50.0 * f64::from(i)])
            .collect();
        assert!(message(&pairs(&line)).contains("determine no map"));
        assert!(message(&pairs(&[CORNERS[0]; 5])).contains("determine no map"));

        let mut wrong = pairs(&[
            CORNERS[0],
            CORNERS[1],
            CORNERS[2],
            CORNERS[3],
            [300.0, 200.0],
            [200.0, 350.0],
        ]);
        wrong[4].floor[0] += 0.5;
        assert!(
            message(&wrong).contains("do not fit together"),
            "{}",
            message(&wrong)
        );

        let mut mirrored = pairs(&CORNERS);
        mirrored.iter_mut().for_each(|p| p.floor[1] = -p.floor[1]);
        assert!(message(&mirrored).contains("mirrored"));

        let mut infinite = pairs(&CORNERS);
        infinite[2].floor[1] = f64::NAN;
        assert!(message(&infinite).contains("point 3 has a coordinate"));
    }

    #[test]
    fn a_file_is_read_and_its_mistakes_are_named() {
        let mut text = String::new();
        for pair in pairs(&CORNERS) {
            text += &format!(
                "[[points]]\npixel = {:?}\nfloor = {:?}\n",
                pair.pixel, pair.floor
            );
        }
        assert!(Calibration::from_toml(&text).is_ok());
        let error = Calibration::from_toml(&text.replacen("floor", "flor", 1))
            .expect_err("a typing error")
            .to_string();
        assert!(
            error.starts_with("calibration: line 3: unknown field `flor`"),
            "{error}"
        );
    }

    proptest! {
        #[test]
        fn the_jacobian_is_the_derivative(x in 0f64..640.0, y in 0f64..480.0) {
            let calibration = Calibration::fit(&pairs(&CORNERS)).expect("a good fit");
            let at = |x, y| calibration.to_floor([x, y]).expect("on the floor");
            let (here, right, down) = (at(x, y), at(x + 1e-4, y), at(x, y + 1e-4));
            for axis in 0..2 {
                prop_assert!((here.jacobian[axis][0] - (right.at[axis] - here.at[axis]) / 1e-4).abs() < 1e-6);
                prop_assert!((here.jacobian[axis][1] - (down.at[axis] - here.at[axis]) / 1e-4).abs() < 1e-6);
            }
        }
    }
}
