//! Positions in, tracks and forecasts out (section 3 of Engedy and Horváth, "Global, camera-based localization and
//! prediction of future positions in mobile robot navigation"; below: the paper).
//!
//! Once a frame, [`Tracker::update`] takes what was seen on the floor and decides which known object each sighting
//! is, where the unseen ones are by now, and where all of them will be during the next [`FARTHEST_S`] seconds:
//!
//! 1. `tracker`: identities. Every track is forecast to the frame's own time stamp, sightings are assigned to
//!    tracks, a missing sighting is replaced by the forecast for a while, new things start tracks (section 3.1.1). A robot
//!    whose marker is read keeps its number wherever it turns up.
//! 2. `assign`: which sighting belongs to which track, all at once at the least cost. `hypotheses` are the places at which an
//!    object may be: where it is forecast, where its newest step leads, where a wall throws it back.
//! 3. `merge`: which observations are of several objects that touch, and where in it each of them is.
//! 4. `track`: what is known of one object; `history` and `heading` hold its samples.
//! 5. `forecast`: a mixture of classical forecasts. `experts` are fits of a few kinds of `motion` to stretches of the past;
//!    `marks` tell how each has done on this very track at each `horizon`; from these and from the motion itself (`inputs`) a
//!    small neural `network` says how much of each goes into the `mixture`, and goes on learning on line by backpropagation
//!    (section 3.1.2); `ellipse` says how wrong the result may be.
//!
//! The network starts from weights made beforehand of generated motions; [`training`] is for the program that makes them.
//!
//! # Units
//!
//! Lengths are in whatever unit the observations use, pixels or metres; [`Settings`] must use the same. Times are
//! seconds where a name ends in `_s` and nanoseconds where it ends in `_ns`, angles are radians. Axes and the sense
//! of rotation are the caller's.
//!
//! # Guarantees
//!
//! * Equal inputs give equal outputs, on every machine: no clock, no randomness, no memory beside the [`Tracker`], and
//!   mathematical functions of our own choice (`libm`) in one order.
//! * Whatever the inputs, NaN and backward time stamps included, no call panics and every published number is
//!   finite.
//! * No heap. The work of a call is bounded by [`MAX_TRACKS`] and [`MAX_OBSERVATIONS`]; what does not fit is
//!   counted.
//!
//! # Differences from the paper
//!
//! * The paper's network maps absolute positions to the next position, starts from nothing and is fed back on itself. Built
//!   literally, it is 98 px wrong 30 frames ahead on a straight line without noise, after 32 samples. Here the network weighs
//!   classical forecasts, for near and far at once, and starts from what it learned of generated motions (`forecast`).
//! * The paper takes for each track the nearest observation, so two tracks may claim the same one. Here an
//!   observation is used once (`assign`).
//! * The paper makes the prediction the newest sample when an object is missed. Here the forecast of the last real
//!   sample is followed further instead: the same place, but nothing is fitted to or learned from positions that
//!   nobody saw.
//! * The paper assumes even frames. Here every step uses the frames' time stamps.
//!
//! # Deliberately absent
//!
//! Random numbers, a Kalman filter, and what other objects do.
#![no_std]
#![forbid(unsafe_code)]

mod bounds;
mod covariance;
mod forecast;
mod heading;
mod history;
mod layout;
mod limits;
mod observation;
mod time;
mod tracker;
pub mod training;
mod vector;

pub use forecast::curve::ForecastPoint;
pub use limits::{FARTHEST_S, FORECAST_SPACING_S, MAX_FORECAST, MAX_OBSERVATIONS, MAX_TRACKS};
pub use observation::{Heading, Observation, Settings};
pub use tracker::track::Track;
pub use tracker::{Tracker, Update};
