//! What segmentation is worth on floors of every kind, measured on drawn scenes whose truth is
//! known to a quarter of a pixel.
//!
//! Everything goes through the public pipeline with its default settings, and everything is judged
//! by the outlines that it publishes. The figures of every scene on every floor are stored in
//! `table.txt`: [`table`] compares them, and `FLOORS_RENEW=1 cargo test --test floors` stores them
//! anew.
//!
//! # How a scene is drawn
//!
//! A [`canvas::Canvas`] holds what the camera looks at: a [`floor`], [`shadow`]s on it, [`body`]s
//! above them, each point sampled 4x4 times a pixel and blurred as by a lens. A [`camera::Camera`]
//! exposes it under a [`light`], with shot-like noise, into the bytes of a camera's format. Grey
//! values are proportional to light: a gamma would lift the shadows and make them easier to tell
//! from black things.
//!
//! # How a scene is judged
//!
//! [`judge`] fills the published outlines on the same 4x4 grid and counts points. Shadows are
//! judged apart from the edges of objects, which the F-measure judges. No scene holds an object
//! that is a dimmed copy of its floor: nobody can tell that from a shadow.

mod body;
mod camera;
mod canvas;
mod floor;
mod judge;
mod light;
mod play;
mod random;
mod shadow;

mod day;
mod empty_floors;
mod ghosts;
mod light_changes;
mod masks;
mod shadows;
mod table;
mod whole_shapes;
