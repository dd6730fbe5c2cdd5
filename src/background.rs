//! The background: what the floor looks like when nothing stands on it, and how that is kept true.
//!
//! [`model`] is the picture of the empty floor with the noise of its pixels, and its file; [`learner`] makes one from frames. While a
//! run goes on, `update` follows slow changes, `illumination` changes of the light, and `ghosts` decides what has left.
//! [`region`] is the part of the picture that is floor.

pub(crate) mod ghosts;
pub(crate) mod illumination;
pub mod learner;
pub mod model;
pub mod region;
pub(crate) mod update;
