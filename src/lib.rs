//! overcam: one camera on the ceiling becomes a positioning service for everything on the floor.
//!
//! This page is the map of the program. The method is that of Engedy and Horváth, "Global, camera-based localization and
//! prediction of future positions in mobile robot navigation"; "section 2.1.1" and the like are that paper's. Three crates hold
//! its algorithms and know neither each other nor cameras, files and shared memory: [`imgproc`] (pixels to masks, contours and
//! thresholds), [`fourier`] (contours to descriptors, matches and poses) and [`predict`] (positions to tracks and
//! forecasts). A fourth, [`scene`], is what a subscriber reads.
//!
//! # From a frame to a scene
//!
//! [`pipeline`] is where to begin: [`Pipeline::process`](pipeline::Pipeline::process) turns one frame into one scene. It joins a
//! `view`, which is one camera, and the `world`, which is the tracks of everything that is seen. In this order they use
//!
//! * [`image`]: the bytes of a frame and what they decode to; JPEG and PNG;
//! * [`background`]: what the empty floor looks like, how it is learned, and how it is kept true;
//! * `segmentation`: the mask of everything that differs from it;
//! * `detection`: shapes of the mask, each a marked object or an obstacle;
//! * [`marker`]: the family of markers, and reading one on a shape ([`marker_design`] makes and judges drawings);
//! * [`geometry`]: outlines, and from pixels to metres on the floor. Lens and height belong here;
//! * [`settings`]: everything that decides what is found.
//!
//! # Around it
//!
//! * [`camera`]: V4L2 cameras, and the only `unsafe` of the program in `camera::v4l2`;
//! * [`source`]: where frames come from: a camera, files, recordings, and the demo floor with exact truth;
//! * [`output`]: where results go: lines of JSON, shared memory, MCAP files of Foxglove messages;
//! * [`run`]: the threads, the slots that travel between them, the counts of the frames, and what a person reads meanwhile;
//! * [`cli`] defines the arguments, [`config`] reads them from a file, [`command`] has a file for each subcommand;
//! * [`clock`]: the clock of all time stamps.
//!
//! # What is deliberately absent
//!
//! Stages are plain functions; there is no stage trait, no list of stages and no plug-in. The pipeline looks at no clock and draws no
//! random numbers: the same frames give the same scenes, live and replayed. A frame meets three threads and no lock; a fourth
//! writes the lines of `--json`, and nobody waits for it at a camera. There is no asynchronous runtime.

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
