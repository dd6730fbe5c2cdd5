//! Layout of the neural network: how many experts, horizons, inputs and outputs it has.
//!
//! These numbers tie the stages of a forecast together. Changing one changes the shape of the network, which then needs
//! new start weights.

/// Forecasts that are mixed.
pub const EXPERTS: usize = 13;
/// Moments ahead at which forecasts are scored and weighed.
pub const HORIZONS: usize = 8;
/// Scores of an expert at a horizon: running, recent, and fit to the newest place.
pub const MARKS: usize = 3;

/// Horizons that the network has outputs for. Its outputs are interpolated between them.
pub const ANCHORS: usize = 3;
/// Indices of these horizons.
pub(crate) const ANCHOR_AT: [usize; ANCHORS] = [0, 4, HORIZONS - 1];

/// Newest samples whose residuals about a line are inputs, along and across.
pub(crate) const WINDOW: usize = 8;
/// Inputs that describe the motion.
pub(crate) const MOTION: usize = 10;
/// Inputs of the network.
pub const INPUTS: usize = EXPERTS * (ANCHORS + 1) + 2 * WINDOW + MOTION + 2 * ANCHORS + 1;
/// Units of the hidden layer.
pub const HIDDEN: usize = 24;
/// Outputs per anchor: one logit per expert, one sharpness per score, one scale of the ellipse.
pub const ROW: usize = EXPERTS + MARKS + 1;
/// Outputs of the network.
pub const OUTPUTS: usize = ANCHORS * ROW;

/// Weights of the hidden layer, biases included.
pub(crate) const HIDDEN_WEIGHTS: usize = (INPUTS + 1) * HIDDEN;
/// Weights of both layers.
pub const WEIGHTS: usize = HIDDEN_WEIGHTS + (HIDDEN + 1) * OUTPUTS;

/// One value per horizon and expert.
pub type ByExpert<T> = [[T; EXPERTS]; HORIZONS];
