//! Develops and evaluates forecasts: motions with known truth, baseline predictors, scores, and the
//! training of the start weights that `predict` ships.
#![forbid(unsafe_code)]

pub mod classical;
pub mod examples;
pub mod motions;
pub mod paper;
pub mod random;
pub mod scores;
pub mod table;
pub mod training;
