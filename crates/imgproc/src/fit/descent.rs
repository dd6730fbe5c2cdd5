//! Gauss-Newton rounds of any model of a plate, and when to give up.

use super::equations::{Normal, Solution};
use super::view::{Sample, View};
use super::{Prior, ROUNDS_MAX};

/// A fit is given up when a round starts with a residual above the permitted one times this factor,
/// for the first round, the second, and so on. Shapes that are present start with less than 4.8,
/// 2.9, 1.7 and 1.5.
const GIVE_UP: [f32; 4] = [8.0, 3.5, 2.0, 1.5];

/// A fit is given up when the first round's equations predict a residual above the permitted one
/// times this factor. Shapes that are present: 4.2 at plates of 12 pixels, less on larger ones.
const GIVE_UP_PROMISED: f32 = 4.5;

/// A fit is given up when it is still over the limit of the last round, and the round before
/// reduced the residual by less than this share. If the shape is present, every round halves the
/// excess.
const PROGRESS_MIN: f32 = 0.1;

/// Number of rounds with the coarse view.
const COARSE_ROUNDS: usize = 2;

/// Light on a plate.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Light {
    /// Grey level of the bare plate at its centre.
    pub(super) bare: f32,
    /// Per side of the plate.
    pub(super) slope: [f32; 2],
    /// Share of the light that the shape does not reflect.
    pub(super) share: f32,
}

impl Light {
    /// Difference between the plate and the shape, in grey levels.
    pub(super) fn contrast(&self) -> f32 {
        self.bare * self.share
    }

    /// Adds a step of the light, its slope in x and y, and the contrast.
    pub(super) fn take(&mut self, [bare, x, y, share]: [f32; 4]) {
        self.bare += bare;
        self.slope[0] += x;
        self.slope[1] += y;
        self.share = (self.share + share).clamp(0.02, 1.2);
    }
}

/// What predicts the grey levels of a plate, with `N` unknowns.
pub(super) trait Model<const N: usize>: Copy {
    fn light(&self) -> &Light;

    fn light_mut(&mut self) -> &mut Light;

    /// Calls `found` with every sample on the plate that counts.
    fn each_sample(&self, view: &View<'_>, found: impl FnMut(Sample));

    /// The equations of a round, from all samples.
    fn normal(&self, view: &View<'_>) -> Normal<N>;

    /// Adds what is known before the fit. `variance` is that of a sample.
    fn expect(&self, start: &Self, prior: &Prior, variance: f64, normal: &mut Normal<N>);

    /// Adds a step, limited to what the equations are good for.
    fn take(&mut self, step: &[f64; N]);

    /// Whether no further step is needed after this one.
    fn is_small(&self, step: &[f64; N]) -> bool;

    /// Whether the model is still near the start.
    fn is_near(&self, start: &Self) -> bool;
}

/// A model that fits.
pub(super) struct Fitted<M, const N: usize> {
    pub(super) model: M,
    /// Mean square of the residuals.
    pub(super) left: f64,
    /// Variance of the coverage over the plate.
    pub(super) coverage_variance: f64,
    /// Covariance of the unknowns.
    pub(super) covariance: [[f64; N]; N],
    /// Number of samples, and the side of their blocks.
    pub(super) n: f32,
    pub(super) block_px: usize,
}

/// Fits a model, first to the coarse view, then to the fine one. `None` if the pixels do not
/// determine the unknowns, lead away from the start, or clearly show something else.
pub(super) fn descend<const N: usize, M: Model<N>>(
    start: M,
    [coarse, fine]: [&View<'_>; 2],
    prior: &Prior,
) -> Option<Fitted<M, N>> {
    let (mut model, coverage_variance) = lit(start, coarse)?;
    let mut before = f32::INFINITY;
    for round in 0..ROUNDS_MAX {
        let last_view = round >= COARSE_ROUNDS || coarse.block_px == fine.block_px;
        let view = if last_view { fine } else { coarse };
        let block_px = view.block_px;
        let noise = f64::from(prior.noise / block_px as f32);
        let mut normal = model.normal(view);
        let n = normal.n;
        if n < N as f32 + 3.0 {
            return None;
        }
        let freedom = f64::from(n) - N as f64;
        let variance = (normal.squares / freedom).max(noise * noise);
        let residual_max = prior.residual_ratio_max * model.light().contrast();
        let allowed = libm::hypot(noise, f64::from(residual_max));
        let excess = |squares: f64| (libm::sqrt(squares.max(0.0) / freedom) / allowed) as f32;
        let left = excess(normal.squares);
        let stuck = left > GIVE_UP[3] && left > (1.0 - PROGRESS_MIN) * before;
        if stuck || left > GIVE_UP[round.min(3)] {
            return None;
        }
        before = if last_view { left } else { f32::INFINITY };
        model.expect(&start, prior, variance, &mut normal);
        let squares = normal.squares;
        let Solution {
            step,
            taken,
            inverse,
        } = normal.solve()?;
        if round == 0 && excess(squares - taken) > GIVE_UP_PROMISED {
            return None;
        }
        let small = last_view && model.is_small(&step);
        model.take(&step);
        if !model.is_near(&start) {
            return None;
        }
        if small || round + 1 == ROUNDS_MAX {
            let left = ((squares - taken) / freedom).max(0.0);
            let variance = left.max(noise * noise);
            return Some(Fitted {
                model,
                left,
                coverage_variance,
                covariance: inverse.map(|row| row.map(|c| variance * c)),
                n,
                block_px,
            });
        }
    }
    None
}

/// The model with least-squares light and contrast, without a slope, and the variance of the
/// coverage. `None` if the shape is not darker than its plate.
fn lit<const N: usize, M: Model<N>>(mut model: M, view: &View<'_>) -> Option<(M, f64)> {
    // Sums of 1, coverage, its square, grey, grey times coverage.
    let mut sums = [0.0f32; 5];
    model.each_sample(view, |sample| {
        let Sample { weight, grey, .. } = sample;
        let t = sample.coverage[0];
        for (sum, moment) in sums.iter_mut().zip([1.0, t, t * t, grey, grey * t]) {
            *sum += weight * moment;
        }
    });
    let [n, t, tt, g, gt] = sums.map(f64::from);
    let determinant = n * tt - t * t;
    if n < N as f64 || determinant < 1e-3 * n * n {
        return None;
    }
    let light = (g * tt - gt * t) / determinant;
    let dark = (g * t - n * gt) / determinant;
    *model.light_mut() = Light {
        bare: light as f32,
        slope: [0.0; 2],
        share: (dark / light) as f32,
    };
    (light > 1.0 && dark > 0.05 * light).then_some((model, determinant / (n * n)))
}
