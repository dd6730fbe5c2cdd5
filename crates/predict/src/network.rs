//! The neural network of section 3.1.2: one hidden layer of tanh units, trained by backpropagation.
//!
//! Plain numbers in, two numbers out; what they mean is the business of `learner`. Output weights start at zero, so
//! an untrained network says (0, 0); hidden weights start from a fixed hash, the same for every track. Inputs may
//! be zero for want of samples: a weight of a zero input is not trained, so the network grows with its inputs.
//!
//! Cost of `forward` or `train`: about 2 or 6 times [`INPUTS`] x [`HIDDEN`] multiplications, and [`HIDDEN`] tanh.

use libm::{sqrtf, tanhf};

/// Inputs: x and y of the last six steps.
pub(crate) const INPUTS: usize = 12;
/// Units of the hidden layer.
const HIDDEN: usize = 8;
/// Fraction of the gradient followed by one training step.
const RATE: f32 = 0.05;
/// Error beyond which a sample pulls no harder (Huber's loss): one wild step must not tear the weights away.
const MAX_PULL: f32 = 0.5;
/// No weight leaves ±this.
const MAX_WEIGHT: f32 = 8.0;
/// Fraction of every output weight forgotten in a training step, so that a habit given up fades.
const DECAY: f32 = 1e-4;

/// Weights, and in the same shape their gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Network {
    hidden_weights: [[f32; INPUTS]; HIDDEN],
    hidden_bias: [f32; HIDDEN],
    output_weights: [[f32; HIDDEN]; 2],
    output_bias: [f32; 2],
}

impl Network {
    const ZERO: Self = Self {
        hidden_weights: [[0.0; INPUTS]; HIDDEN],
        hidden_bias: [0.0; HIDDEN],
        output_weights: [[0.0; HIDDEN]; 2],
        output_bias: [0.0; 2],
    };

    /// The start: small, different hidden weights and an output of zero.
    pub(crate) const START: Self = {
        let mut network = Self::ZERO;
        let mut unit = 0;
        while unit < HIDDEN {
            let mut input = 0;
            while input < INPUTS {
                network.hidden_weights[unit][input] = start_weight(unit * INPUTS + input);
                input += 1;
            }
            unit += 1;
        }
        network
    };

    /// The network's answer.
    pub(crate) fn forward(&self, inputs: &[f32; INPUTS]) -> [f32; 2] {
        self.output(&self.activate(inputs))
    }

    /// One step of backpropagation towards `target`. Values that are not finite put the network back to its start.
    pub(crate) fn train(&mut self, inputs: &[f32; INPUTS], target: [f32; 2]) {
        let gradient = self.gradient(inputs, target);
        let mut finite = true;
        let mut descend = |weight: &mut f32, slope: f32, decay: f32| {
            *weight = (*weight * (1.0 - decay) - RATE * slope).clamp(-MAX_WEIGHT, MAX_WEIGHT);
            finite &= weight.is_finite();
        };
        for unit in 0..HIDDEN {
            for input in 0..INPUTS {
                descend(
                    &mut self.hidden_weights[unit][input],
                    gradient.hidden_weights[unit][input],
                    0.0,
                );
            }
            descend(&mut self.hidden_bias[unit], gradient.hidden_bias[unit], 0.0);
        }
        for axis in 0..2 {
            for unit in 0..HIDDEN {
                descend(
                    &mut self.output_weights[axis][unit],
                    gradient.output_weights[axis][unit],
                    DECAY,
                );
            }
            descend(
                &mut self.output_bias[axis],
                gradient.output_bias[axis],
                DECAY,
            );
        }
        if !finite {
            *self = Self::START;
        }
    }

    fn activate(&self, inputs: &[f32; INPUTS]) -> [f32; HIDDEN] {
        let mut activations = self.hidden_bias;
        for (activation, weights) in activations.iter_mut().zip(&self.hidden_weights) {
            for (weight, input) in weights.iter().zip(inputs) {
                *activation += weight * input;
            }
            *activation = tanhf(*activation);
        }
        activations
    }

    fn output(&self, activations: &[f32; HIDDEN]) -> [f32; 2] {
        let mut output = self.output_bias;
        for (value, weights) in output.iter_mut().zip(&self.output_weights) {
            for (weight, activation) in weights.iter().zip(activations) {
                *value += weight * activation;
            }
        }
        output
    }

    /// Gradient of Huber's loss of (answer - target) by every weight.
    fn gradient(&self, inputs: &[f32; INPUTS], target: [f32; 2]) -> Self {
        let activations = self.activate(inputs);
        let output = self.output(&activations);
        let mut error = [output[0] - target[0], output[1] - target[1]];
        let size = sqrtf(error[0] * error[0] + error[1] * error[1]);
        if size > MAX_PULL {
            error = error.map(|component| component * (MAX_PULL / size));
        }
        let mut gradient = Self::ZERO;
        gradient.output_bias = error;
        for (unit, activation) in activations.iter().enumerate() {
            let mut back = 0.0;
            for (axis, component) in error.iter().enumerate() {
                gradient.output_weights[axis][unit] = component * activation;
                back += component * self.output_weights[axis][unit];
            }
            let slope = back * (1.0 - activation * activation);
            gradient.hidden_bias[unit] = slope;
            for (weight, input) in gradient.hidden_weights[unit].iter_mut().zip(inputs) {
                *weight = slope * input;
            }
        }
        gradient
    }
}

/// The `index`-th start weight, evenly spread over ±1/√(INPUTS/4): Knuth's multiplicative hash with a final mix of
/// the upper bits.
const fn start_weight(index: usize) -> f32 {
    let mut hash = (index as u32 + 1).wrapping_mul(2_654_435_761);
    hash ^= hash >> 15;
    hash = hash.wrapping_mul(2_246_822_519);
    hash ^= hash >> 13;
    let unit = (hash >> 8) as f32 / (1 << 24) as f32;
    (2.0 * unit - 1.0) * 0.577
}

#[cfg(test)]
mod tests {
    use super::*;

    const INPUT: [f32; INPUTS] = [1.0, 0.1, 0.9, -0.2, 1.1, 0.3, 0.7, -0.1, 1.0, 0.0, 0.8, 0.2];

    /// Huber's loss, whose gradient `gradient` claims to be.
    fn loss(network: &Network, target: [f32; 2]) -> f64 {
        let output = network.forward(&INPUT);
        let size = libm::hypot(
            f64::from(output[0] - target[0]),
            f64::from(output[1] - target[1]),
        );
        let bend = f64::from(MAX_PULL);
        if size <= bend {
            0.5 * size * size
        } else {
            bend * (size - 0.5 * bend)
        }
    }

    /// Some network whose every weight matters.
    fn trained() -> Network {
        let mut network = Network::START;
        for _ in 0..30 {
            network.train(&INPUT, [0.6, -0.4]);
        }
        network
    }

    #[test]
    fn starts_by_saying_nothing() {
        assert_eq!(Network::START.forward(&INPUT), [0.0, 0.0]);
        let weights = Network::START.hidden_weights.as_flattened();
        let mean = weights.iter().sum::<f32>() / weights.len() as f32;
        assert!(mean.abs() < 0.1, "mean {mean}");
        assert!(weights.iter().any(|w| *w > 0.4) && weights.iter().any(|w| *w < -0.4));
    }

    #[test]
    fn gradient_is_the_difference_quotient() {
        // The second target lies in the straight part of the loss.
        for target in [[0.3, 0.2], [-4.0, 3.0]] {
            let network = trained();
            let gradient = network.gradient(&INPUT, target);
            let check = |name: &str, analytic: f32, change: &dyn Fn(&mut Network, f32)| {
                let h = 1e-2;
                let (mut above, mut below) = (network, network);
                change(&mut above, h);
                change(&mut below, -h);
                let numeric = (loss(&above, target) - loss(&below, target)) / f64::from(2.0 * h);
                let difference = (numeric - f64::from(analytic)).abs();
                assert!(difference < 2e-4, "{name}: {analytic} against {numeric}");
            };
            for unit in 0..HIDDEN {
                check("hidden bias", gradient.hidden_bias[unit], &|n, h| {
                    n.hidden_bias[unit] += h;
                });
                for input in 0..INPUTS {
                    let analytic = gradient.hidden_weights[unit][input];
                    check("hidden weight", analytic, &|n, h| {
                        n.hidden_weights[unit][input] += h;
                    });
                }
                for axis in 0..2 {
                    let analytic = gradient.output_weights[axis][unit];
                    check("output weight", analytic, &|n, h| {
                        n.output_weights[axis][unit] += h;
                    });
                }
            }
            for axis in 0..2 {
                check("output bias", gradient.output_bias[axis], &|n, h| {
                    n.output_bias[axis] += h;
                });
            }
        }
    }

    #[test]
    fn learns_a_curve() {
        let mut network = Network::START;
        let sample = |i: usize| {
            let x = (i % 21) as f32 / 10.0 - 1.0;
            let mut inputs = [0.0; INPUTS];
            inputs[0] = x;
            (inputs, [0.4 * x * x, -0.3 * x])
        };
        for i in 0..20_000 {
            let (inputs, target) = sample(i * 8);
            network.train(&inputs, target);
        }
        for i in 0..21 {
            let (inputs, target) = sample(i);
            let output = network.forward(&inputs);
            assert!(
                (output[0] - target[0]).abs() < 0.1 && (output[1] - target[1]).abs() < 0.1,
                "{output:?} for {target:?}"
            );
        }
    }

    #[test]
    fn starts_again_when_a_number_is_not_finite() {
        for bad in [f32::NAN, f32::INFINITY] {
            let mut network = trained();
            network.train(&INPUT, [bad, 0.0]);
            assert_eq!(network, Network::START);
            let mut network = trained();
            network.train(&[bad; INPUTS], [0.0; 2]);
            assert_eq!(network, Network::START);
        }
    }
}
