//! Multi-object tracking and motion forecasts from position measurements (section 3 of Engedy and
//! Horváth, "Global, camera-based localization and prediction of future positions in mobile robot
//! navigation"; "the paper" below).
//!
//! [`Tracker::update`] is called once per frame with the observations of that frame. It decides
//! which known object each observation belongs to, estimates where unobserved objects are, and
//! forecasts all of them for the next [`FORECAST_RANGE_S`] seconds:
//!
//! * `tracker`: the life cycle of tracks (section 3.1.1). A robot whose marker is read keeps its id
//!   wherever it reappears. `tracker::association` assigns observations to tracks,
//!   `tracker::hypotheses` lists the positions where an object may be, `tracker::merge` finds blobs
//!   that contain several touching objects, `tracker::track` is the state of one object.
//! * `forecast`: a mixture of classical forecasts (section 3.1.2). `forecast::experts` fits a few
//!   kinds of motion to recent samples, `forecast::scores` measures how well each expert has done
//!   on this track, and a small neural network (`forecast::network`) turns both into the share of
//!   each expert in the mixture. It keeps learning online by backpropagation. `forecast::ellipse`
//!   estimates the error of the result.
//! * [`training`]: for the program that computes the start weights of the network from generated
//!   motions.
//!
//! # Units
//!
//! Lengths are in the unit of the observations, pixels or metres. [`Settings`] must use the same
//! unit. Times are in seconds where a name ends in `_s` and in nanoseconds where it ends in `_ns`.
//! Angles are in radians. The caller chooses the axes and the sense of rotation.
//!
//! # Guarantees
//!
//! * Equal inputs give equal outputs on every machine. There is no clock, no randomness and no
//!   state outside the [`Tracker`], and mathematical functions come from `libm`, evaluated in a
//!   fixed order.
//! * No call panics and every published number is finite, whatever the inputs, including NaN and
//!   time stamps that go backwards.
//! * No heap allocation. The work per call is bounded by [`MAX_TRACKS`] and [`MAX_OBSERVATIONS`].
//!   Anything beyond that is counted.
//!
//! # Differences from the paper
//!
//! * The paper's network maps absolute positions to the next position, starts untrained and is fed
//!   its own output. Implemented literally, it is 98 px off 30 frames ahead on a straight line
//!   without noise, after 32 samples. Here the network weighs classical forecasts, for all horizons
//!   at once, and starts from weights trained on generated motions.
//! * The paper assigns the nearest observation to each track, so two tracks may claim the same one.
//!   Here each observation is used once.
//! * When an object is not observed, the paper uses the prediction as the newest sample. Here the
//!   forecast made at the last real sample is extrapolated. The position is the same, but nothing
//!   is fitted to or learned from positions that were never measured.
//! * The paper assumes a constant frame rate. Here every step uses the time stamps of the frames.
//!
//! # Deliberately absent
//!
//! Random numbers, a Kalman filter for motion, and interaction between objects.
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
pub use limits::{
    FORECAST_RANGE_S, FORECAST_SPACING_S, MAX_FORECAST, MAX_OBSERVATIONS, MAX_TRACKS,
};
pub use observation::{Heading, Observation, Settings};
pub use tracker::track::Track;
pub use tracker::{Tracker, Update};
