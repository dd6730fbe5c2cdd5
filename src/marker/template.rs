//! Images of a marker at all blurs, which the fit compares with the pixels.

use imgproc::Size;
use imgproc::fit::Layers;

use crate::geometry::raster::{blur, fill_polygon};
use crate::marker::drawing::Drawing;
use crate::marker::reference::placed;

/// Samples along the side of a plate.
const PER_PLATE: usize = 100;

/// Samples beyond the plate on each side.
const BEYOND: usize = 4;

/// Samples in a row.
const SIDE: usize = PER_PLATE + 2 * BEYOND + 1;

/// Blur of the first layer in units of the plate: a lens of 0.3 px and a plate of 50 px.
const FIRST_BLUR: f32 = 0.0085;

/// Ratio of the blurs of consecutive layers.
const BLUR_RATIO: f32 = std::f32::consts::SQRT_2;

/// Number of layers; the last one has a blur of 0.38 plates.
const LAYERS: usize = 12;

/// Points of a [`Pattern`] along a side, and their spacing in units of the plate's side.
const POINTS: usize = 8;
const POINTS_APART: f32 = 0.1;

/// The layer from which a pattern is sampled: that of a plate of about 12 px.
const PATTERN_LAYER: usize = 5;

/// Lightness of a plate at a few points, row by row; mean 0, sum of squares 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pattern([f32; POINTS * POINTS]);

impl Pattern {
    /// The pattern of `light` at points of a plate, in units of its side from its centre; `None` if
    /// all values are equal.
    pub(crate) fn of(light: impl Fn([f32; 2]) -> Option<f32>) -> Option<Self> {
        let mut values = [0.0; POINTS * POINTS];
        for (i, value) in values.iter_mut().enumerate() {
            let at = |i: usize| (i as f32 - (POINTS - 1) as f32 / 2.0) * POINTS_APART;
            *value = light([at(i % POINTS), at(i / POINTS)])?;
        }
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        let norm = values
            .iter()
            .map(|v| (v - mean) * (v - mean))
            .sum::<f32>()
            .sqrt();
        (norm > 1e-3).then(|| Self(values.map(|v| (v - mean) / norm)))
    }

    /// This pattern rotated back by a quarter turn.
    pub(crate) fn turned(&self) -> Self {
        let last = POINTS - 1;
        Self(std::array::from_fn(|i| {
            let (column, row) = (i % POINTS, i / POINTS);
            self.0[column * POINTS + last - row]
        }))
    }

    /// Correlation of two patterns, -1 to 1.
    pub(crate) fn correlation(&self, other: &Self) -> f32 {
        self.0.iter().zip(other.0).map(|(a, b)| a * b).sum()
    }
}

/// Layers of one marker.
#[derive(Debug, Clone)]
pub(crate) struct Template {
    samples: Vec<f32>,
    pattern: Pattern,
}

impl Template {
    pub(crate) fn new(drawing: &Drawing) -> Self {
        let size = Size {
            width: SIDE,
            height: SIDE,
        };
        let middle = (SIDE - 1) as f32 / 2.0;
        let outline = placed(&drawing.outline, [middle, middle], 0.0, PER_PLATE as f32);
        let mut sharp = vec![0.0; size.area()];
        fill_polygon(&outline, size, &mut sharp);
        let mut scratch = sharp.clone();
        let mut samples = Vec::with_capacity(LAYERS * size.area());
        for layer in 0..LAYERS {
            let mut plane = sharp.clone();
            let sigma = FIRST_BLUR * BLUR_RATIO.powi(layer as i32) * PER_PLATE as f32;
            // Coverage is already a mean over a sample's area, and the fit interpolates: this
            // accounts for variances of 1/12 and 1/6.
            let variance = sigma * sigma - 0.25;
            blur(&mut plane, size, variance.sqrt(), &mut scratch);
            samples.extend_from_slice(&plane);
        }
        let pattern = Pattern::of(|[u, v]| {
            let sample = |c: f32| (c * PER_PLATE as f32 + middle).round() as usize;
            let i = (PATTERN_LAYER * SIDE + sample(v)) * SIDE + sample(u);
            Some(-samples[i])
        });
        // `None` cannot occur: a marker covers part of its plate.
        let pattern = pattern.unwrap_or(Pattern([0.0; POINTS * POINTS]));
        Self { samples, pattern }
    }

    pub(crate) fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    pub(crate) fn layers(&self) -> Layers<'_> {
        Layers {
            samples: &self.samples,
            side: SIDE,
            per_plate: PER_PLATE as f32,
            first_blur: FIRST_BLUR,
            blur_ratio: BLUR_RATIO,
        }
    }
}
