//! What the pixels of a plate, or blocks of them, contribute to the equations.

use super::equations::{BLUR, Batch, CONTRAST, Normal, SIZE, TURN, UNKNOWNS, X, Y};
use super::layers::Layers;
use super::{Pose, Within};
use crate::Size;

/// Pixels closer to the plate's border than this many blurs do not count.
const BORDER_BLURS: f32 = 1.8;

/// Variance of the position within its pixel at which light arrives.
pub(super) const PIXEL_VARIANCE: f32 = 1.0 / 12.0;

/// The unknowns.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub(super) light: f32,
    /// Per side of the plate.
    slope: [f32; 2],
    /// Share of the light that the shape does not reflect.
    pub(super) share: f32,
    pub(super) pose: Pose,
}

impl State {
    pub(super) fn take(&mut self, step: &[f64; UNKNOWNS]) {
        let step = step.map(|s| s as f32);
        let pose = &mut self.pose;
        let reach = (0.15 * pose.plate_px).min(2.0);
        self.light += step[0];
        self.slope[0] += step[1];
        self.slope[1] += step[2];
        self.share = (self.share + step[CONTRAST]).clamp(0.02, 1.2);
        pose.centre[0] += step[X].clamp(-reach, reach);
        pose.centre[1] += step[Y].clamp(-reach, reach);
        pose.turn_rad += step[TURN].clamp(-0.3, 0.3);
        pose.plate_px *= libm::expf(step[SIZE].clamp(-0.15, 0.15));
        pose.blur_px *= libm::expf(step[BLUR].clamp(-0.4, 0.4));
    }

    pub(super) fn is_near(&self, start: &Pose) -> bool {
        let pose = &self.pose;
        let reach = 1.0 + 0.15 * start.plate_px;
        (pose.centre[0] - start.centre[0]).abs() < reach
            && (pose.centre[1] - start.centre[1]).abs() < reach
            && (pose.turn_rad - start.turn_rad).abs() < 0.8
            && (0.6..1.7).contains(&(pose.plate_px / start.plate_px))
            && (0.02..12.0).contains(&pose.blur_px)
    }
}

/// The pixels to be fitted.
pub(super) struct View<'a> {
    pub(super) plane: &'a [u8],
    pub(super) size: Size,
    pub(super) within: Option<Within<'a>>,
    pub(super) layers: Layers<'a>,
    /// Side of a block, in pixels.
    pub(super) block_px: usize,
    /// Where the slope of the light is zero.
    pub(super) origin: [f32; 2],
}

/// One pixel, or block of pixels, of a plate.
struct Sample {
    /// 1, less at the border of the counted area.
    weight: f32,
    grey: f32,
    /// From the plate's centre, in pixels.
    from_centre: [f32; 2],
    /// The same in the plate's own axes, in units of its side.
    u: f32,
    v: f32,
    /// Coverage, and its derivatives with respect to u, v and the logarithm of the blur.
    coverage: [f32; 4],
}

impl View<'_> {
    /// Least-squares light and contrast for a pose, without a slope, and the variance of the
    /// coverage. `None` if the shape is not darker than its plate.
    pub(super) fn lit(&self, pose: Pose) -> Option<(State, f64)> {
        // Sums of 1, coverage, its square, grey, grey times coverage.
        let mut sums = [0.0f32; 5];
        self.each_sample(&pose, |sample| {
            let Sample { weight, grey, .. } = sample;
            let t = sample.coverage[0];
            for (sum, moment) in sums.iter_mut().zip([1.0, t, t * t, grey, grey * t]) {
                *sum += weight * moment;
            }
        });
        let [n, t, tt, g, gt] = sums.map(f64::from);
        let determinant = n * tt - t * t;
        if n < UNKNOWNS as f64 || determinant < 1e-3 * n * n {
            return None;
        }
        let light = (g * tt - gt * t) / determinant;
        let dark = (g * t - n * gt) / determinant;
        let state = State {
            light: light as f32,
            slope: [0.0; 2],
            share: (dark / light) as f32,
            pose,
        };
        (light > 1.0 && dark > 0.05 * light).then_some((state, determinant / (n * n)))
    }

    pub(super) fn normal(&self, state: &State) -> Normal {
        let Pose {
            centre,
            turn_rad,
            plate_px,
            blur_px,
        } = state.pose;
        let (sin, cos) = libm::sincosf(turn_rad);
        let per_px = 1.0 / plate_px;
        let from_origin = [0, 1].map(|i| centre[i] - self.origin[i]);
        // The pixel's own part of the blur does not change.
        let lens_share = blur_px * blur_px / self.blur_variance(blur_px);
        let mut normal = Normal::new();
        let mut batch = Batch::new();
        self.each_sample(&state.pose, |sample| {
            let [t, tu, tv, tblur] = sample.coverage;
            let Sample { u, v, .. } = sample;
            let slope = [0, 1].map(|i| (sample.from_centre[i] + from_origin[i]) * per_px);
            let light = state.light + state.slope[0] * slope[0] + state.slope[1] * slope[1];
            let bare = 1.0 - state.share * t;
            let dark = -light * state.share;
            let derivatives = [
                bare,
                slope[0] * bare,
                slope[1] * bare,
                -light * t,
                dark * (sin * tv - cos * tu) * per_px,
                dark * (-sin * tu - cos * tv) * per_px,
                dark * (tu * v - tv * u),
                dark * (-tu * u - tv * v - tblur),
                dark * tblur * lens_share,
            ];
            batch.push(
                sample.weight,
                derivatives,
                sample.grey - light * bare,
                &mut normal,
            );
        });
        batch.add_to(&mut normal);
        normal
    }

    /// Variance of the total blur of a sample.
    fn blur_variance(&self, blur_px: f32) -> f32 {
        let block = self.block_px as f32;
        blur_px * blur_px + PIXEL_VARIANCE * block * block
    }

    /// Calls `found` with every sample on the plate that counts.
    #[inline(always)]
    fn each_sample(&self, pose: &Pose, mut found: impl FnMut(Sample)) {
        let &Pose {
            centre,
            turn_rad,
            plate_px,
            blur_px,
        } = pose;
        let (sin, cos) = libm::sincosf(turn_rad);
        let block = self.block_px as f32;
        let spread_px = libm::sqrtf(self.blur_variance(blur_px));
        let blend = self.layers.at_blur(spread_px / plate_px);
        let border_px = BORDER_BLURS * spread_px;
        let half_px = plate_px / 2.0 - border_px;
        let margin_px = (border_px + 0.5) as usize;
        let middle_px = self.block_px / 2;
        let (per_block, per_px) = (1.0 / block, 1.0 / plate_px);
        // Columns and rows of blocks, the first centred on the pixel (block - 1) / 2.
        let reach = (half_px + 1.0).max(0.0) * (sin.abs() + cos.abs());
        let middle = (block - 1.0) / 2.0;
        let span = |centre: f32, length: usize| {
            let from = ((centre - reach - middle) / block).max(0.0) as usize;
            let to = ((centre + reach - middle) / block + 1.0).max(0.0) as usize;
            from..(to + 1).min(length / self.block_px).max(from)
        };
        for row in span(centre[1], self.size.height) {
            let dy = row as f32 * block + middle - centre[1];
            for column in span(centre[0], self.size.width) {
                let dx = column as f32 * block + middle - centre[0];
                let (along, across) = (cos * dx + sin * dy, cos * dy - sin * dx);
                // Full weight from half a pixel inside the limit on.
                let (off_along, off_across) = (along.abs(), across.abs());
                let off = if off_along > off_across {
                    off_along
                } else {
                    off_across
                };
                let inside = (half_px - off) * per_block + 0.5;
                if inside <= 0.0 {
                    continue;
                }
                if let Some(within) = &self.within {
                    let [x, y] = [column, row].map(|i| i * self.block_px + middle_px);
                    if !within.holds(x, y, margin_px) {
                        continue;
                    }
                }
                let (u, v) = (along * per_px, across * per_px);
                let Some(coverage) = blend.coverage(u, v) else {
                    continue;
                };
                found(Sample {
                    weight: inside.min(1.0),
                    grey: self.grey(column, row),
                    from_centre: [dx, dy],
                    u,
                    v,
                    coverage,
                });
            }
        }
    }

    /// Mean of a block's pixels.
    fn grey(&self, column: usize, row: usize) -> f32 {
        let n = self.block_px;
        if n == 1 {
            return f32::from(self.plane[row * self.size.width + column]);
        }
        let mut sum = 0;
        for y in row * n..(row + 1) * n {
            let start = y * self.size.width + column * n;
            sum += self.plane[start..start + n]
                .iter()
                .map(|&grey| u32::from(grey))
                .sum::<u32>();
        }
        sum as f32 / (n * n) as f32
    }
}
