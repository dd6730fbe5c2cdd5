//! The shape of the neural network: the number of experts, horizons, inputs and outputs.
//!
//! All stages of a forecast share these numbers. Changing one changes the shape of the network,
//! which then needs new start weights.

/// Number of experts in the mixture.
pub const EXPERTS: usize = 13;
/// Number of horizons at which experts are scored and weighed.
pub const HORIZONS: usize = 8;
/// Number of scores per expert and horizon: running, recent, and fit to the newest position.
pub const SCORES: usize = 3;

/// Number of horizons that the network has outputs for. In between, its outputs are interpolated.
pub const ANCHORS: usize = 3;
/// Indices of the horizons that the network has outputs for.
pub(crate) const ANCHOR_AT: [usize; ANCHORS] = [0, 4, HORIZONS - 1];

/// Number of newest samples whose residuals from a line are inputs, along and across.
pub(crate) const WINDOW: usize = 8;
/// Number of inputs that describe the motion.
pub(crate) const MOTION: usize = 10;
/// Number of inputs.
pub const INPUTS: usize = EXPERTS * (ANCHORS + 1) + 2 * WINDOW + MOTION + 2 * ANCHORS + 1;
/// Number of units in the hidden layer.
pub const HIDDEN: usize = 24;
/// Outputs per anchor: one logit per expert, one sharpness per score, one ellipse scale.
pub const ROW: usize = EXPERTS + SCORES + 1;
/// Number of outputs.
pub const OUTPUTS: usize = ANCHORS * ROW;

/// Number of weights of the hidden layer, biases included.
pub(crate) const HIDDEN_WEIGHTS: usize = (INPUTS + 1) * HIDDEN;
/// Number of weights of both layers, biases included.
pub const WEIGHTS: usize = HIDDEN_WEIGHTS + (HIDDEN + 1) * OUTPUTS;

/// One value per horizon and expert.
pub type ByExpert<T> = [[T; EXPERTS]; HORIZONS];
