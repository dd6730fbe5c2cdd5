//! A plate that is seen at an angle or through a wide lens.

use super::descent::{Deviation, Light, Model, OF_LIGHT};
use super::equations::{Batch, Normal};
use super::layers::Blend;
use super::plate_map::{PlateMap, TERMS, product, terms};
use super::view::{Footprint, Place, Sample, View};
use super::{LAST_STEP_BLUR, Prior, StretchPrior};

/// Unknowns: those of the light, the logarithm of the blur, and the factors of the map.
pub(super) const UNKNOWNS: usize = BLUR + 1 + 2 * TERMS;
pub(super) const BLUR: usize = OF_LIGHT;
pub(super) const FACTORS: [usize; 2] = [BLUR + 1, BLUR + 1 + TERMS];

/// The corners of a plate and its centre, in units of its side.
const POINTS: [[f32; 2]; 5] = [
    [-0.5, -0.5],
    [0.5, -0.5],
    [0.5, 0.5],
    [-0.5, 0.5],
    [0.0, 0.0],
];

/// Maximum stretch and curvature of a plate that can be read: beyond, it is seen from the side.
const STRETCH_MAX: f32 = 0.65;
const CURVATURE_MAX: f32 = 0.35;

/// A fit ends with a step that moves no corner by more than this; the shape itself, which is nearer
/// to the centre, then moves by half of it, and the next step would be a tenth.
const LAST_MOVE_PX: f32 = 0.03;

/// Below this stretch, the blur is round on the plate, too.
const ROUND: f32 = 0.01;

/// Distance between the points of a second derivative, in standard deviations of the blur.
const BENDS_APART: f32 = 0.7;

/// Light, map and blur.
#[derive(Debug, Clone, Copy)]
pub(super) struct Curved {
    light: Light,
    pub(super) map: PlateMap,
    pub(super) blur_px: f32,
    /// What the stretch is expected to be.
    expected: StretchPrior,
}

impl Curved {
    pub(super) fn new(
        mut map: PlateMap,
        blur_px: f32,
        prior: &Prior,
        expected: StretchPrior,
    ) -> Self {
        let curvature = expected_curvature(&map, &expected);
        for (factors, expected) in map.factors.iter_mut().zip(curvature) {
            factors[3..].copy_from_slice(&expected);
        }
        Self {
            light: Light::new(prior),
            map,
            blur_px,
            expected,
        }
    }
}

/// The factors of second degree that are expected of a map with these slopes.
fn expected_curvature(map: &PlateMap, expected: &StretchPrior) -> [[f32; 3]; 2] {
    map.factors.map(|[_, of_x, of_y, ..]| {
        [0, 1, 2].map(|i: usize| {
            let moved = of_x * expected.curvature[0][i] + of_y * expected.curvature[1][i];
            moved * map.unit_px
        })
    })
}

/// How the two numbers of the stretch depend on the unknowns. To first order in the stretch.
pub(super) fn stretch_factors(map: &PlateMap) -> [[f64; UNKNOWNS]; 2] {
    // A change of the slopes changes the inverse by -inverse · change · inverse.
    let inverse = map.inverse_slopes(map.centre());
    let mut factors = [[0.0; UNKNOWNS]; 2];
    for (i, first) in FACTORS.into_iter().enumerate() {
        let [x, y] = [0, 1].map(|row: usize| f64::from(inverse[row][i]));
        let [of_x, of_y] = [first + 1, first + 2];
        factors[0][of_x] = -0.5 * x;
        factors[0][of_y] = 0.5 * y;
        factors[1][of_x] = -0.5 * y;
        factors[1][of_y] = -0.5 * x;
    }
    factors
}

/// How the centre, in pixels, and the turn of a plate depend on the unknowns.
pub(super) fn pose_factors(map: &PlateMap) -> [[f64; UNKNOWNS]; 3] {
    let at = map.centre();
    let inverse = map.inverse_slopes(at);
    let of_value = terms(at[0], at[1]);
    let [x, y] = at;
    let of_slopes = [
        [0.0, 1.0, 0.0, 2.0 * x, y, 0.0],
        [0.0, 0.0, 1.0, 0.0, x, 2.0 * y],
    ];
    // The drawing's axis in the picture.
    let axis = [0, 1].map(|row: usize| inverse[row][1]);
    let length2 = axis[0] * axis[0] + axis[1] * axis[1];
    let mut factors = [[0.0; UNKNOWNS]; 3];
    for (i, first) in FACTORS.into_iter().enumerate() {
        for term in 0..TERMS {
            let unknown = first + term;
            for row in 0..2 {
                factors[row][unknown] = f64::from(-map.unit_px * inverse[row][i] * of_value[term]);
            }
            let slope = of_slopes[0][term] * axis[0] + of_slopes[1][term] * axis[1];
            let [dx, dy] = [0, 1].map(|row: usize| -inverse[row][i] * slope);
            factors[2][unknown] = f64::from((axis[0] * dy - axis[1] * dx) / length2);
        }
    }
    factors
}

impl Model<UNKNOWNS> for Curved {
    fn light(&self) -> &Light {
        &self.light
    }

    fn light_mut(&mut self) -> &mut Light {
        &mut self.light
    }

    #[inline(always)]
    fn each_sample(&self, view: &View<'_>, mut found: impl FnMut(Sample)) {
        let PlateMap {
            origin,
            unit_px,
            factors: [of_u, of_v],
        } = self.map;
        let per_unit = 1.0 / unit_px;
        let slopes = self.map.slopes([0.0; 2]);
        let inverse = self.map.inverse_slopes([0.0; 2]);
        // A tenth more, for the curvature.
        let reach = inverse.map(|[a, b]| 0.55 * unit_px * (a.abs() + b.abs()));
        // Pixels per unit of u and v, across the borders.
        let [px_per_u, px_per_v] = slopes.map(|[a, b]| unit_px / libm::hypotf(a, b));
        let place = |dx: f32, dy: f32| {
            let terms = terms(dx * per_unit, dy * per_unit);
            let (u, v) = (product(&of_u, &terms), product(&of_v, &terms));
            let along = (0.5 - u.abs()) * px_per_u;
            let across = (0.5 - v.abs()) * px_per_v;
            Place {
                u,
                v,
                inside_px: if along < across { along } else { across },
            }
        };
        // A round blur in the picture is an ellipse on the plate. The coverage with it is that with
        // a round blur of the same area, and half the product of the difference of their variances
        // and the second derivatives.
        let [[a, b], [c, d]] = slopes;
        let determinant = a * d - b * c;
        let plate_px = unit_px / libm::sqrtf(determinant);
        let of_shape = [
            0.5 * ((a * a + b * b) / determinant - 1.0),
            (a * c + b * d) / determinant,
            0.5 * ((c * c + d * d) / determinant - 1.0),
        ];
        let blends = view.at_blur(self.blur_px, plate_px);
        let flattened =
            |blend: &Blend<'_>, variance: f32, coverage: &mut [f32; 4], at: [f32; 2]| {
                let variance = variance / (plate_px * plate_px);
                let bends = blend.bends(at[0], at[1], BENDS_APART * libm::sqrtf(variance));
                let sum: f32 = of_shape.iter().zip(bends).map(|(o, b)| o * b).sum();
                coverage[0] += variance * sum;
            };
        let variances = [
            view.blur_variance(self.blur_px),
            view.soft_variance(self.blur_px),
        ];
        let [s, t] = self.map.stretch();
        let is_round = libm::hypotf(s, t) < ROUND;
        let footprint = Footprint {
            centre: origin,
            reach,
        };
        let sharpening = self.light.sharpening;
        let each = |mut sample: Sample| {
            if !is_round {
                let at = [sample.u, sample.v];
                flattened(&blends.own, variances[0], &mut sample.coverage, at);
                if let (Some(blend), Some(soft)) = (&blends.soft, &mut sample.soft) {
                    flattened(blend, variances[1], soft, at);
                }
            }
            found(sample);
        };
        view.each_sample(footprint, self.blur_px, sharpening, &blends, place, each);
    }

    fn normal(&self, view: &View<'_>, deviation: Deviation) -> Normal<UNKNOWNS> {
        let light = self.light.shown(deviation.noise, view.softer(self.blur_px));
        let per_unit = 1.0 / self.map.unit_px;
        let lens_shares = view.lens_shares(self.blur_px);
        let mut normal = Normal::new();
        let mut batch = Batch::new(deviation.tolerance);
        self.each_sample(view, |sample| {
            let terms = terms(
                sample.from_centre[0] * per_unit,
                sample.from_centre[1] * per_unit,
            );
            let [_, x, y, ..] = terms;
            let predicted = light.predict(&sample, [x, y]);
            let blurs = sample.rates(3);
            let of_lens = [0, 1].map(|i| blurs[i] * lens_shares[i]);
            let mut derivatives = [0.0; UNKNOWNS];
            derivatives[..OF_LIGHT].copy_from_slice(&predicted.of_light);
            derivatives[BLUR] = predicted.of(of_lens);
            for (first, of) in FACTORS.into_iter().zip([1, 2]) {
                let slope = predicted.of(sample.rates(of));
                for (derivative, term) in derivatives[first..].iter_mut().zip(terms) {
                    *derivative = slope * term;
                }
            }
            let residual = sample.grey - predicted.grey;
            batch.push(
                sample.weight * predicted.weight,
                sample.is_rim,
                derivatives,
                residual,
                &mut normal,
            );
        });
        batch.add_to(&mut normal);
        normal
    }

    fn expect(&self, _start: &Self, prior: &Prior, variance: f64, normal: &mut Normal<UNKNOWNS>) {
        let weight = |sigma: f32| variance / f64::from(sigma * sigma);
        let StretchPrior {
            blur_px,
            stretch: expected,
            sigma,
            curvature_sigma,
            ..
        } = self.expected;
        let off = libm::logf(self.blur_px / blur_px);
        normal.expect(BLUR, off, weight(prior.blur_ln_sigma));
        let factors = stretch_factors(&self.map);
        for ((factors, now), expected) in factors.iter().zip(self.map.stretch()).zip(expected) {
            normal.expect_combination(factors, now - expected, weight(sigma));
        }
        let expected = expected_curvature(&self.map, &self.expected);
        for ((first, factors), expected) in FACTORS.into_iter().zip(&self.map.factors).zip(expected)
        {
            for (i, (now, expected)) in factors[3..].iter().zip(expected).enumerate() {
                normal.expect(first + 3 + i, now - expected, weight(curvature_sigma));
            }
        }
    }

    fn take(&mut self, step: &[f64; UNKNOWNS]) {
        let unit_px = self.map.unit_px;
        let moved = moved(step);
        // In units of the plate's side.
        let reach = f32::min(0.15, 2.0 / unit_px);
        let share = if moved > reach { reach / moved } else { 1.0 };
        let step = step.map(|s| s as f32);
        self.blur_px *= libm::expf(step[BLUR].clamp(-0.4, 0.4));
        for (first, factors) in FACTORS.into_iter().zip(&mut self.map.factors) {
            for (factor, step) in factors.iter_mut().zip(&step[first..]) {
                *factor += share * step;
            }
        }
    }

    fn is_small(&self, step: &[f64; UNKNOWNS]) -> bool {
        moved(step) * self.map.unit_px < LAST_MOVE_PX && step[BLUR].abs() < LAST_STEP_BLUR
    }

    fn is_near(&self, start: &Self) -> bool {
        let (now, start) = (self.map.pose(self.blur_px), start.map.pose(start.blur_px));
        let reach = 1.0 + 0.15 * start.plate_px;
        let [s, t] = self.map.stretch();
        let curvature = self.map.factors.iter().flat_map(|factors| &factors[3..]);
        (now.centre[0] - start.centre[0]).abs() < reach
            && (now.centre[1] - start.centre[1]).abs() < reach
            && (0.6..1.7).contains(&(now.plate_px / start.plate_px))
            && (0.02..12.0).contains(&now.blur_px)
            && libm::hypotf(s, t) < STRETCH_MAX
            && curvature.fold(0.0, |max, c| f32::max(max, c.abs())) < CURVATURE_MAX
    }
}

/// How far a step moves the points of the plate at most, in units of its side.
fn moved(step: &[f64; UNKNOWNS]) -> f32 {
    let of_point = |[x, y]: [f32; 2]| {
        let terms = terms(x, y);
        let [u, v] = FACTORS.map(|first| {
            let step: [f32; TERMS] = core::array::from_fn(|term| step[first + term] as f32);
            product(&step, &terms)
        });
        libm::hypotf(u, v)
    };
    POINTS.into_iter().map(of_point).fold(0.0, f32::max)
}
