//! How small, blurred and noisy a marker may be, and how exact its pose is then.
//!
//! Scenes are drawn by this test alone, point by point, so that nothing in them comes from the code that reads them.

mod accuracy;
mod disturbances;
mod random;
mod scene;
