//! overcam.

mod cutout;
pub mod demo;
pub mod drawing;
pub mod frame;
pub mod jpeg;
pub mod marker;
mod raster;
mod render;
pub mod source;
