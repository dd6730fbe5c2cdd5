//! Where forecasts are made and judged: motions with known truth, the classical predictors, scores, and the training of
//! the start weights that `predict` ships.
#![forbid(unsafe_code)]

pub mod classical;
pub mod motions;
pub mod random;
pub mod scores;
pub mod table;
pub mod training;
