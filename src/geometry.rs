//! From pixels to the floor, and shapes as points: [`calibration`] is the homography and its effect
//! on poses, `outline` simplifies contours, `raster` fills polygons exactly.

pub mod calibration;
pub(crate) mod outline;
pub(crate) mod raster;
