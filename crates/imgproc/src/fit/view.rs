//! The pixels of a plate, or blocks of them, and what a shape predicts there.

use super::Within;
use super::layers::{Blend, Layers};
use crate::Size;
use crate::tone::ToneCurve;

/// Pixels closer to the plate's border than this many blurs do not count.
const BORDER_BLURS: f32 = 1.8;

/// Width of the rim of a plate, pixels. No figure reaches it on plates of 20 pixels and more.
const RIM_PX: f32 = 1.5;

/// Standard deviation of the blur that sharpening compares a picture with, pixels. Cameras combine
/// three to five pixels in a row.
const SHARPENING_RADIUS_PX: f32 = 1.0;

/// Variance of the position within its pixel at which light arrives.
pub(super) const PIXEL_VARIANCE: f32 = 1.0 / 12.0;

/// The pixels to be fitted.
pub(super) struct View<'a> {
    pub(super) plane: &'a [u8],
    pub(super) size: Size,
    pub(super) within: Option<Within<'a>>,
    pub(super) layers: Layers<'a>,
    /// Side of a block, in pixels.
    pub(super) block_px: usize,
    /// The expected tone curve, and the light of every grey level with it if blocks are averaged.
    pub(super) curve: ToneCurve,
    /// Whether the camera may sharpen its pictures.
    pub(super) is_sharpened: bool,
    pub(super) light: [f32; 256],
    /// Where the slope of the light is zero.
    pub(super) origin: [f32; 2],
}

/// One pixel, or block of pixels, of a plate.
pub(super) struct Sample {
    /// 1, less at the border of the counted area.
    pub(super) weight: f32,
    /// Whether it is near the border of the counted area.
    pub(super) is_rim: bool,
    pub(super) grey: f32,
    /// From the plate's centre, in pixels.
    pub(super) from_centre: [f32; 2],
    /// The same in the plate's own axes, in units of its side.
    pub(super) u: f32,
    pub(super) v: f32,
    /// Coverage, and its derivatives with respect to u, v and the logarithm of the blur.
    pub(super) coverage: [f32; 4],
    /// The same with the blur that sharpening compares with.
    pub(super) soft: Option<[f32; 4]>,
}

impl Sample {
    /// Rates at which both coverages change with u, v or the logarithm of their blur: 1, 2 or 3.
    #[inline(always)]
    pub(super) fn rates(&self, of: usize) -> [f32; 2] {
        [self.coverage[of], self.soft.map_or(0.0, |soft| soft[of])]
    }
}

/// A shape at the blur of a picture, and at that of the softer one that sharpening compares it with.
pub(super) struct Blends<'a> {
    pub(super) own: Blend<'a>,
    pub(super) soft: Option<Blend<'a>>,
}

/// The part of a picture that shows a plate.
#[derive(Clone, Copy)]
pub(super) struct Footprint {
    pub(super) centre: [f32; 2],
    /// Half of its width and height, in pixels.
    pub(super) reach: [f32; 2],
}

/// Where a pixel lies on a plate.
pub(super) struct Place {
    /// In the plate's own axes, in units of its side from its centre.
    pub(super) u: f32,
    pub(super) v: f32,
    /// Distance from the nearest border of the plate, in pixels; negative outside.
    pub(super) inside_px: f32,
}

impl View<'_> {
    /// Variance of the total blur of a sample.
    pub(super) fn blur_variance(&self, blur_px: f32) -> f32 {
        let block = self.block_px as f32;
        blur_px * blur_px + PIXEL_VARIANCE * block * block
    }

    /// The same for the softer picture that sharpening compares with.
    pub(super) fn soft_variance(&self, blur_px: f32) -> f32 {
        self.blur_variance(blur_px) + SHARPENING_RADIUS_PX * SHARPENING_RADIUS_PX
    }

    /// Ratio of the blurs of a sample and of the softer picture.
    pub(super) fn softer(&self, blur_px: f32) -> f32 {
        libm::sqrtf(self.blur_variance(blur_px) / self.soft_variance(blur_px))
    }

    /// How the logarithms of both blurs change with that of the lens.
    pub(super) fn lens_shares(&self, blur_px: f32) -> [f32; 2] {
        [self.blur_variance(blur_px), self.soft_variance(blur_px)].map(|v| blur_px * blur_px / v)
    }

    /// The shape at a blur of the lens.
    pub(super) fn at_blur(&self, blur_px: f32, plate_px: f32) -> Blends<'_> {
        let at = |variance: f32| self.layers.at_blur(libm::sqrtf(variance) / plate_px);
        Blends {
            own: at(self.blur_variance(blur_px)),
            soft: self.is_sharpened.then(|| at(self.soft_variance(blur_px))),
        }
    }

    /// Calls `found` with every sample on the plate that counts. `place` locates a pixel, given
    /// relative to the centre of the footprint.
    #[inline(always)]
    pub(super) fn each_sample(
        &self,
        footprint: Footprint,
        blur_px: f32,
        sharpening: f32,
        blends: &Blends<'_>,
        place: impl Fn(f32, f32) -> Place,
        mut found: impl FnMut(Sample),
    ) {
        let Footprint { centre, reach } = footprint;
        let block = self.block_px as f32;
        // The share of the softer picture in the sharpened one.
        let soft_share = if self.is_sharpened && sharpening > 0.0 {
            sharpening / (1.0 + sharpening)
        } else {
            0.0
        };
        let variance = self.blur_variance(blur_px);
        let more = soft_share * (self.soft_variance(blur_px) - variance);
        let border_px = BORDER_BLURS * libm::sqrtf(variance + more);
        let margin_px = (border_px + 0.5) as usize;
        let middle_px = self.block_px / 2;
        let per_block = 1.0 / block;
        // Columns and rows of blocks, the first centred on the pixel (block - 1) / 2.
        let middle = (block - 1.0) / 2.0;
        let span = |axis: usize, length: usize| {
            let (centre, reach) = (centre[axis], (reach[axis] - border_px + 1.0).max(0.0));
            let from = ((centre - reach - middle) / block).max(0.0) as usize;
            let to = ((centre + reach - middle) / block + 1.0).max(0.0) as usize;
            from..(to + 1).min(length / self.block_px).max(from)
        };
        for row in span(1, self.size.height) {
            let dy = row as f32 * block + middle - centre[1];
            for column in span(0, self.size.width) {
                let dx = column as f32 * block + middle - centre[0];
                let Place { u, v, inside_px } = place(dx, dy);
                // Full weight from half a pixel inside the limit on.
                let inside = (inside_px - border_px) * per_block + 0.5;
                if inside <= 0.0 {
                    continue;
                }
                if let Some(within) = &self.within {
                    let [x, y] = [column, row].map(|i| i * self.block_px + middle_px);
                    if !within.holds(x, y, margin_px) {
                        continue;
                    }
                }
                let Some(coverage) = blends.own.coverage(u, v) else {
                    continue;
                };
                let soft = blends.soft.as_ref().and_then(|blend| blend.coverage(u, v));
                found(Sample {
                    weight: inside.min(1.0),
                    is_rim: inside_px < border_px + RIM_PX,
                    grey: self.grey(column, row),
                    from_centre: [dx, dy],
                    u,
                    v,
                    coverage,
                    soft,
                });
            }
        }
    }

    /// Grey level of a block's mean light.
    fn grey(&self, column: usize, row: usize) -> f32 {
        let n = self.block_px;
        if n == 1 {
            return f32::from(self.plane[row * self.size.width + column]);
        }
        let mut sum = 0.0;
        for y in row * n..(row + 1) * n {
            let start = y * self.size.width + column * n;
            let pixels = &self.plane[start..start + n];
            sum += pixels
                .iter()
                .map(|&grey| self.light[usize::from(grey)])
                .sum::<f32>();
        }
        self.curve.grey(sum / (n * n) as f32)
    }
}
