//! Pose of a known shape from all grey pixels that show it (Gauss-Newton; Lucas and Kanade 1981
//! with the parameters of a camera).
//!
//! The shape is dark, on a light, square plate. Its picture is known for every blur ([`Layers`]).
//! Position, rotation and size of the plate, blur, contrast, and the light with its slope are
//! unknown. They are found by least squares:
//!
//! ```text
//! grey(x, y) = (light + slope · (x - x0, y - y0)) (1 - contrast · coverage(u, v; blur))
//! (u, v)     = (x - centre) / plate, rotated back by `turn`
//! ```
//!
//! A contour uses only the pixels that it passes through, and one number of each. The fit uses the
//! information of every pixel about every unknown. The residual is noise if the shape is the right
//! one, and larger if it is not.
//!
//! # Range
//!
//! A plate that is seen at an angle is not a square in the picture. [`fit_curved_shape`] fits a map
//! of twelve numbers instead of position, rotation and size ([`PlateMap`]).
//!
//! The initial pose must be right to within about a pixel, 3 degrees and a twentieth of the size,
//! as the descriptor of the contour gives it. Starts farther away are rejected as another shape.
//! Only pixels inside the plate count, and only those at least two blurs from its border, because
//! the surroundings of the plate are unknown. Plates larger than [`PLATE_BINNED_PX`] are fitted to
//! the means of square blocks of pixels.
//!
//! Cost: one round for light and contrast and two for the pose with about 200 blocks of pixels,
//! which reject most other shapes; then one to three rounds with all pixels, about 200 operations
//! per pixel.

use crate::{Bounds, Size, assert_len};

use curved::Curved;
use descent::{Fitted, Model, descend};
use upright::Upright;
use view::View;

pub use layers::Layers;
pub use plate_map::PlateMap;

mod curved;
mod descent;
mod equations;
mod layers;
mod plate_map;
mod upright;
mod view;

/// Maximum number of rounds, besides the one for the light. Most fits end after two or three.
const ROUNDS_MAX: usize = 7;

/// A fit ends with a step that moves no point of the plate by more than this; the next step would
/// be a tenth of it.
const LAST_STEP_PX: f64 = 0.01;

/// The last step also changes the logarithm of the blur by no more than this.
const LAST_STEP_BLUR: f64 = 0.03;

/// The first rounds combine pixels so that a plate is this many blocks across. A few blocks already
/// show a wrong shape, and a blurred picture has a wider range of convergence.
const COARSE_ACROSS: f32 = 12.0;

/// Plates from this size on are fitted to blocks of pixels, so that a plate is never more than
/// twice this many blocks across.
pub const PLATE_BINNED_PX: f32 = 80.0;

/// Position and sharpness of a plate. Pixels of the plane, x right, y down; angles from +x towards
/// +y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Centre of the plate.
    pub centre: [f32; 2],
    /// Rotation of the drawing.
    pub turn_rad: f32,
    /// Side of the plate, in pixels.
    pub plate_px: f32,
    /// Standard deviation of the lens blur, in pixels, without the blur of the pixel itself.
    pub blur_px: f32,
}

/// The part of a plane that shows the plate.
#[derive(Debug, Clone, Copy)]
pub struct Within<'a> {
    /// Not 0 where the plane shows the plate, row by row within `bounds`.
    pub mask: &'a [u8],
    /// Position of the mask in the plane.
    pub bounds: Bounds,
}

impl Within<'_> {
    /// Whether a pixel and its neighbours at distance `margin` in eight directions are in the mask.
    fn holds(&self, x: usize, y: usize, margin: usize) -> bool {
        let size = self.bounds.size();
        // Pixels left of or above the mask wrap around and are then too large.
        let x = x.wrapping_sub(usize::from(self.bounds.left));
        let y = y.wrapping_sub(usize::from(self.bounds.top));
        let holds = |x: usize, y: usize| {
            x < size.width && y < size.height && self.mask[y * size.width + x] != 0
        };
        let columns = [x.wrapping_sub(margin), x, x.wrapping_add(margin)];
        let rows = [y.wrapping_sub(margin), y, y.wrapping_add(margin)];
        columns.iter().all(|&x| rows.iter().all(|&y| holds(x, y)))
    }
}

/// What is known before the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Noise of a pixel, in grey levels.
    pub noise: f32,
    /// Standard deviation of the natural logarithm of the initial blur.
    pub blur_ln_sigma: f32,
    /// Standard deviation of the natural logarithm of the initial plate size.
    pub plate_ln_sigma: f32,
    /// Maximum residual besides noise if the shape is present: root mean square, as a share of the
    /// contrast. Fits that will not get near it are given up.
    pub residual_ratio_max: f32,
}

/// Result of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: Pose,
    /// Grey level of the bare plate at its centre.
    pub light: f32,
    /// Difference between the plate and the shape, in grey levels.
    pub contrast: f32,
    /// Root mean square of the residual, in grey levels of a single pixel.
    pub residual: f32,
    /// Share of the variation of the pixels (or blocks) that the shape explains, 0 to 1. The rest
    /// is noise and differences from the shape.
    pub r_squared: f32,
    /// Number of pixels, or blocks, used.
    pub n: f32,
    /// Side of a block in pixels: 1 if single pixels were used.
    pub block_px: usize,
    /// Covariance of x, y and turn, from the noise of the prior or the residual, whichever is
    /// larger.
    pub covariance: [[f32; 3]; 3],
    /// Variance of the logarithm of the blur.
    pub blur_ln_variance: f32,
}

/// What is known of the picture of a plate before [`fit_curved_shape`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StretchPrior {
    /// Expected blur of the lens, pixels.
    pub blur_px: f32,
    /// Expected stretch, as in [`CurvedFit::stretch`].
    pub stretch: [f32; 2],
    /// Standard deviation of each of the two numbers.
    pub sigma: f32,
    /// How the perspective is expected to change across the plate: the map's terms of second degree
    /// as movements of a pixel in the picture, factors of x², xy and y² for x and y, per pixel.
    pub curvature: [[f32; 3]; 2],
    /// Standard deviation of every factor of the second degree in [`PlateMap`].
    pub curvature_sigma: f32,
}

/// Result of a fit of a plate that may be seen at an angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvedFit {
    /// The result as for an upright plate.
    pub fit: Fit,
    /// How the plate is stretched in the axes of the picture. It is longer along x by `exp` of
    /// twice the first number than along y, and the same for the diagonals and the second number.
    pub stretch: [f32; 2],
    /// Variances of the two numbers.
    pub stretch_variance: [f32; 2],
}

/// Fits a shape to a plane of grey values: to the whole plate, or only to the part `within` a mask.
///
/// `None` if the pixels do not determine the pose (plate outside of the plane, no contrast), lead
/// away from the start, or clearly show something else.
///
/// # Panics
///
/// If `plane` does not have `size.area()` values, the mask of `within` does not match its bounds,
/// or `layers` does not hold at least two whole layers.
#[must_use]
pub fn fit_shape(
    plane: &[u8],
    size: Size,
    within: Option<Within<'_>>,
    layers: Layers<'_>,
    start: Pose,
    prior: &Prior,
) -> Option<Fit> {
    let views = [COARSE_ACROSS, PLATE_BINNED_PX / 2.0].map(|across| {
        view(
            plane,
            size,
            within,
            layers,
            start.centre,
            start.plate_px / across,
        )
    });
    let fitted = descend(Upright::new(start), [&views[0], &views[1]], prior)?;
    let poses = [upright::X, upright::Y, upright::TURN];
    let covariance = poses.map(|i| poses.map(|k| fitted.covariance[i][k] as f32));
    Some(result(
        &fitted,
        fitted.model.pose,
        covariance,
        upright::BLUR,
    ))
}

/// Fits a shape whose plate may be seen at an angle or through a wide lens. `start` must be right to
/// within about a pixel, 3 degrees, and a twentieth of the size in every direction.
///
/// Position and heading of the result are those of the plate's centre and of the drawing's axis in
/// the picture, and its size is the square root of the plate's area.
///
/// `None` as for [`fit_shape`], and if the plate is stretched too far.
///
/// # Panics
///
/// As [`fit_shape`].
#[must_use]
pub fn fit_curved_shape(
    plane: &[u8],
    size: Size,
    within: Option<Within<'_>>,
    layers: Layers<'_>,
    start: PlateMap,
    prior: &Prior,
    expected: &StretchPrior,
) -> Option<CurvedFit> {
    let views = [COARSE_ACROSS, PLATE_BINNED_PX / 2.0].map(|across| {
        view(
            plane,
            size,
            within,
            layers,
            start.origin,
            start.unit_px / across,
        )
    });
    let curved = Curved::new(start, expected.blur_px, *expected);
    descend(curved, [&views[0], &views[1]], prior).map(|fitted| curved_result(&fitted))
}

/// Continues a fit of an upright plate, which may be seen at a small angle. Otherwise as
/// [`fit_curved_shape`].
///
/// # Panics
///
/// As [`fit_shape`].
#[must_use]
pub fn refine_shape(
    plane: &[u8],
    size: Size,
    within: Option<Within<'_>>,
    layers: Layers<'_>,
    start: &Pose,
    prior: &Prior,
    expected: &StretchPrior,
) -> Option<CurvedFit> {
    let block_px = start.plate_px / (PLATE_BINNED_PX / 2.0);
    let fine = view(plane, size, within, layers, start.centre, block_px);
    let curved = Curved::new(PlateMap::upright(start), start.blur_px, *expected);
    descend(curved, [&fine, &fine], prior).map(|fitted| curved_result(&fitted))
}

fn curved_result(fitted: &Fitted<Curved, { curved::UNKNOWNS }>) -> CurvedFit {
    let Curved { map, blur_px, .. } = fitted.model;
    let covariance_of = |a: &[f64; curved::UNKNOWNS], b: &[f64; curved::UNKNOWNS]| -> f64 {
        let rows = fitted.covariance.iter().zip(a);
        rows.map(|(row, a)| a * row.iter().zip(b).map(|(c, b)| c * b).sum::<f64>())
            .sum()
    };
    let poses = curved::pose_factors(&map);
    let covariance = [0, 1, 2]
        .map(|i: usize| [0, 1, 2].map(|k: usize| covariance_of(&poses[i], &poses[k]) as f32));
    let stretches = curved::stretch_factors(&map);
    CurvedFit {
        fit: result(fitted, map.pose(blur_px), covariance, curved::BLUR),
        stretch: map.stretch(),
        stretch_variance: stretches.map(|factors| covariance_of(&factors, &factors) as f32),
    }
}

fn view<'a>(
    plane: &'a [u8],
    size: Size,
    within: Option<Within<'a>>,
    layers: Layers<'a>,
    origin: [f32; 2],
    block_px: f32,
) -> View<'a> {
    assert_len("plane", plane.len(), size);
    if let Some(Within { mask, bounds }) = within {
        assert_len("mask", mask.len(), bounds.size());
    }
    View {
        plane,
        size,
        within,
        layers,
        block_px: block_px.max(1.0) as usize,
        origin,
    }
}

fn result<M: Model<N>, const N: usize>(
    fitted: &Fitted<M, N>,
    pose: Pose,
    covariance: [[f32; 3]; 3],
    blur: usize,
) -> Fit {
    let contrast = fitted.model.light().contrast();
    let shown = f64::from(contrast * contrast) * fitted.coverage_variance;
    Fit {
        pose,
        light: fitted.model.light().bare,
        contrast,
        residual: libm::sqrt(fitted.left) as f32 * fitted.block_px as f32,
        r_squared: (shown / (shown + fitted.left)) as f32,
        n: fitted.n,
        block_px: fitted.block_px,
        covariance,
        blur_ln_variance: fitted.covariance[blur][blur] as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::view::PIXEL_VARIANCE;
    use super::*;
    use random::SplitMix64;
    use std::{vec, vec::Vec};

    const SIDE: usize = 105;
    const PER_PLATE: f32 = 96.0;
    const FIRST_BLUR: f32 = 0.01;
    const LAYERS: usize = 11;

    /// Rectangles of a flag on its pole: left, top, right, bottom in units of the plate.
    const FLAG: [[f32; 4]; 2] = [[-0.2, -0.35, -0.05, 0.35], [-0.05, -0.35, 0.3, 0.0]];

    /// The error function, to 1e-7 (Abramowitz and Stegun 7.1.26).
    fn erf(x: f64) -> f64 {
        let t = 1.0 / (1.0 + 0.3275911 * x.abs());
        let poly = [
            1.061405429,
            -1.453152027,
            1.421413741,
            -0.284496736,
            0.254829592,
        ]
        .into_iter()
        .fold(0.0, |sum, c| (sum + c) * t);
        (1.0 - poly * (-x * x).exp()).copysign(x)
    }

    /// The flag through a Gaussian lens: each rectangle is a product of two edges in x and two in
    /// y.
    fn coverage(u: f32, v: f32, blur: f32) -> f32 {
        let edge = |d: f32| 0.5 * erf(f64::from(d / blur) / 2f64.sqrt());
        let within = |c: f32, from: f32, to: f32| edge(c - from) - edge(c - to);
        FLAG.iter()
            .map(|&[left, top, right, bottom]| within(u, left, right) * within(v, top, bottom))
            .sum::<f64>() as f32
    }

    fn samples() -> Vec<f32> {
        let at = |i: usize| (i as f32 - (SIDE / 2) as f32) / PER_PLATE;
        let layer = |layer: usize| {
            let blur = FIRST_BLUR * 2f32.powf(layer as f32 / 2.0);
            (0..SIDE * SIDE).map(move |i| coverage(at(i % SIDE), at(i / SIDE), blur))
        };
        (0..LAYERS).flat_map(layer).collect()
    }

    fn layers(samples: &[f32]) -> Layers<'_> {
        Layers {
            samples,
            side: SIDE,
            per_plate: PER_PLATE,
            first_blur: FIRST_BLUR,
            blur_ratio: 2f32.sqrt(),
        }
    }

    /// A plate in light that increases to the right, on a background of another grey level.
    fn picture(size: Size, pose: &Pose, mut noise: impl FnMut() -> f32) -> Vec<u8> {
        let (sin, cos) = pose.turn_rad.sin_cos();
        let spread = (pose.blur_px * pose.blur_px + PIXEL_VARIANCE).sqrt() / pose.plate_px;
        (0..size.area())
            .map(|i| {
                let [dx, dy] = [
                    (i % size.width) as f32 - pose.centre[0],
                    (i / size.width) as f32 - pose.centre[1],
                ];
                let u = (cos * dx + sin * dy) / pose.plate_px;
                let v = (cos * dy - sin * dx) / pose.plate_px;
                let grey = if u.abs().max(v.abs()) > 0.5 {
                    90.0
                } else {
                    (200.0 + 0.3 * dx) * (1.0 - 0.8 * coverage(u, v, spread))
                };
                (grey + noise()).round().clamp(0.0, 255.0) as u8
            })
            .collect()
    }

    const SIZE: Size = Size {
        width: 180,
        height: 170,
    };

    const PRIOR: Prior = Prior {
        noise: 0.3,
        blur_ln_sigma: 0.35,
        plate_ln_sigma: 0.1,
        residual_ratio_max: 0.04,
    };

    fn near(pose: &Pose) -> Pose {
        Pose {
            centre: [pose.centre[0] + 0.7, pose.centre[1] - 0.6],
            turn_rad: pose.turn_rad + 0.052,
            plate_px: pose.plate_px * 1.05,
            blur_px: 0.65,
        }
    }

    #[test]
    fn the_pose_is_found_from_a_start_nearby() {
        let samples = samples();
        for (i, plate_px) in [12.0, 16.0, 24.0, 48.0, 79.0, 81.0, 130.0]
            .into_iter()
            .enumerate()
        {
            let truth = Pose {
                centre: [88.3 + 0.11 * i as f32, 84.8],
                turn_rad: 0.9 * i as f32 - 2.0,
                plate_px,
                blur_px: 0.8,
            };
            let plane = picture(SIZE, &truth, || 0.0);
            let fit = fit_shape(&plane, SIZE, None, layers(&samples), near(&truth), &PRIOR)
                .unwrap_or_else(|| panic!("{plate_px}: a plate that is there"));
            let off =
                (fit.pose.centre[0] - truth.centre[0]).hypot(fit.pose.centre[1] - truth.centre[1]);
            let turned = (fit.pose.turn_rad - truth.turn_rad).abs();
            assert!(off < 0.01, "{plate_px}: {off} px");
            assert!(turned < 0.03 / plate_px, "{plate_px}: {turned} rad");
            assert!((fit.pose.plate_px / plate_px - 1.0).abs() < 0.01);
            // Block means say little about a blur smaller than a block.
            let shows_blur = fit.block_px == 1;
            assert!(
                !shows_blur || (fit.pose.blur_px - 0.8).abs() < 0.2,
                "{plate_px}: {}",
                fit.pose.blur_px
            );
            assert!(fit.r_squared > 0.99, "{plate_px}: {}", fit.r_squared);
            assert!((fit.light - 200.0).abs() < 2.0 && (fit.contrast - 160.0).abs() < 3.0);
            assert!(
                fit.residual < 4.0 * fit.block_px as f32,
                "{plate_px}: {}",
                fit.residual
            );
        }
    }

    /// A plate that is seen at an angle: compressed along its own u axis. The blur is round in the
    /// picture.
    fn compressed(size: Size, pose: &Pose, share: f32, mut noise: impl FnMut() -> f32) -> Vec<u8> {
        let (sin, cos) = pose.turn_rad.sin_cos();
        let [width, height] = [share.sqrt(), 1.0 / share.sqrt()].map(|s| s * pose.plate_px);
        let spread = (pose.blur_px * pose.blur_px + PIXEL_VARIANCE).sqrt();
        (0..size.area())
            .map(|i| {
                let [dx, dy] = [
                    (i % size.width) as f32 - pose.centre[0],
                    (i / size.width) as f32 - pose.centre[1],
                ];
                let (u, v) = (
                    (cos * dx + sin * dy) / width,
                    (cos * dy - sin * dx) / height,
                );
                let edge = |d: f32| 0.5 * erf(f64::from(d / spread) / 2f64.sqrt());
                let within = |c: f32, from: f32, to: f32, side: f32| {
                    edge((c - from) * side) - edge((c - to) * side)
                };
                let coverage: f64 = FLAG
                    .iter()
                    .map(|&[left, top, right, bottom]| {
                        within(u, left, right, width) * within(v, top, bottom, height)
                    })
                    .sum();
                let grey = if u.abs().max(v.abs()) > 0.5 {
                    90.0
                } else {
                    (200.0 + 0.3 * dx) * (1.0 - 0.8 * coverage as f32)
                };
                (grey + noise()).round().clamp(0.0, 255.0) as u8
            })
            .collect()
    }

    /// Nothing is known of the camera.
    const ANY_ANGLE: StretchPrior = StretchPrior {
        blur_px: 0.65,
        stretch: [0.0; 2],
        sigma: 0.15,
        curvature: [[0.0; 3]; 2],
        curvature_sigma: 0.005,
    };

    #[test]
    fn a_plate_at_an_angle_is_found_from_a_start_nearby() {
        let samples = samples();
        for (i, (plate_px, share)) in [(16.0, 0.9), (24.0, 0.7), (48.0, 0.6), (90.0, 0.8)]
            .into_iter()
            .enumerate()
        {
            let truth = Pose {
                centre: [88.3 + 0.11 * i as f32, 84.8],
                turn_rad: 0.9 * i as f32 - 1.0,
                plate_px,
                blur_px: 0.7,
            };
            let plane = compressed(SIZE, &truth, share, || 0.0);
            let (sin, cos) = (truth.turn_rad + 0.04).sin_cos();
            let [width, height] = [share.sqrt(), 1.0 / share.sqrt()].map(|s| 1.03 * s * plate_px);
            let columns = [[width * cos, width * sin], [-height * sin, height * cos]];
            let centre = [truth.centre[0] + 0.6, truth.centre[1] - 0.5];
            let start = PlateMap::affine(centre, columns).expect("not mirrored");
            let layers = layers(&samples);
            let found = fit_curved_shape(&plane, SIZE, None, layers, start, &PRIOR, &ANY_ANGLE);
            let CurvedFit { fit, stretch, .. } = found.expect("a plate that is there");
            let off =
                (fit.pose.centre[0] - truth.centre[0]).hypot(fit.pose.centre[1] - truth.centre[1]);
            let turned = (fit.pose.turn_rad - truth.turn_rad).abs();
            assert!(off < 0.02, "{plate_px}: {off} px");
            assert!(turned < 0.05 / plate_px, "{plate_px}: {turned} rad");
            let (sin, cos) = (2.0 * truth.turn_rad).sin_cos();
            for (found, axis) in stretch.into_iter().zip([cos, sin]) {
                let expected = 0.5 * share.ln() * axis;
                assert!(
                    (found - expected).abs() < 0.005,
                    "{plate_px}: {found}, not {expected}"
                );
            }
            assert!(fit.r_squared > 0.99, "{plate_px}: {}", fit.r_squared);
        }
    }

    #[test]
    fn an_upright_fit_is_refined_to_the_angle() {
        let samples = samples();
        let truth = Pose {
            centre: [60.2, 55.7],
            turn_rad: 0.5,
            plate_px: 30.0,
            blur_px: 0.7,
        };
        let plane = compressed(SIZE, &truth, 0.96, || 0.0);
        let upright = fit_shape(&plane, SIZE, None, layers(&samples), near(&truth), &PRIOR)
            .expect("nearly a square");
        let off = |pose: &Pose| {
            (pose.centre[0] - truth.centre[0]).hypot(pose.centre[1] - truth.centre[1])
        };
        let layers = layers(&samples);
        let refined = refine_shape(
            &plane,
            SIZE,
            None,
            layers,
            &upright.pose,
            &PRIOR,
            &ANY_ANGLE,
        );
        let refined = refined.expect("it continues").fit;
        assert!(off(&refined.pose) < 0.01 && off(&refined.pose) < off(&upright.pose));
        assert!(refined.residual < upright.residual);
    }

    #[test]
    fn errors_at_an_angle_match_the_covariance() {
        let samples = samples();
        // None of these plates is curved: an uncertain curvature would be part of the covariance.
        let expected_angle = StretchPrior {
            curvature_sigma: 3e-4,
            ..ANY_ANGLE
        };
        let mut random = SplitMix64(3);
        let (mut squares, n) = ([0.0; 3], 400);
        for i in 0..n {
            let truth = Pose {
                centre: [30.0 + random.unit_f32(), 31.0 + random.unit_f32()],
                turn_rad: i as f32,
                plate_px: 24.0,
                blur_px: 0.7,
            };
            let size = Size {
                width: 60,
                height: 60,
            };
            let plane = compressed(size, &truth, 0.8, || 6.0 * random.normal() as f32);
            let prior = Prior {
                noise: 6.0,
                ..PRIOR
            };
            let (sin, cos) = truth.turn_rad.sin_cos();
            let [width, height] = [0.8f32.sqrt(), 1.0 / 0.8f32.sqrt()].map(|s| s * 24.0);
            let columns = [[width * cos, width * sin], [-height * sin, height * cos]];
            let start = PlateMap::affine(truth.centre, columns).expect("not mirrored");
            let layers = layers(&samples);
            let fit = fit_curved_shape(&plane, size, None, layers, start, &prior, &expected_angle)
                .expect("a plate that is there")
                .fit;
            let turn = f64::from(fit.pose.turn_rad - truth.turn_rad);
            let error = [
                fit.pose.centre[0] - truth.centre[0],
                fit.pose.centre[1] - truth.centre[1],
                libm::remainder(turn, core::f64::consts::TAU) as f32,
            ];
            for (i, sum) in squares.iter_mut().enumerate() {
                *sum += error[i] * error[i] / fit.covariance[i][i] / n as f32;
            }
        }
        // The mean square of 400 errors is accurate to 7 %: allow five times that.
        for square in squares {
            assert!((0.65..1.35).contains(&square), "{squares:?}");
        }
    }

    #[test]
    fn errors_match_the_covariance() {
        let samples = samples();
        let mut random = SplitMix64(1);
        let mut normal = || random.normal() as f32;
        let (mut squares, n) = ([0.0; 3], 300);
        // Products of the errors of position and rotation, and their expected values, both
        // multiplied by the latter.
        let (mut products, mut expected) = (0.0, 0.0);
        for i in 0..n {
            let truth = Pose {
                centre: [30.0 + normal(), 31.0 + normal()],
                turn_rad: i as f32,
                plate_px: 20.0,
                blur_px: 0.7,
            };
            let size = Size {
                width: 60,
                height: 60,
            };
            let plane = picture(size, &truth, || 8.0 * normal());
            let prior = Prior {
                noise: 8.0,
                ..PRIOR
            };
            let fit = fit_shape(&plane, size, None, layers(&samples), near(&truth), &prior)
                .expect("a plate that is there");
            let error = [
                fit.pose.centre[0] - truth.centre[0],
                fit.pose.centre[1] - truth.centre[1],
                fit.pose.turn_rad - truth.turn_rad,
            ];
            for (i, sum) in squares.iter_mut().enumerate() {
                *sum += error[i] * error[i] / fit.covariance[i][i] / n as f32;
            }
            for (error_px, [.., with_turn]) in error.into_iter().zip(fit.covariance).take(2) {
                products += error_px * error[2] * with_turn;
                expected += with_turn * with_turn;
            }
        }
        // The mean square of 300 errors is accurate to 8 %: allow five times that.
        for square in squares {
            assert!((0.6..1.4).contains(&square), "{squares:?}");
        }
        let together = products / expected;
        assert!((0.5..1.5).contains(&together), "{together}");
    }

    #[test]
    fn pixels_beside_a_smaller_plate_do_not_count() {
        let samples = samples();
        let truth = Pose {
            centre: [60.0, 55.0],
            turn_rad: 0.0,
            plate_px: 40.0,
            blur_px: 0.7,
        };
        let mut plane = picture(SIZE, &truth, || 0.0);
        // Only 34 x 34 pixels of the plate are visible, off its centre; the flag is whole.
        let bounds = Bounds {
            left: 43,
            top: 39,
            right: 76,
            bottom: 72,
        };
        let within = Within {
            mask: &vec![1; bounds.size().area()],
            bounds,
        };
        for (i, grey) in plane.iter_mut().enumerate() {
            let (x, y) = (i % SIZE.width, i / SIZE.width);
            if !within.holds(x, y, 0) {
                *grey = 30;
            }
        }
        let fit = |within| fit_shape(&plane, SIZE, within, layers(&samples), near(&truth), &PRIOR);
        assert_eq!(fit(None), None);
        let fit = fit(Some(within)).expect("a flag that is there");
        let off =
            (fit.pose.centre[0] - truth.centre[0]).hypot(fit.pose.centre[1] - truth.centre[1]);
        assert!(off < 0.01, "{off} px");
    }

    #[test]
    fn nothing_is_found_where_nothing_is() {
        let samples = samples();
        let pose = Pose {
            centre: [20.0, 20.0],
            turn_rad: 0.0,
            plate_px: 24.0,
            blur_px: 0.6,
        };
        let size = Size {
            width: 40,
            height: 40,
        };
        let flat = vec![100; size.area()];
        assert_eq!(
            fit_shape(&flat, size, None, layers(&samples), pose, &PRIOR),
            None
        );
        let outside = Pose {
            centre: [-30.0, 500.0],
            ..pose
        };
        assert_eq!(
            fit_shape(&flat, size, None, layers(&samples), outside, &PRIOR),
            None
        );
        // A shape lighter than its plate is no marker.
        let light: Vec<u8> = picture(size, &pose, || 0.0)
            .iter()
            .map(|g| 255 - g)
            .collect();
        assert_eq!(
            fit_shape(&light, size, None, layers(&samples), pose, &PRIOR),
            None
        );
    }
}
