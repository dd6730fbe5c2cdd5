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
//! * `segmentation`: the mask of everything that differs from the empty floor, which it also learns;
//! * `detection`: shapes of the mask, each a marked object or an obstacle. `cutout` finds the dark figure on a bright plate,
//!   [`marker`] says which marker it is, by the `reference`s it learned and the `pattern` of the plate; `outline` simplifies
//!   contours;
//! * [`calibration`]: from pixels to metres on the floor;
//! * [`settings`]: everything that decides what is found.
//!
//! [`drawing`] reads markers from SVG files; `raster` draws polygons exactly.
//!
//! # Frames in
//!
//! [`source`] is an enum over [`camera`] (on `v4l2`, the only file with `unsafe`; [`devices`] lists them), [`y4m`], [`pictures`],
//! [`replay`] and [`demo`], the synthetic floor with exact truth that `render` draws.
//!
//! # Results out
//!
//! [`json`] writes a scene as a line, [`publish`] puts it into shared memory, from where [`watch`] and any planner read it;
//! [`record`] writes frames and results as MCAP ([`topics`], [`image_message`] and `annotate` say how, [`provenance`] what a replay
//! needs to know), and [`recover`] completes a recording that was cut off.
//!
//! # The program
//!
//! [`cli`] defines the arguments, `setup` makes of them what a run works with, [`run`] holds the three threads and keeps the books
//! of the frames, [`status`] shows that they live and words errors.
//!
//! # What is deliberately absent
//!
//! Stages are plain functions; there is no stage trait, no list of stages and no plug-in. The pipeline looks at no clock and draws no
//! random numbers: the same frames give the same scenes, live and replayed. There is no fourth thread, no lock and no
//! asynchronous runtime.

mod annotate;
pub mod calibration;
pub mod camera;
pub mod cli;
mod cutout;
pub mod demo;
mod detection;
pub mod devices;
pub mod drawing;
pub mod frame;
pub mod image_message;
pub mod jpeg;
pub mod json;
pub mod marker;
mod negotiation;
mod outline;
mod pattern;
pub mod pictures;
pub mod pipeline;
pub mod provenance;
pub mod publish;
mod raster;
pub mod record;
mod records;
pub mod recover;
mod reference;
mod render;
pub mod replay;
pub mod run;
mod segmentation;
pub mod settings;
mod setup;
pub mod source;
pub mod status;
pub mod topics;
mod v4l2;
pub mod watch;
pub mod y4m;
