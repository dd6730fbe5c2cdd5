//! How small, blurred and noisy a marker may be, and how precise its pose is then.
//!
//! Scenes are drawn by this test alone, point by point, so that they do not depend on the code
//! under test.

mod accuracy;
mod camera;
mod disturbances;
mod floorless;
mod perspective;
mod random;
mod scene;
mod viewpoint;
