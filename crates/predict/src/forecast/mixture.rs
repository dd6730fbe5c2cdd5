//! From what is known of a track to the share of every expert in its forecast (Jacobs and others, "Adaptive mixtures of
//! local experts").
//!
//! ```text
//! share(expert, horizon) = softmax over the experts of
//!     said(expert, anchor) - sum over the marks of sharpness(mark, anchor) * mark(expert, horizon)
//! ```
//!
//! The marks say how well each expert has done on this track; the network sees them too, beside the motion itself, and says how
//! much they mean and what else speaks for each expert. It answers for three anchors, the first, a middle and the last horizon; in
//! between its answers are interpolated. With them it gives the logarithm of the scale by which the ellipse of past errors
//! should be larger or smaller at the moment.

use libm::expf;

use crate::forecast::network::{Answer, Network};
use crate::layout::{ANCHOR_AT, ANCHORS, ByExpert, EXPERTS, HORIZONS, INPUTS, MARKS, OUTPUTS, ROW};

/// Most that the network may say for or against an expert: it can be overruled by the marks.
const MOST_SAID: f32 = 5.0;
/// Range of the logarithm of a sharpness.
const SHARPNESS: core::ops::Range<f32> = -4.0..2.0;
/// Largest mark that counts: far enough to leave nothing of an expert that is wrong where another is exact.
const MOST_MARK: f32 = 40.0;

/// Logarithm of a share, over the largest, below which it is none: a ten-thousandth.
const LEAST_LOGIT: f32 = -9.2;

/// What is known of a track.
#[derive(Debug, Clone, Copy)]
pub struct Evidence {
    /// What the network is told.
    pub inputs: [f32; INPUTS],
    /// The experts' marks, 0 for a good one.
    pub marks: ByExpert<[f32; MARKS]>,
}

/// What follows from it.
#[derive(Debug, Clone, Copy)]
pub struct Shares {
    /// The network's answer, for backpropagation.
    pub answer: Answer,
    /// The shares of a horizon add to 1.
    pub shares: ByExpert<f32>,
    /// Logarithm of the ellipse's scale by horizon.
    pub spread: [f32; HORIZONS],
}

/// The share of every expert.
#[must_use]
pub fn weigh(network: &Network, evidence: &Evidence) -> Shares {
    let answer = network.forward(&evidence.inputs);
    let mut anchored = answer.outputs;
    for row in anchored.chunks_exact_mut(ROW) {
        let (said, rest) = row.split_at_mut(EXPERTS);
        for said in said {
            *said /= 1.0 + said.abs() / MOST_SAID;
        }
        for sharpness in &mut rest[..MARKS] {
            *sharpness = expf(sharpness.clamp(SHARPNESS.start, SHARPNESS.end));
        }
    }
    let mut shares = Shares {
        answer,
        shares: [[0.0; EXPERTS]; HORIZONS],
        spread: [0.0; HORIZONS],
    };
    for (horizon, marks) in evidence.marks.iter().enumerate() {
        let mut row = [0.0; ROW];
        for (weight, anchored) in anchor_weights(horizon)
            .iter()
            .zip(anchored.chunks_exact(ROW))
        {
            for (value, anchored) in row.iter_mut().zip(anchored) {
                *value += weight * anchored;
            }
        }
        let (said, rest) = row.split_at(EXPERTS);
        let logits = &mut shares.shares[horizon];
        for ((logit, said), marks) in logits.iter_mut().zip(said).zip(marks) {
            *logit = *said;
            for (sharpness, mark) in rest.iter().zip(marks) {
                *logit -= sharpness * mark.min(MOST_MARK);
            }
        }
        softmax(logits);
        shares.spread[horizon] = rest[MARKS];
    }
    shares
}

/// Adds to `by_outputs`, the derivatives of a loss by the network's outputs, what follows from those by the logits of one
/// horizon through what the network said of the experts.
pub fn back_to_said(
    answer: &Answer,
    horizon: usize,
    by_logits: &[f32; EXPERTS],
    by_outputs: &mut [f32; OUTPUTS],
) {
    for ((weight, outputs), by) in rows(answer, horizon, by_outputs) {
        for ((by, output), by_logit) in by.iter_mut().zip(outputs).zip(by_logits) {
            let slope = 1.0 / (1.0 + output.abs() / MOST_SAID);
            *by += weight * by_logit * slope * slope;
        }
    }
}

/// The same through sharpness and spread, which are trained beforehand only.
pub fn back_to_sharpness(
    evidence: &Evidence,
    answer: &Answer,
    horizon: usize,
    by_logits: &[f32; EXPERTS],
    by_spread: f32,
    by_outputs: &mut [f32; OUTPUTS],
) {
    let mut by_sharpness = [0.0; MARKS];
    for (by_logit, marks) in by_logits.iter().zip(&evidence.marks[horizon]) {
        for (by, mark) in by_sharpness.iter_mut().zip(marks) {
            *by -= by_logit * mark.min(MOST_MARK);
        }
    }
    for ((weight, outputs), by) in rows(answer, horizon, by_outputs) {
        for (i, by_sharpness) in by_sharpness.iter().enumerate() {
            let output = outputs[EXPERTS + i];
            if SHARPNESS.contains(&output) {
                by[EXPERTS + i] += weight * by_sharpness * expf(output);
            }
        }
        by[EXPERTS + MARKS] += weight * by_spread;
    }
}

/// The anchors that count at a horizon: their weight, outputs, and derivatives by these.
fn rows<'a>(
    answer: &'a Answer,
    horizon: usize,
    by_outputs: &'a mut [f32; OUTPUTS],
) -> impl Iterator<Item = ((f32, &'a [f32]), &'a mut [f32])> {
    anchor_weights(horizon)
        .into_iter()
        .zip(answer.outputs.chunks_exact(ROW))
        .zip(by_outputs.chunks_exact_mut(ROW))
        .filter(|((weight, _), _)| *weight > 0.0)
}

/// Weight of each anchor at a horizon.
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

/// Logits become shares.
fn softmax(logits: &mut [f32; EXPERTS]) {
    let most = logits.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b));
    let mut sum = 0.0;
    for logit in logits.iter_mut() {
        *logit = match *logit - most {
            // Nothing, so that nobody has to work out where such an expert sees the object.
            below if below < LEAST_LOGIT => 0.0,
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

    fn evidence(marks: impl Fn(usize) -> f32) -> Evidence {
        let mut evidence = Evidence {
            inputs: [0.1; INPUTS],
            marks: [[[0.0; MARKS]; EXPERTS]; HORIZONS],
        };
        for row in &mut evidence.marks {
            for (expert, kept) in row.iter_mut().enumerate() {
                *kept = [marks(expert); MARKS];
            }
        }
        evidence
    }

    #[test]
    fn anchors_are_met_exactly_and_interpolated() {
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
    fn an_expert_that_is_wrong_where_another_is_exact_has_nothing() {
        let shares = weigh(
            &Network::START,
            &evidence(|e| if e == 8 { 0.0 } else { 30.0 }),
        );
        for row in &shares.shares {
            assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            assert!(row[8] > 0.999, "{row:?}");
        }
    }

    #[test]
    fn derivatives_are_difference_quotients() {
        let evidence = evidence(|e| 0.2 * e as f32);
        // Of ln(share of expert 3 at horizon 2) by the logits: 1 - share, or -share.
        let horizon = 2;
        let loss = |network: &Network| f64::from(weigh(network, &evidence).shares[horizon][3]).ln();
        let network = Network::START;
        let shares = weigh(&network, &evidence);
        let mut by_logits = shares.shares[horizon].map(|share| -share);
        by_logits[3] += 1.0;
        let mut by_outputs = [0.0; OUTPUTS];
        back_to_said(&shares.answer, horizon, &by_logits, &mut by_outputs);
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
