//! The neural network of section 3.1.2: one hidden layer of tanh units, trained by backpropagation.
//!
//! This file knows only arrays of numbers. `inputs` and `mixture` give them their meaning. The
//! network starts from weights trained on generated motions. Every online training step pulls it
//! back towards them, so that it does not drift on a track that has nothing to teach, and no change
//! of a weight is permanent. An input that is still zero does not train its weights.
//!
//! Cost: `forward` takes [`WEIGHTS`] multiplications and [`HIDDEN`] tanh, a training step twice
//! that.

use libm::{sqrtf, tanhf};

use crate::layout::{EXPERTS, HIDDEN, HIDDEN_WEIGHTS, INPUTS, OUTPUTS, ROW, WEIGHTS};

/// Stored start weights are integers in units of 1 / `STORED_PER_UNIT`.
pub const STORED_PER_UNIT: f32 = 1024.0;

/// Weights, or a gradient of the same shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// By input, its weight for every hidden unit; then the biases of these units; by hidden unit,
    /// its weight for every output; then the biases of the outputs. In this order all sums run
    /// along rows, which a processor adds several numbers at a time, always in the same order.
    pub weights: [f32; WEIGHTS],
}

/// The outputs of the network, and what backpropagation needs.
#[derive(Debug, Clone, Copy)]
pub struct Activations {
    hidden: [f32; HIDDEN],
    /// Outputs of the network.
    pub outputs: [f32; OUTPUTS],
}

/// Parameters of a training step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GradientStep {
    /// Learning rate.
    pub(crate) rate: f32,
    /// Longer gradients are shortened to this norm, so that an outlier does not ruin the weights.
    pub(crate) max_norm: f32,
}

impl Activations {
    /// An empty value.
    pub(crate) const NONE: Self = Self {
        hidden: [0.0; HIDDEN],
        outputs: [0.0; OUTPUTS],
    };
}

impl Network {
    /// The start weights.
    pub const START: Self = Self {
        weights: stored(include_bytes!("start_weights.bin")),
    };

    /// Evaluates the network.
    #[must_use]
    pub fn forward(&self, inputs: &[f32; INPUTS]) -> Activations {
        let (first, second) = self.weights.split_at(HIDDEN_WEIGHTS);
        let hidden = layer::<HIDDEN>(first, inputs).map(tanhf);
        let outputs = layer(second, &hidden);
        Activations { hidden, outputs }
    }

    /// One step of backpropagation, given the derivatives of a loss by the outputs. If the gradient
    /// is not finite, the network returns to its start weights.
    pub(crate) fn train(
        &mut self,
        inputs: &[f32; INPUTS],
        activations: &Activations,
        by_outputs: &[f32; OUTPUTS],
        step: GradientStep,
    ) {
        let by_hidden = self.by_hidden(activations, by_outputs);
        // The entries of the gradient are products, so its norm follows from the norms of the
        // factors.
        let length = sqrtf(
            norm_squared(by_outputs) * (1.0 + norm_squared(&activations.hidden))
                + norm_squared(&by_hidden) * (1.0 + norm_squared(inputs)),
        );
        let rate = step.rate * (step.max_norm / length).min(1.0);
        let (first, second) = self.weights.split_at_mut(HIDDEN_WEIGHTS);
        add_products(first, -rate, inputs, &by_hidden);
        add_products(second, -rate, &activations.hidden, by_outputs);
        if !length.is_finite() {
            *self = Self::START;
        }
    }

    /// Derivatives by the sums that enter the hidden units.
    fn by_hidden(&self, activations: &Activations, by_outputs: &[f32; OUTPUTS]) -> [f32; HIDDEN] {
        let mut by_hidden = [0.0; HIDDEN];
        let rows = self.weights[HIDDEN_WEIGHTS..].chunks_exact(OUTPUTS);
        for ((by_unit, unit), row) in by_hidden.iter_mut().zip(&activations.hidden).zip(rows) {
            *by_unit = dot(row, by_outputs) * (1.0 - unit * unit);
        }
        by_hidden
    }

    /// The bias of an output.
    pub fn output_bias(&mut self, output: usize) -> &mut f32 {
        &mut self.weights[HIDDEN_WEIGHTS + HIDDEN * OUTPUTS + output]
    }

    /// Adds the gradient of a loss, given its derivatives by the outputs, to `gradient`.
    pub fn add_gradient(
        &self,
        inputs: &[f32; INPUTS],
        activations: &Activations,
        by_outputs: &[f32; OUTPUTS],
        gradient: &mut Self,
    ) {
        let by_hidden = self.by_hidden(activations, by_outputs);
        let (first, second) = gradient.weights.split_at_mut(HIDDEN_WEIGHTS);
        add_products(first, 1.0, inputs, &by_hidden);
        add_products(second, 1.0, &activations.hidden, by_outputs);
    }

    /// Whether training applies weight decay to a weight. The biases of sharpness and ellipse scale
    /// are exempt, since zero is no natural value for them.
    #[must_use]
    pub fn is_decayed(weight: usize) -> bool {
        let Some(output_weight) = weight.checked_sub(HIDDEN_WEIGHTS) else {
            return true;
        };
        let is_bias = output_weight / OUTPUTS == HIDDEN;
        let of_expert = output_weight % OUTPUTS % ROW < EXPERTS;
        !is_bias || of_expert
    }
}

/// The sums that enter the units of a layer.
fn layer<const UNITS: usize>(weights: &[f32], inputs: &[f32]) -> [f32; UNITS] {
    let (rows, biases) = weights.as_chunks::<UNITS>().0.split_at(inputs.len());
    let mut sums = biases[0];
    for (row, input) in rows.iter().zip(inputs) {
        for (sum, weight) in sums.iter_mut().zip(row) {
            *sum += input * weight;
        }
    }
    sums
}

/// Adds `factor` times input times slope to each weight of a layer. The input of a bias is 1.
fn add_products<const UNITS: usize>(
    weights: &mut [f32],
    factor: f32,
    inputs: &[f32],
    slopes: &[f32; UNITS],
) {
    let slopes = slopes.map(|slope| factor * slope);
    let rows = weights.as_chunks_mut::<UNITS>().0;
    for (row, input) in rows.iter_mut().zip(inputs.iter().chain(&[1.0])) {
        for (weight, slope) in row.iter_mut().zip(&slopes) {
            *weight += input * slope;
        }
    }
}

fn norm_squared(values: &[f32]) -> f32 {
    dot(values, values)
}

/// Dot product in eight partial sums, which a processor can add in parallel, always in the same
/// order, so that the result is the same everywhere.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 8];
    let (a, b) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest = a.remainder().iter().zip(b.remainder());
    let rest: f32 = rest.map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f32>() + rest
}

/// Decodes stored weights: 16 bits each, little-endian. Without bytes all weights are zero, which
/// is where a network of a new shape starts.
const fn stored(bytes: &[u8]) -> [f32; WEIGHTS] {
    let mut weights = [0.0; WEIGHTS];
    if bytes.is_empty() {
        return weights;
    }
    assert!(
        bytes.len() == 2 * WEIGHTS,
        "start_weights.bin does not fit the shape of the network: empty the file and train again"
    );
    let mut i = 0;
    while i < WEIGHTS {
        let steps = i16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]]);
        weights[i] = steps as f32 / STORED_PER_UNIT;
        i += 1;
    }
    weights
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    const GRADIENT_STEP: GradientStep = GradientStep {
        rate: 0.01,
        max_norm: 1.0,
    };

    fn inputs(seed: usize) -> [f32; INPUTS] {
        core::array::from_fn(|i| ((i * 7 + seed * 3) % 11) as f32 / 5.5 - 1.0)
    }

    /// Half the squared distance from a target, and its derivatives by the outputs.
    fn loss(activations: &Activations, target: &[f32; OUTPUTS]) -> (f64, [f32; OUTPUTS]) {
        let errors = core::array::from_fn(|i| activations.outputs[i] - target[i]);
        let sum = errors
            .iter()
            .map(|e| 0.5 * f64::from(*e) * f64::from(*e))
            .sum();
        (sum, errors)
    }

    #[test]
    fn gradient_equals_difference_quotient() {
        let network = Network::START;
        let (inputs, target) = (inputs(1), [0.3; OUTPUTS]);
        let activations = network.forward(&inputs);
        let (_, by_outputs) = loss(&activations, &target);
        let mut gradient = Network {
            weights: [0.0; WEIGHTS],
        };
        network.add_gradient(&inputs, &activations, &by_outputs, &mut gradient);
        for weight in (0..WEIGHTS).step_by(37) {
            let at = |by: f32| {
                let mut changed = network.clone();
                changed.weights[weight] += by;
                loss(&changed.forward(&inputs), &target).0
            };
            let numeric = (at(0.01) - at(-0.01)) / 0.02;
            let analytic = f64::from(gradient.weights[weight]);
            assert!(
                (numeric - analytic).abs() < 1e-2 * (1.0 + analytic.abs()),
                "{weight}: {numeric} {analytic}"
            );
        }
    }

    #[test]
    fn training_descends_the_gradient_within_the_maximum_norm() {
        let (inputs, target) = (inputs(2), [-0.4; OUTPUTS]);
        for max_norm in [1e9, 0.5] {
            let mut network = Network::START;
            let activations = network.forward(&inputs);
            let (before, by_outputs) = loss(&activations, &target);
            let mut gradient = Network {
                weights: [0.0; WEIGHTS],
            };
            network.add_gradient(&inputs, &activations, &by_outputs, &mut gradient);
            let length = norm_squared(&gradient.weights).sqrt();
            let step = GradientStep {
                rate: 1e-3,
                max_norm,
            };
            network.train(&inputs, &activations, &by_outputs, step);
            let change: Vec<f32> = (network.weights.iter().zip(&Network::START.weights))
                .map(|(now, start)| now - start)
                .collect();
            let expected = 1e-3 * length.min(max_norm);
            let change = norm_squared(&change).sqrt();
            assert!(
                (change / expected - 1.0).abs() < 0.02,
                "{change} {expected}"
            );
            assert!(loss(&network.forward(&inputs), &target).0 < before);
        }
    }

    #[test]
    fn resets_when_a_gradient_is_not_finite() {
        for bad in [f32::NAN, f32::INFINITY] {
            let mut network = Network::START;
            let activations = network.forward(&inputs(4));
            network.train(&inputs(4), &activations, &[bad; OUTPUTS], GRADIENT_STEP);
            assert_eq!(network, Network::START);
            network.train(&[bad; INPUTS], &activations, &[1.0; OUTPUTS], GRADIENT_STEP);
            assert_eq!(network, Network::START);
        }
    }
}
