//! A pipeline that is shown drawn scenes.

use std::sync::LazyLock;

use imgproc::Size;
use overcam::image::frame::{Picture, decode};
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::{Outcome, Pipeline};
use overcam::run::slot::Slot;
use overcam::settings::Settings;
use scene::Scene;

use crate::camera::Camera;
use crate::canvas::Canvas;
use crate::light::Light;

/// Frames per second.
pub(crate) const RATE_HZ: usize = 30;

/// Drawing its references takes as long as twenty frames.
static FAMILY: LazyLock<Family> =
    LazyLock::new(|| Family::from_files(&built_in_files()).expect("the built-in family is usable"));

/// The whole program between camera and planner.
pub(crate) struct Play {
    pipeline: Pipeline,
    camera: Camera,
    slot: Slot,
    /// Number of the next frame.
    sequence: u64,
}

impl Play {
    /// Learns the floor from as many frames of a canvas as the default settings ask for.
    pub(crate) fn learned(camera: Camera, empty: &Canvas) -> Self {
        let mut play = Self::new(camera, empty.size);
        for _ in 0..Settings::default().learn {
            assert_eq!(play.expose(empty, &Light::EVEN), Outcome::Learning);
        }
        play
    }

    /// Is given a picture of the floor, as from a file.
    pub(crate) fn given(camera: Camera, empty: &Canvas) -> Self {
        let mut play = Self::new(camera, empty.size);
        let mut picture = Picture::new(empty.size);
        Camera::ideal().expose(empty, &Light::EVEN, &mut play.slot.frame);
        decode(&play.slot.frame, &mut picture).expect("a drawn frame decodes");
        play.slot.background = Some(overcam::background::model::BackgroundModel::from_picture(
            &picture,
        ));
        play
    }

    fn new(camera: Camera, size: Size) -> Self {
        Self {
            pipeline: Pipeline::new(
                size,
                Some(RATE_HZ as f64),
                Settings::default(),
                FAMILY.clone(),
                None,
            ),
            camera,
            slot: Slot::empty(),
            sequence: 0,
        }
    }

    /// What is published for a frame.
    pub(crate) fn show(&mut self, canvas: &Canvas, light: &Light) -> &Scene {
        assert_eq!(self.expose(canvas, light), Outcome::Scene);
        &self.slot.scene
    }

    fn expose(&mut self, canvas: &Canvas, light: &Light) -> Outcome {
        self.camera.expose(canvas, light, &mut self.slot.frame);
        self.slot.frame.sequence = self.sequence;
        self.slot.frame.stamp_ns = self.sequence * 1_000_000_000 / RATE_HZ as u64;
        self.sequence += 1;
        let outcome = self.pipeline.process(&mut self.slot);
        self.slot.background = None;
        outcome.expect("a drawn frame decodes")
    }
}
