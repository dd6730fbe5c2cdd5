//! A plate that the camera sees at a right angle: a square in the picture.

use super::descent::{Deviation, Light, Model, OF_LIGHT};
use super::equations::{Batch, Normal};
use super::view::{Footprint, Place, Sample, View};
use super::{LAST_STEP_BLUR, LAST_STEP_PX, Pose, Prior};

/// Unknowns: those of the light, x, y, turn, and the logarithms of size and blur.
pub(super) const UNKNOWNS: usize = OF_LIGHT + 5;
pub(super) const X: usize = OF_LIGHT;
pub(super) const Y: usize = X + 1;
pub(super) const TURN: usize = X + 2;
const SIZE: usize = X + 3;
pub(super) const BLUR: usize = X + 4;

/// Light and pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Upright {
    light: Light,
    pub(super) pose: Pose,
}

impl Upright {
    pub(super) fn new(pose: Pose, prior: &Prior) -> Self {
        Self {
            light: Light::new(prior),
            pose,
        }
    }
}

impl Model<UNKNOWNS> for Upright {
    fn light(&self) -> &Light {
        &self.light
    }

    fn light_mut(&mut self) -> &mut Light {
        &mut self.light
    }

    #[inline(always)]
    fn each_sample(&self, view: &View<'_>, found: impl FnMut(Sample)) {
        let Pose {
            centre,
            turn_rad,
            plate_px,
            blur_px,
        } = self.pose;
        let (sin, cos) = libm::sincosf(turn_rad);
        let per_px = 1.0 / plate_px;
        let half_px = plate_px / 2.0;
        let footprint = Footprint {
            centre,
            reach: [half_px * (sin.abs() + cos.abs()); 2],
        };
        let place = |dx: f32, dy: f32| {
            let (along, across) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let (off_along, off_across) = (along.abs(), across.abs());
            let off = if off_along > off_across {
                off_along
            } else {
                off_across
            };
            Place {
                u: along * per_px,
                v: across * per_px,
                inside_px: half_px - off,
            }
        };
        let blends = view.at_blur(blur_px, plate_px);
        let sharpening = self.light.sharpening;
        view.each_sample(footprint, blur_px, sharpening, &blends, place, found);
    }

    fn normal(&self, view: &View<'_>, deviation: Deviation) -> Normal<UNKNOWNS> {
        let Pose {
            centre,
            turn_rad,
            plate_px,
            blur_px,
        } = self.pose;
        let light = self.light.shown(deviation.noise, view.softer(blur_px));
        let (sin, cos) = libm::sincosf(turn_rad);
        let per_px = 1.0 / plate_px;
        let from_origin = [0, 1].map(|i| centre[i] - view.origin[i]);
        // The pixel's own part of the blur does not change.
        let lens_shares = view.lens_shares(blur_px);
        let mut normal = Normal::new();
        let mut batch = Batch::new(deviation.tolerance);
        self.each_sample(view, |sample| {
            let Sample { u, v, .. } = sample;
            let place = [0, 1].map(|i| (sample.from_centre[i] + from_origin[i]) * per_px);
            let predicted = light.predict(&sample, place);
            let [of_u, of_v] = [1, 2].map(|of| predicted.of(sample.rates(of)));
            let blurs = sample.rates(3);
            let of_lens = [0, 1].map(|i| blurs[i] * lens_shares[i]);
            let mut derivatives = [0.0; UNKNOWNS];
            derivatives[..OF_LIGHT].copy_from_slice(&predicted.of_light);
            derivatives[X] = (sin * of_v - cos * of_u) * per_px;
            derivatives[Y] = (-sin * of_u - cos * of_v) * per_px;
            derivatives[TURN] = of_u * v - of_v * u;
            derivatives[SIZE] = -of_u * u - of_v * v - predicted.of(blurs);
            derivatives[BLUR] = predicted.of(of_lens);
            batch.push(
                sample.weight * predicted.weight,
                sample.is_rim,
                derivatives,
                sample.grey - predicted.grey,
                &mut normal,
            );
        });
        batch.add_to(&mut normal);
        normal
    }

    fn expect(&self, start: &Self, prior: &Prior, variance: f64, normal: &mut Normal<UNKNOWNS>) {
        for (unknown, now, start, sigma) in [
            (
                BLUR,
                self.pose.blur_px,
                start.pose.blur_px,
                prior.blur_ln_sigma,
            ),
            (
                SIZE,
                self.pose.plate_px,
                start.pose.plate_px,
                prior.plate_ln_sigma,
            ),
        ] {
            let off = libm::logf(now / start);
            normal.expect(unknown, off, variance / f64::from(sigma * sigma));
        }
    }

    fn take(&mut self, step: &[f64; UNKNOWNS]) {
        let step = step.map(|s| s as f32);
        let pose = &mut self.pose;
        let reach = (0.15 * pose.plate_px).min(2.0);
        pose.centre[0] += step[X].clamp(-reach, reach);
        pose.centre[1] += step[Y].clamp(-reach, reach);
        pose.turn_rad += step[TURN].clamp(-0.3, 0.3);
        pose.plate_px *= libm::expf(step[SIZE].clamp(-0.15, 0.15));
        pose.blur_px *= libm::expf(step[BLUR].clamp(-0.4, 0.4));
    }

    fn is_small(&self, step: &[f64; UNKNOWNS]) -> bool {
        let half_px = f64::from(self.pose.plate_px) / 2.0;
        let moved_px = [step[X], step[Y], step[TURN] * half_px, step[SIZE] * half_px];
        moved_px.iter().all(|moved| moved.abs() < LAST_STEP_PX) && step[BLUR].abs() < LAST_STEP_BLUR
    }

    fn is_near(&self, start: &Self) -> bool {
        let (pose, start) = (&self.pose, &start.pose);
        let reach = 1.0 + 0.15 * start.plate_px;
        (pose.centre[0] - start.centre[0]).abs() < reach
            && (pose.centre[1] - start.centre[1]).abs() < reach
            && (pose.turn_rad - start.turn_rad).abs() < 0.8
            && (0.6..1.7).contains(&(pose.plate_px / start.plate_px))
            && (0.02..12.0).contains(&pose.blur_px)
    }
}
