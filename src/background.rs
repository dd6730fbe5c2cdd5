//! The background: the appearance of the empty floor, and how it is kept up to date.
//!
//! [`model`] is the picture of the empty floor with the noise of its pixels, and its file format;
//! [`learner`] computes one from frames. During a run, `update` follows slow changes,
//! `illumination` handles changes of the light, and `ghosts` finds the places that objects have
//! left. [`region`] is the part of the picture that is floor.

pub(crate) mod ghosts;
pub(crate) mod illumination;
pub mod learner;
pub mod model;
pub mod region;
pub(crate) mod update;
