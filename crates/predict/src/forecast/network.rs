//! The neural network of section 3.1.2: one hidden layer of tanh units, trained by backpropagation.
//!
//! Plain numbers in, plain numbers out; what they mean is the business of `inputs` and `mixture`. It starts from weights
//! that were made beforehand from generated motions, and every step of training pulls it back towards them, so that a
//! track which has nothing to teach does not drift, and no weight can leave for ever. An input that is still zero trains
//! none of its weights, so the network grows with its inputs.
//!
//! Cost: `forward` [`WEIGHTS`] multiplications and [`HIDDEN`] tanh, a step of training twice that.

use libm::{sqrtf, tanhf};

use crate::layout::{EXPERTS, HIDDEN, HIDDEN_WEIGHTS, INPUTS, OUTPUTS, ROW, WEIGHTS};

/// Steps of a stored start weight in one unit.
pub const STORED_PER_UNIT: f32 = 1024.0;

/// Weights, or in the same shape their gradient.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// By input: its weight for every hidden unit; the units' biases; by hidden unit: its weight for every output; the outputs'
    /// biases. So ordered, all sums are of rows, which a processor adds several numbers at a time, always in the same order.
    pub weights: [f32; WEIGHTS],
}

/// What the network says, and what backpropagation needs of how it came to it.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    hidden: [f32; HIDDEN],
    /// The network's outputs.
    pub outputs: [f32; OUTPUTS],
}

/// How a step of training goes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Descent {
    /// Part of the gradient that is followed.
    pub(crate) rate: f32,
    /// Length beyond which a gradient is shortened: one wild sample must not tear the weights away.
    pub(crate) most: f32,
}

impl Answer {
    /// Of no network.
    pub(crate) const NONE: Self = Self {
        hidden: [0.0; HIDDEN],
        outputs: [0.0; OUTPUTS],
    };
}

static START: Network = Network::START;

impl Network {
    /// The start weights.
    pub const START: Self = Self {
        weights: stored(include_bytes!("start_weights.bin")),
    };

    /// The network's answer.
    #[must_use]
    pub fn forward(&self, inputs: &[f32; INPUTS]) -> Answer {
        let (first, second) = self.weights.split_at(HIDDEN_WEIGHTS);
        let hidden = layer::<HIDDEN>(first, inputs).map(tanhf);
        let outputs = layer(second, &hidden);
        Answer { hidden, outputs }
    }

    /// One step of backpropagation, given the derivatives of a loss by the outputs. Weights that are not finite
    /// put the network back to its start.
    pub(crate) fn train(
        &mut self,
        inputs: &[f32; INPUTS],
        answer: &Answer,
        by_outputs: &[f32; OUTPUTS],
        descent: Descent,
    ) {
        let by_hidden = self.by_hidden(answer, by_outputs);
        // The gradient's entries are products, so its length is made of those of the factors.
        let length = sqrtf(
            squared(by_outputs) * (1.0 + squared(&answer.hidden))
                + squared(&by_hidden) * (1.0 + squared(inputs)),
        );
        let rate = descent.rate * (descent.most / length).min(1.0);
        let (first, second) = self.weights.split_at_mut(HIDDEN_WEIGHTS);
        add_products(first, -rate, inputs, &by_hidden);
        add_products(second, -rate, &answer.hidden, by_outputs);
        if !length.is_finite() {
            *self = Self::START;
        }
    }

    /// Goes a part of the way back to the start weights.
    pub(crate) fn pull_back(&mut self, part: f32) {
        for (weight, start) in self.weights.iter_mut().zip(&START.weights) {
            *weight -= part * (*weight - start);
        }
    }

    /// Derivatives by what goes into each hidden unit.
    fn by_hidden(&self, answer: &Answer, by_outputs: &[f32; OUTPUTS]) -> [f32; HIDDEN] {
        let mut by_hidden = [0.0; HIDDEN];
        let rows = self.weights[HIDDEN_WEIGHTS..].chunks_exact(OUTPUTS);
        for ((by_unit, unit), row) in by_hidden.iter_mut().zip(&answer.hidden).zip(rows) {
            *by_unit = dot(row, by_outputs) * (1.0 - unit * unit);
        }
        by_hidden
    }

    /// The bias of an output.
    pub fn output_bias(&mut self, output: usize) -> &mut f32 {
        &mut self.weights[HIDDEN_WEIGHTS + HIDDEN * OUTPUTS + output]
    }

    /// Adds to `gradient` that of a loss whose derivatives by the outputs are given.
    pub fn add_gradient(
        &self,
        inputs: &[f32; INPUTS],
        answer: &Answer,
        by_outputs: &[f32; OUTPUTS],
        gradient: &mut Self,
    ) {
        let by_hidden = self.by_hidden(answer, by_outputs);
        let (first, second) = gradient.weights.split_at_mut(HIDDEN_WEIGHTS);
        add_products(first, 1.0, inputs, &by_hidden);
        add_products(second, 1.0, &answer.hidden, by_outputs);
    }

    /// Whether a weight is to be held small: all but what is said of sharpness and ellipses whatever the inputs, since no measure of
    /// these is more natural than another.
    #[must_use]
    pub fn is_restrained(weight: usize) -> bool {
        let Some(output_weight) = weight.checked_sub(HIDDEN_WEIGHTS) else {
            return true;
        };
        let is_bias = output_weight / OUTPUTS == HIDDEN;
        let of_expert = output_weight % OUTPUTS % ROW < EXPERTS;
        !is_bias || of_expert
    }
}

/// What goes into every unit of a layer.
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

/// Adds to a layer's weights `factor` times each input times each unit's slope; a bias's input is 1.
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

fn squared(values: &[f32]) -> f32 {
    dot(values, values)
}

/// In eight sums that a processor can add side by side, always in the same order, so that the result is the same everywhere.
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

/// Stored weights: 16 bits each, little-endian; all zero for no bytes, from which a network of a new shape is made first.
const fn stored(bytes: &[u8]) -> [f32; WEIGHTS] {
    let mut weights = [0.0; WEIGHTS];
    if bytes.is_empty() {
        return weights;
    }
    assert!(
        bytes.len() == 2 * WEIGHTS,
        "start_weights.bin is of a network of another shape: empty the file and train anew"
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

    const DESCENT: Descent = Descent {
        rate: 0.01,
        most: 1.0,
    };

    fn inputs(seed: usize) -> [f32; INPUTS] {
        core::array::from_fn(|i| ((i * 7 + seed * 3) % 11) as f32 / 5.5 - 1.0)
    }

    /// Half the squared distance from a target, and its derivatives by the outputs.
    fn loss(answer: &Answer, target: &[f32; OUTPUTS]) -> (f64, [f32; OUTPUTS]) {
        let errors = core::array::from_fn(|i| answer.outputs[i] - target[i]);
        let sum = errors
            .iter()
            .map(|e| 0.5 * f64::from(*e) * f64::from(*e))
            .sum();
        (sum, errors)
    }

    #[test]
    fn gradient_is_the_difference_quotient() {
        let network = Network::START;
        let (inputs, target) = (inputs(1), [0.3; OUTPUTS]);
        let answer = network.forward(&inputs);
        let (_, by_outputs) = loss(&answer, &target);
        let mut gradient = Network {
            weights: [0.0; WEIGHTS],
        };
        network.add_gradient(&inputs, &answer, &by_outputs, &mut gradient);
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
    fn a_step_of_training_goes_down_the_gradient_and_no_further_than_allowed() {
        let (inputs, target) = (inputs(2), [-0.4; OUTPUTS]);
        for most in [1e9, 0.5] {
            let mut network = Network::START;
            let answer = network.forward(&inputs);
            let (before, by_outputs) = loss(&answer, &target);
            let mut gradient = Network {
                weights: [0.0; WEIGHTS],
            };
            network.add_gradient(&inputs, &answer, &by_outputs, &mut gradient);
            let length = squared(&gradient.weights).sqrt();
            let descent = Descent { rate: 1e-3, most };
            network.train(&inputs, &answer, &by_outputs, descent);
            let moved: Vec<f32> = (network.weights.iter().zip(&START.weights))
                .map(|(now, start)| now - start)
                .collect();
            let expected = 1e-3 * length.min(most);
            let moved = squared(&moved).sqrt();
            assert!((moved / expected - 1.0).abs() < 0.02, "{moved} {expected}");
            assert!(loss(&network.forward(&inputs), &target).0 < before);
        }
    }

    #[test]
    fn goes_back_to_its_start_when_there_is_nothing_to_learn() {
        let mut network = Network::START;
        for weight in &mut network.weights {
            *weight += 0.5;
        }
        for _ in 0..2000 {
            let answer = network.forward(&inputs(3));
            network.train(&inputs(3), &answer, &[0.0; OUTPUTS], DESCENT);
            network.pull_back(0.01);
        }
        for (weight, start) in network.weights.iter().zip(&START.weights) {
            assert!((weight - start).abs() < 1e-4);
        }
    }

    #[test]
    fn starts_again_when_a_number_is_not_finite() {
        for bad in [f32::NAN, f32::INFINITY] {
            let mut network = Network::START;
            let answer = network.forward(&inputs(4));
            network.train(&inputs(4), &answer, &[bad; OUTPUTS], DESCENT);
            assert_eq!(network, Network::START);
            network.train(&[bad; INPUTS], &answer, &[1.0; OUTPUTS], DESCENT);
            assert_eq!(network, Network::START);
        }
    }
}
