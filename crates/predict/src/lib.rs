//! Positions in, tracks and forecasts out (section 3 of Engedy and Horváth, "Global, camera-based localization and
//! prediction of future positions in mobile robot navigation"; below: the paper).
//!
//! Once a frame, [`Tracker::update`] takes what was seen on the floor and decides which known object each sighting
//! is, where the unseen ones are by now, and where all of them will be during the next [`MAX_FORECAST`] frame
//! periods:
//!
//! 1. `tracker`: identities. Every track is forecast to the frame's own time stamp, sightings are assigned to
//!    tracks, a missing sighting is replaced by the forecast for a while, new things start tracks (section 3.1.1).
//! 2. `assign`: which sighting belongs to which track, nearest pair first, each used once.
//! 3. `merge`: which observations are of several objects that touch, and where in it each of them is.
//! 4. `track`: what is known of one object; `history` and `heading` hold its samples.
//! 5. `forecast`: three models look ahead and are mixed by how well each has done on this very track. `motion` has
//!    the two classical ones, a straight line and a constant turn; `learner` the third, whose small neural
//!    `network` is trained on line by backpropagation (section 3.1.2); `score` keeps the marks and the covariance.
//!
//! # Units
//!
//! Lengths are in whatever unit the observations use, pixels or metres; [`Settings`] must use the same. Times are
//! seconds where a name ends in `_s` and nanoseconds where it ends in `_ns`, angles are radians. Axes and the sense
//! of rotation are the caller's.
//!
//! # Guarantees
//!
//! * Equal inputs give equal outputs: no clock, no randomness, no memory beside the [`Tracker`].
//! * Whatever the inputs, NaN and backward time stamps included, no call panics and every published number is
//!   finite.
//! * No heap. The work of a call is bounded by [`MAX_TRACKS`] and [`MAX_OBSERVATIONS`]; what does not fit is
//!   counted.
//!
//! # Differences from the paper
//!
//! * The paper's network maps absolute positions to the next position and starts from nothing. Built literally, it is
//!   98 px wrong 30 frames ahead on a straight line without noise, after 32 samples. Here the network starts as the
//!   straight line through the last five positions and learns what the line gets wrong, in a frame that moves with the
//!   object, and it counts only as far as it has proved itself (`forecast`).
//! * The paper takes for each track the nearest observation, so two tracks may claim the same one. Here an
//!   observation is used once (`assign`).
//! * The paper makes the prediction the newest sample when an object is missed. Here the forecast of the last real
//!   sample is followed further instead: the same place, but nothing is fitted to or learned from positions that
//!   nobody saw.
//! * The paper assumes even frames. Here every step uses the frames' time stamps.
//!
//! # Deliberately absent
//!
//! Random numbers, pre-trained weights, a Kalman filter, knowledge of walls and of other objects, and any use of
//! the marker's heading for the path: a robot on omnidirectional wheels turns without its path bending.
#![no_std]
#![forbid(unsafe_code)]

mod assign;
mod covariance;
mod forecast;
mod heading;
mod history;
mod learner;
mod merge;
mod motion;
mod network;
mod observation;
mod score;
mod track;
mod tracker;

pub use observation::{Heading, Observation, Settings};
pub use track::{ForecastPoint, Track};
pub use tracker::{Tracker, Update};

/// Most tracks alive at once.
pub const MAX_TRACKS: usize = 64;
/// Most observations of one frame that are looked at; the rest is counted in [`Update::overflow`].
pub const MAX_OBSERVATIONS: usize = 2 * MAX_TRACKS;
/// Steps of a forecast, each [`Settings::forecast_step_s`] long.
pub const MAX_FORECAST: usize = 15;

/// Longest time, in forecast steps, over which anything is extrapolated: a coasting track is followed for
/// [`MAX_FORECAST`] steps with a forecast of [`MAX_FORECAST`] steps before it. A longer pause between two frames
/// counts as this long.
const MAX_GAP_STEPS: f64 = 2.0 * MAX_FORECAST as f64;

const NS_PER_S: f64 = 1e9;
