//! overcam.

pub mod calibration;
mod cutout;
pub mod demo;
mod detection;
pub mod drawing;
pub mod frame;
pub mod jpeg;
pub mod marker;
mod outline;
mod pattern;
pub mod pipeline;
mod raster;
mod reference;
mod render;
mod segmentation;
pub mod settings;
pub mod source;
