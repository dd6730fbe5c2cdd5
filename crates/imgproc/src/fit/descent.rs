//! Gauss-Newton rounds of any model of a plate, and when to give up.

use super::equations::{Normal, Solution};
use super::view::{Sample, View};
use super::{Prior, ROUNDS_MAX};
use crate::tone::{Lit, Shown, ToneCurve};

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

/// Samples of a plate that may be covered belong to it within this many times the permitted
/// residual. The first rounds tolerate this share of the contrast, and half of it with each further
/// round.
const COVERED_TOLERANCE: f32 = 2.0;
const FIRST_TOLERANCE: f32 = 0.5;

/// Freedom of tone curve and sharpening in the coarse view. Its blocks do not show the profile of an
/// edge, and a larger triangle elsewhere differs only in that.
const COARSE_FREEDOM: f64 = 0.1;

/// Number of rounds with the coarse view.
const COARSE_ROUNDS: usize = 2;

/// Number of unknowns of [`Light`], the first ones of every model: grey level of the bare plate, slope
/// of the light in x and y, grey level of the shape, exponent of the tone curve, sharpening.
pub(super) const OF_LIGHT: usize = 6;
const BARE: usize = 0;
const SLOPE: [usize; 2] = [1, 2];
const DARK: usize = 3;
pub(super) const TONE: usize = 4;
pub(super) const SHARPENING: usize = 5;

/// Standard deviation of the coverage, as it is interpolated between samples and blurs.
const COVERAGE_SIGMA: f32 = 0.006;

/// Range of the exponent.
const TONE_RANGE: [f32; 2] = [0.3, 1.4];

/// Range of the sharpening.
const SHARPENING_RANGE: [f32; 2] = [0.0, 4.0];

/// Light on a plate, and how the camera shows it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    /// Grey level of the bare plate at its centre.
    pub(super) bare: f32,
    /// Grey level of the shape at the same place.
    pub(super) dark: f32,
    /// Change of the light per side of the plate, as a share of it.
    slope: [f32; 2],
    /// Exponent of the tone curve.
    pub(super) tone: f32,
    /// Share of the difference from a softer picture that the camera adds.
    pub(super) sharpening: f32,
}

impl Light {
    /// White and black, until they are known.
    pub(super) fn new(prior: &Prior) -> Self {
        Self {
            bare: 255.0,
            dark: 0.0,
            slope: [0.0; 2],
            tone: prior.tone,
            sharpening: prior.sharpening,
        }
    }

    /// Difference between the plate and the shape, in grey levels.
    pub(super) fn contrast(&self) -> f32 {
        self.bare - self.dark
    }

    /// Adds what is known of the camera before the fit, with a freedom from 0 to 1. `variance` is
    /// that of a sample.
    fn expect<const N: usize>(
        &self,
        prior: &Prior,
        freedom: f64,
        variance: f64,
        normal: &mut Normal<N>,
    ) {
        for (unknown, off, sigma) in [
            (TONE, self.tone - prior.tone, prior.tone_sigma),
            (
                SHARPENING,
                self.sharpening - prior.sharpening,
                prior.sharpening_sigma,
            ),
        ] {
            let sigma = freedom * f64::from(sigma);
            normal.expect(unknown, off, variance / (sigma * sigma));
        }
    }

    /// Adds a step of the unknowns.
    fn take(&mut self, step: &[f64]) {
        let step = |unknown: usize| step[unknown] as f32;
        self.bare = (self.bare + step(BARE)).max(1.0);
        self.dark = (self.dark + step(DARK)).clamp(-0.2 * self.bare, 0.98 * self.bare);
        for (slope, unknown) in self.slope.iter_mut().zip(SLOPE) {
            *slope += step(unknown);
        }
        // Unlike `clamp`, also for a step that is not a number.
        let moved = |value: f32, step: f32, [min, max]: [f32; 2]| (value + step).max(min).min(max);
        self.tone = moved(self.tone, step(TONE).clamp(-0.2, 0.2), TONE_RANGE);
        let step = step(SHARPENING).clamp(-0.7, 0.7);
        self.sharpening = moved(self.sharpening, step, SHARPENING_RANGE);
    }

    /// What it shows, ready for many samples with this noise. `softer` is the ratio of the blurs of
    /// the picture and the softer one that sharpening compares it with.
    pub(super) fn shown(&self, noise: f32, softer: f32) -> ShownLight {
        let error_per_slope2 = COVERAGE_SIGMA * COVERAGE_SIGMA / (noise * noise);
        let contrast = self.contrast();
        // A blur of grey levels moves no edge, unlike one of the light. In units of the softer blur,
        // the edge is off by less: as with a curve that is nearer to a line.
        let soft_tone = 1.0 + (self.tone - 1.0) * softer;
        ShownLight {
            own: Levels::new(self, self.tone),
            soft: Levels::new(self, soft_tone),
            softer,
            slope: self.slope,
            sharpening: self.sharpening,
            error_per_slope2,
            even_error: 1.0 + error_per_slope2 * contrast * contrast,
        }
    }
}

/// Light of plate and shape with a tone curve.
struct Levels {
    curve: ToneCurve,
    bare: Lit,
    dark: Lit,
}

impl Levels {
    fn new(light: &Light, exponent: f32) -> Self {
        let curve = ToneCurve::new(exponent);
        Self {
            curve,
            bare: curve.lit(light.bare),
            dark: curve.lit(light.dark),
        }
    }

    /// The grey level of a pixel that the shape covers by a share.
    #[inline(always)]
    fn mixed(&self, coverage: f32, brightness: f32, [x, y]: [f32; 2]) -> Mixed {
        let Self { curve, bare, dark } = self;
        let rest = 1.0 - coverage;
        let even = bare.light * rest + dark.light * coverage;
        let Shown {
            grey,
            per_light,
            per_exponent,
        } = curve.shown(brightness * even);
        let per_even = per_light * brightness;
        let mixed = bare.per_exponent * rest + dark.per_exponent * coverage;
        let mut of_light = [0.0; OF_LIGHT];
        of_light[BARE] = per_even * bare.per_grey * rest;
        of_light[SLOPE[0]] = per_light * even * x;
        of_light[SLOPE[1]] = per_light * even * y;
        of_light[DARK] = per_even * dark.per_grey * coverage;
        of_light[TONE] = per_exponent + per_even * mixed;
        Mixed {
            grey,
            of_light,
            of_coverage: per_even * (dark.light - bare.light),
        }
    }
}

/// A grey level with its derivatives.
struct Mixed {
    grey: f32,
    of_light: [f32; OF_LIGHT],
    of_coverage: f32,
}

/// Predicts grey levels.
pub(super) struct ShownLight {
    own: Levels,
    soft: Levels,
    softer: f32,
    slope: [f32; 2],
    sharpening: f32,
    /// Variance from errors of the coverage, relative to that of the noise: per square of the grey
    /// levels per coverage; and the total of both with a linear curve.
    error_per_slope2: f32,
    even_error: f32,
}

/// A predicted grey level with its derivatives.
pub(super) struct Predicted {
    pub(super) grey: f32,
    pub(super) of_light: [f32; OF_LIGHT],
    /// Derivatives with respect to the coverage, and to that of the softer picture.
    of_coverage: [f32; 2],
    /// 1 for a linear curve. Less where a curve is so steep that errors of the coverage exceed the
    /// noise: in the dark.
    pub(super) weight: f32,
}

impl Predicted {
    /// Derivative with respect to something that changes the coverages at these rates.
    #[inline(always)]
    pub(super) fn of(&self, [own, soft]: [f32; 2]) -> f32 {
        self.of_coverage[0] * own + self.of_coverage[1] * soft
    }
}

impl ShownLight {
    /// The grey level of a sample at a place in units of the plate's side.
    #[inline(always)]
    pub(super) fn predict(&self, sample: &Sample, place: [f32; 2]) -> Predicted {
        let brightness = 1.0 + self.slope[0] * place[0] + self.slope[1] * place[1];
        let Mixed {
            mut grey,
            mut of_light,
            of_coverage,
        } = self.own.mixed(sample.coverage[0], brightness, place);
        let mut of_coverage = [of_coverage, 0.0];
        if let Some(soft) = &sample.soft {
            let soft = self.soft.mixed(soft[0], brightness, place);
            let (own_share, soft_share) = (1.0 + self.sharpening, -self.sharpening);
            let own = grey;
            grey = own_share * own + soft_share * soft.grey;
            // Overshoot ends at white and black.
            let (top, bottom) = (own.max(255.0), own.min(0.0));
            if grey > top || grey < bottom {
                grey = grey.clamp(bottom, top);
                of_light = [0.0; OF_LIGHT];
                of_coverage = [0.0; 2];
            } else {
                for (own, soft) in of_light.iter_mut().zip(soft.of_light) {
                    *own = own_share * *own + soft_share * soft;
                }
                // The exponent of the softer picture changes less.
                of_light[TONE] += soft_share * (self.softer - 1.0) * soft.of_light[TONE];
                of_light[SHARPENING] = own - soft.grey;
                of_coverage = [own_share * of_coverage[0], soft_share * soft.of_coverage];
            }
        }
        let slope = of_coverage[0] + of_coverage[1];
        Predicted {
            grey,
            of_light,
            of_coverage,
            weight: self.even_error / (1.0 + self.error_per_slope2 * slope * slope),
        }
    }
}

/// How far grey levels may be from those predicted.
#[derive(Clone, Copy)]
pub(super) struct Deviation {
    /// Standard deviation of a sample.
    pub(super) noise: f32,
    /// Beyond this, a sample does not show the plate. Infinite if all samples do.
    pub(super) tolerance: f32,
}

/// What predicts the grey levels of a plate, with `N` unknowns.
pub(super) trait Model<const N: usize>: Copy {
    fn light(&self) -> &Light;

    fn light_mut(&mut self) -> &mut Light;

    /// Calls `found` with every sample on the plate that counts.
    fn each_sample(&self, view: &View<'_>, found: impl FnMut(Sample));

    /// The equations of a round, from all samples.
    fn normal(&self, view: &View<'_>, deviation: Deviation) -> Normal<N>;

    /// Adds what is known of the plate before the fit. `variance` is that of a sample.
    fn expect(&self, start: &Self, prior: &Prior, variance: f64, normal: &mut Normal<N>);

    /// Adds a step of all unknowns but the light, limited to what the equations are good for.
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
    /// Shares of the samples inside and at the rim that do not show the plate.
    pub(super) hidden: [f32; 2],
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
        let contrast = model.light().contrast();
        let of_pixels = prior.noise / block_px as f32;
        let noise = f64::from(libm::hypotf(of_pixels, COVERAGE_SIGMA * contrast));
        let residual_max = prior.residual_ratio_max * contrast;
        let allowed = libm::hypot(noise, f64::from(residual_max));
        let last_tolerance = COVERED_TOLERANCE * allowed as f32;
        let tolerance = if prior.may_be_covered {
            last_tolerance.max(FIRST_TOLERANCE * contrast / (1 << round) as f32)
        } else {
            f32::INFINITY
        };
        let deviation = Deviation {
            noise: of_pixels,
            tolerance,
        };
        let mut normal = model.normal(view, deviation);
        let n = normal.n;
        if n < N as f32 + 3.0 {
            return None;
        }
        let freedom = f64::from(n) - N as f64;
        let variance = (normal.squares / freedom).max(noise * noise);
        let excess = |squares: f64| (libm::sqrt(squares.max(0.0) / freedom) / allowed) as f32;
        let left = excess(normal.squares);
        let stuck = left > GIVE_UP[3] && left > (1.0 - PROGRESS_MIN) * before;
        if stuck || left > GIVE_UP[round.min(3)] {
            return None;
        }
        before = if last_view { left } else { f32::INFINITY };
        model.expect(&start, prior, variance, &mut normal);
        let of_camera = if last_view { 1.0 } else { COARSE_FREEDOM };
        model
            .light()
            .expect(prior, of_camera, variance, &mut normal);
        let squares = normal.squares;
        let hidden = normal.parts.map(|part| part.hidden_share());
        let Solution {
            step,
            taken,
            inverse,
        } = normal.solve()?;
        if round == 0 && excess(squares - taken) > GIVE_UP_PROMISED {
            return None;
        }
        let is_decided = !prior.may_be_covered || tolerance <= last_tolerance;
        let small = last_view && is_decided && model.is_small(&step);
        model.light_mut().take(&step);
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
                hidden,
            });
        }
    }
    None
}

/// The model with least-squares light and contrast, without a slope, and the variance of the
/// coverage. `None` if the shape is not darker than its plate.
fn lit<const N: usize, M: Model<N>>(mut model: M, view: &View<'_>) -> Option<(M, f64)> {
    // Sums of 1, coverage, its square, light, light times coverage.
    let mut sums = [0.0f32; 5];
    model.each_sample(view, |sample| {
        let Sample { weight, grey, .. } = sample;
        let sharpening = model.light().sharpening;
        let more = |soft: [f32; 4]| sharpening * (sample.coverage[0] - soft[0]);
        let t = sample.coverage[0] + sample.soft.map_or(0.0, more);
        let light = view.curve.light(grey);
        for (sum, moment) in sums.iter_mut().zip([1.0, t, t * t, light, light * t]) {
            *sum += weight * moment;
        }
    });
    let [n, t, tt, l, lt] = sums.map(f64::from);
    let determinant = n * tt - t * t;
    if n < N as f64 || determinant < 1e-3 * n * n {
        return None;
    }
    let bare = (l * tt - lt * t) / determinant;
    let share = (l * t - n * lt) / determinant;
    let bare_grey = view.curve.grey(bare as f32);
    let light = Light {
        bare: bare_grey,
        // Most noise is that of the plate, and may exceed what a dark shape shows.
        dark: view.curve.grey((bare - share) as f32).max(-0.2 * bare_grey),
        ..*model.light()
    };
    *model.light_mut() = light;
    let is_dark = light.bare > 1.0 && light.contrast() > 0.05 * light.bare;
    is_dark.then_some((model, determinant / (n * n)))
}
