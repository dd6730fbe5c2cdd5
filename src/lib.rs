//! overcam: one camera on the ceiling becomes a positioning service for everything on the floor.
//!
//! This page is the map of the program. The method is that of Engedy and Horváth, "Global, camera-based localization and
//! prediction of future positions in mobile robot navigation"; "section 2.1.1" and the like are that paper's. Three crates hold
//! its algorithms and know neither each other nor cameras, files and shared memory: [`imgproc`] (pixels to masks, contours and
//! thresholds), [`fourier`] (contours to descriptors, matches and poses) and [`predict`] (positions to tracks and
//! forecasts). A fourth, [`scene`], is what a subscriber reads.
//!
//! # The chain
//!
//! [`pipeline`] is where to begin: [`Pipeline::process`](pipeline::Pipeline::process) turns one frame into one scene. It joins
//!
//! * [`frame`]: a frame in the format of its source, decoded into colour planes ([`jpeg`] decodes JPEG);
//! * [`floor`]: what is known of the empty floor, learned or read, and which part of the picture is floor;
//! * `segmentation`: the mask of everything that differs from it;
//! * `detection`: shapes of the mask, each a marked object or an obstacle; [`marker`] reads what is on them, `outline`
//!   simplifies contours;
//! * [`calibration`]: from pixels to metres on the floor;
//! * [`settings`]: everything that decides what is found.
//!
//! # Around it
//!
//! * [`source`]: where frames come from, cameras, files, recordings, and the demo floor with exact truth;
//! * [`slot`]: what travels through the program with a frame;
//! * [`recording`]: frames and results into MCAP, and back;
//! * [`publish`]: scenes into shared memory, from where [`watch`] and any planner read them; [`json`]: a scene as a line,
//!   `lines`: its way to standard output;
//! * [`cli`] defines the arguments, [`command`] does what they say, `setup` makes of them what a run works with, [`run`] holds the three threads and keeps the
//!   books of the frames, [`status`] shows that they live, `notify` tells systemd so;
//! * `raster` draws polygons exactly, for the demo and for the markers' references.
//!
//! # What is deliberately absent
//!
//! Stages are plain functions; there is no stage trait, no list of stages and no plug-in. The pipeline looks at no clock and draws no
//! random numbers: the same frames give the same scenes, live and replayed. A frame meets three threads and no lock; a fourth
//! writes the lines of `--json`, and nobody waits for it at a camera. There is no asynchronous runtime.

pub mod background;
pub mod camera;
pub mod cli;
pub mod command;
mod detection;
pub mod geometry;
pub mod image;
pub mod marker;
pub mod marker_design;
pub mod output;
pub mod pipeline;
pub mod run;
mod segmentation;
pub mod settings;
pub mod source;
