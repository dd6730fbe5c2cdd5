//! overcam: one ceiling camera as a positioning service for everything on the floor.
//!
//! This page is the map of the program. The method is that of Engedy and Horváth, "Global,
//! camera-based localization and prediction of future positions in mobile robot navigation";
//! section numbers ("section 2.1.1") refer to that paper. Three crates hold its algorithms. They do
//! not depend on each other, nor on cameras, files or shared memory: [`imgproc`] (pixels to masks,
//! contours and thresholds), [`fourier`] (contours to descriptors, matches and poses) and
//! [`predict`] (positions to tracks and forecasts). A fourth, [`scene`], is what a subscriber
//! reads.
//!
//! # From a frame to a scene
//!
//! Start with [`pipeline`]: [`Pipeline::process`](pipeline::Pipeline::process) turns one frame into
//! one scene. It combines a `view` (one camera) and the `world` (the tracks of all observed
//! objects). In processing order they use
//!
//! * [`image`]: the bytes of a frame and their decoding; JPEG and PNG;
//! * [`background`]: the model of the empty floor, how it is learned and kept up to date;
//! * `segmentation`: the mask of everything that differs from the background;
//! * `detection`: classifies each shape of the mask as a marked object or an obstacle;
//! * [`marker`]: the marker family and marker recognition ([`marker_design`] creates and checks
//!   drawings);
//! * [`geometry`]: outlines, and the mapping from pixels to metres on the floor. Lens and height
//!   belong here;
//! * [`settings`]: all parameters that affect the results.
//!
//! # Around it
//!
//! * [`camera`]: V4L2 cameras; the only `unsafe` code of the program is in `camera::v4l2`;
//! * [`source`]: frame sources: a camera, files, recordings, and the demo floor with ground truth;
//! * [`output`]: JSON lines, shared memory, MCAP files of Foxglove messages;
//! * [`run`]: the threads, the slots passed between them, the frame counts, and the status
//!   messages;
//! * [`cli`] defines the arguments, [`config`] reads them from a file, [`command`] has a file for
//!   each subcommand;
//! * [`clock`]: the clock of all time stamps.
//!
//! # What is deliberately absent
//!
//! Stages are plain functions; there is no stage trait, no list of stages and no plug-in. The
//! pipeline uses no clock and no random numbers: the same frames give the same scenes, live and
//! replayed. A frame passes through three threads and no lock; a fourth thread writes the lines of
//! `--json`, and a live camera never waits for it. There is no asynchronous runtime.

pub mod background;
pub mod camera;
pub mod cli;
pub mod clock;
pub mod command;
pub mod config;
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
mod view;
mod world;
