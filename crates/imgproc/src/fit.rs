//! Pose of a known shape from all grey pixels that show it (Gauss-Newton; Lucas and Kanade 1981
//! with the parameters of a camera).
//!
//! The shape is dark, on a light, square plate. Its picture is known for every blur ([`Layers`]).
//! Position, rotation and size of the plate, blur, contrast, and the light with its slope are
//! unknown. They are found by least squares:
//!
//! ```text
//! grey(x, y)  = tone(light(x, y))
//! light(x, y) = (1 + slope · (x - x0, y - y0)) (bare + (dark - bare) coverage(u, v; blur))
//! (u, v)      = (x - centre) / plate, rotated back by `turn`
//! ```
//!
//! `tone` is the camera's tone curve ([`ToneCurve`]). Its exponent is unknown, too. If the camera may
//! sharpen its pictures, `grey` is increased by an unknown share of its difference from the same with
//! more blur.
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

use crate::tone::ToneCurve;
use crate::{Bounds, Size, assert_len};

use curved::Curved;
use descent::{Fitted, Model, SHARPENING, TONE, descend};
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

/// With a more uncertain tone curve, plates of any size are fitted to single pixels: a mean of pixels
/// is not that of their light, and larger triangles differ from others only in the light of their
/// edges.
const UNKNOWN_TONE: f32 = 0.05;

/// If less sharpening than this is expected, with less uncertainty, there is none.
const SHARPENING_MIN: f32 = 0.06;

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
    /// Expected exponent of the tone curve.
    pub tone: f32,
    /// Its standard deviation.
    pub tone_sigma: f32,
    /// Expected sharpening by the camera: the share of the difference from a softer picture that it
    /// adds.
    pub sharpening: f32,
    /// Its standard deviation.
    pub sharpening_sigma: f32,
    /// Maximum residual besides noise if the shape is present: root mean square, as a share of the
    /// contrast. Fits that will not get near it are given up.
    pub residual_ratio_max: f32,
    /// Whether something may cover a part of the plate. The start must then be right, because no
    /// fit is given up.
    pub may_be_covered: bool,
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
    /// Shares of the pixels inside the plate and at its rim that do not show it, 0 to 1. Zero unless
    /// it may be covered.
    pub hidden: [f32; 2],
    /// Side of a block in pixels: 1 if single pixels were used.
    pub block_px: usize,
    /// Covariance of x, y and turn, from the noise of the prior or the residual, whichever is
    /// larger.
    pub covariance: [[f32; 3]; 3],
    /// Variance of the logarithm of the blur.
    pub blur_ln_variance: f32,
    /// Exponent of the tone curve.
    pub tone: f32,
    /// Its variance.
    pub tone_variance: f32,
    /// Sharpening by the camera.
    pub sharpening: f32,
    /// Its variance.
    pub sharpening_variance: f32,
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
    let views = [COARSE_ACROSS, across_max(prior)].map(|across| {
        view(
            plane,
            size,
            within,
            layers,
            start.centre,
            start.plate_px / across,
            prior,
        )
    });
    let fitted = descend(Upright::new(start, prior), [&views[0], &views[1]], prior)?;
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
    let views = [COARSE_ACROSS, across_max(prior)].map(|across| {
        view(
            plane,
            size,
            within,
            layers,
            start.origin,
            start.unit_px / across,
            prior,
        )
    });
    let curved = Curved::new(start, expected.blur_px, prior, *expected);
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
    let block_px = start.plate_px / across_max(prior);
    let fine = view(plane, size, within, layers, start.centre, block_px, prior);
    let map = PlateMap::upright(start);
    let curved = Curved::new(map, start.blur_px, prior, *expected);
    descend(curved, [&fine, &fine], prior).map(|fitted| curved_result(&fitted))
}

/// Maximum number of blocks across a plate.
fn across_max(prior: &Prior) -> f32 {
    if prior.tone_sigma > UNKNOWN_TONE {
        f32::INFINITY
    } else {
        PLATE_BINNED_PX / 2.0
    }
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
    prior: &Prior,
) -> View<'a> {
    assert_len("plane", plane.len(), size);
    if let Some(Within { mask, bounds }) = within {
        assert_len("mask", mask.len(), bounds.size());
    }
    let block_px = block_px.max(1.0) as usize;
    let curve = ToneCurve::new(prior.tone);
    let mut light = [0.0; 256];
    if block_px > 1 {
        for (grey, light) in light.iter_mut().enumerate() {
            *light = curve.light(grey as f32);
        }
    }
    View {
        plane,
        size,
        within,
        layers,
        block_px,
        curve,
        is_sharpened: prior.sharpening.abs() > SHARPENING_MIN
            || prior.sharpening_sigma > SHARPENING_MIN,
        light,
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
        hidden: fitted.hidden,
        block_px: fitted.block_px,
        covariance,
        blur_ln_variance: fitted.covariance[blur][blur] as f32,
        tone: fitted.model.light().tone,
        tone_variance: fitted.covariance[TONE][TONE] as f32,
        sharpening: fitted.model.light().sharpening,
        sharpening_variance: fitted.covariance[SHARPENING][SHARPENING] as f32,
    }
}

#[cfg(test)]
mod tests;
