//! How good the forecasts are and what they cost.

mod cost;
mod motions;
mod quality;
mod recordings;
