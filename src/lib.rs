//! overcam.
mod cutout;
pub mod drawing;
pub mod frame;
pub mod marker;
mod raster;
pub mod source;
