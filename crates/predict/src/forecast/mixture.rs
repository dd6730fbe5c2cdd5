//! The share of every expert in the forecast (Jacobs and others, "Adaptive mixtures of local
//! experts").
//!
//! ```text
//! share(expert, horizon) = softmax over the experts of
//!     logit(expert, anchor)
//!     - sum over the scores of sharpness(score, anchor) * score(expert, horizon)
//! ```
//!
//! The scores measure how well each expert has done on this track. The network sees them too,
//! together with features of the motion. Its outputs are a logit per expert and the sharpness of
//! each score. It has outputs for three anchors, the first, a middle and the last horizon; in
//! between they are interpolated. It also predicts the log scale of the error ellipse.

use libm::expf;

use crate::forecast::network::{Activations, Network};
use crate::layout::{
    ANCHOR_AT, ANCHORS, ByExpert, EXPERTS, HORIZONS, INPUTS, OUTPUTS, ROW, SCORES,
};

/// Maximum magnitude of a logit of the network, so that scores can overrule it.
const MAX_LOGIT: f32 = 5.0;
/// Range of the log of a sharpness.
const SHARPNESS: core::ops::Range<f32> = -4.0..2.0;
/// Maximum score: large enough to exclude an expert that is wrong where another is exact.
const MAX_SCORE: f32 = 40.0;

/// Log of a share relative to the largest one, below which it becomes 0: a ten-thousandth.
const MIN_LOG_SHARE: f32 = -9.2;

/// What the shares are computed from.
#[derive(Debug, Clone, Copy)]
pub struct Evidence {
    /// Inputs of the network.
    pub inputs: [f32; INPUTS],
    /// Scores of the experts, 0 for a good one.
    pub scores: ByExpert<[f32; SCORES]>,
}

/// Output of the mixture.
#[derive(Debug, Clone, Copy)]
pub struct Shares {
    /// Activations of the network, for backpropagation.
    pub activations: Activations,
    /// The shares at each horizon add up to 1.
    pub shares: ByExpert<f32>,
    /// Log scale of the ellipse by horizon.
    pub log_scale: [f32; HORIZONS],
}

/// Computes the share of every expert.
#[must_use]
pub fn gate(network: &Network, evidence: &Evidence) -> Shares {
    let activations = network.forward(&evidence.inputs);
    let mut anchored = activations.outputs;
    for row in anchored.chunks_exact_mut(ROW) {
        let (logits, rest) = row.split_at_mut(EXPERTS);
        for logit in logits {
            *logit /= 1.0 + logit.abs() / MAX_LOGIT;
        }
        for sharpness in &mut rest[..SCORES] {
            *sharpness = expf(sharpness.clamp(SHARPNESS.start, SHARPNESS.end));
        }
    }
    let mut shares = Shares {
        activations,
        shares: [[0.0; EXPERTS]; HORIZONS],
        log_scale: [0.0; HORIZONS],
    };
    for (horizon, scores) in evidence.scores.iter().enumerate() {
        let mut row = [0.0; ROW];
        for (weight, anchored) in anchor_weights(horizon)
            .iter()
            .zip(anchored.chunks_exact(ROW))
        {
            for (value, anchored) in row.iter_mut().zip(anchored) {
                *value += weight * anchored;
            }
        }
        let (network_logits, rest) = row.split_at(EXPERTS);
        let logits = &mut shares.shares[horizon];
        for ((logit, network_logit), scores) in logits.iter_mut().zip(network_logits).zip(scores) {
            *logit = *network_logit;
            for (sharpness, score) in rest.iter().zip(scores) {
                *logit -= sharpness * score.min(MAX_SCORE);
            }
        }
        softmax(logits);
        shares.log_scale[horizon] = rest[SCORES];
    }
    shares
}

/// Propagates derivatives of a loss by the logits of one horizon back to the network's outputs for
/// the experts, and adds them to `by_outputs`.
pub fn back_to_logits(
    activations: &Activations,
    horizon: usize,
    by_logits: &[f32; EXPERTS],
    by_outputs: &mut [f32; OUTPUTS],
) {
    for ((weight, outputs), by) in rows(activations, horizon, by_outputs) {
        for ((by, output), by_logit) in by.iter_mut().zip(outputs).zip(by_logits) {
            let slope = 1.0 / (1.0 + output.abs() / MAX_LOGIT);
            *by += weight * by_logit * slope * slope;
        }
    }
}

/// The same for the outputs for sharpness and ellipse scale, which are not trained online.
pub fn back_to_sharpness(
    evidence: &Evidence,
    activations: &Activations,
    horizon: usize,
    by_logits: &[f32; EXPERTS],
    by_log_scale: f32,
    by_outputs: &mut [f32; OUTPUTS],
) {
    let mut by_sharpness = [0.0; SCORES];
    for (by_logit, scores) in by_logits.iter().zip(&evidence.scores[horizon]) {
        for (by, score) in by_sharpness.iter_mut().zip(scores) {
            *by -= by_logit * score.min(MAX_SCORE);
        }
    }
    for ((weight, outputs), by) in rows(activations, horizon, by_outputs) {
        for (i, by_sharpness) in by_sharpness.iter().enumerate() {
            let output = outputs[EXPERTS + i];
            if SHARPNESS.contains(&output) {
                by[EXPERTS + i] += weight * by_sharpness * expf(output);
            }
        }
        by[EXPERTS + SCORES] += weight * by_log_scale;
    }
}

/// Anchors with a non-zero weight at a horizon: weight, outputs, and derivatives by the outputs.
fn rows<'a>(
    activations: &'a Activations,
    horizon: usize,
    by_outputs: &'a mut [f32; OUTPUTS],
) -> impl Iterator<Item = ((f32, &'a [f32]), &'a mut [f32])> {
    anchor_weights(horizon)
        .into_iter()
        .zip(activations.outputs.chunks_exact(ROW))
        .zip(by_outputs.chunks_exact_mut(ROW))
        .filter(|((weight, _), _)| *weight > 0.0)
}

/// Interpolation weight of each anchor at a horizon.
fn anchor_weights(horizon: usize) -> [f32; ANCHORS] {
    let mut weights = [0.0; ANCHORS];
    let after = ANCHOR_AT[1..ANCHORS - 1]
        .iter()
        .take_while(|at| **at <= horizon)
        .count();
    let (from, to) = (ANCHOR_AT[after], ANCHOR_AT[after + 1]);
    let part = (horizon - from) as f32 / (to - from) as f32;
    weights[after] = 1.0 - part;
    weights[after + 1] = part;
    weights
}

/// Turns logits into shares.
fn softmax(logits: &mut [f32; EXPERTS]) {
    let max = logits.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b));
    let mut sum = 0.0;
    for logit in logits.iter_mut() {
        *logit = match *logit - max {
            // Exactly 0, so that this expert need not be evaluated.
            below if below < MIN_LOG_SHARE => 0.0,
            below => expf(below),
        };
        sum += *logit;
    }
    for share in logits {
        *share /= sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evidence(scores: impl Fn(usize) -> f32) -> Evidence {
        let mut evidence = Evidence {
            inputs: [0.1; INPUTS],
            scores: [[[0.0; SCORES]; EXPERTS]; HORIZONS],
        };
        for row in &mut evidence.scores {
            for (expert, kept) in row.iter_mut().enumerate() {
                *kept = [scores(expert); SCORES];
            }
        }
        evidence
    }

    #[test]
    fn anchor_weights_are_exact_at_anchors() {
        for (anchor, at) in ANCHOR_AT.into_iter().enumerate() {
            let weights = anchor_weights(at);
            assert_eq!(weights[anchor], 1.0, "{weights:?}");
        }
        for horizon in 0..HORIZONS {
            let sum: f32 = anchor_weights(horizon).iter().sum();
            assert!((sum - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_bad_expert_has_no_share_beside_an_exact_one() {
        let shares = gate(
            &Network::START,
            &evidence(|e| if e == 8 { 0.0 } else { 30.0 }),
        );
        for row in &shares.shares {
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            assert!(row[8] > 0.999, "{row:?}");
        }
    }

    #[test]
    fn derivatives_equal_difference_quotients() {
        let evidence = evidence(|e| 0.2 * e as f32);
        // Derivative of ln(share of expert 3 at horizon 2) by the logits: 1 - share, or -share.
        let horizon = 2;
        let loss = |network: &Network| f64::from(gate(network, &evidence).shares[horizon][3]).ln();
        let network = Network::START;
        let shares = gate(&network, &evidence);
        let mut by_logits = shares.shares[horizon].map(|share| -share);
        by_logits[3] += 1.0;
        let mut by_outputs = [0.0; OUTPUTS];
        back_to_logits(&shares.activations, horizon, &by_logits, &mut by_outputs);
        for output in 0..EXPERTS {
            let changed = |by: f32| {
                let mut network = network.clone();
                *network.output_bias(output) += by;
                loss(&network)
            };
            let numeric = (changed(0.02) - changed(-0.02)) / 0.04;
            let difference = (numeric - f64::from(by_outputs[output])).abs();
            assert!(difference < 1e-3, "{output}: {numeric} {by_outputs:?}");
        }
    }
}
