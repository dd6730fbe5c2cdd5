//! One frame in, one scene out: the chain of the paper from picture to forecast.
//!
//! The pipeline holds all memory it needs, allocates nothing for a frame in a raw format, looks at no clock, and gives the
//! same scene for the same frames whatever its scratch memory held before.

use imgproc::Size;
use predict::{Heading, MAX_TRACKS, Observation, Track, Tracker};
use scene::{ForecastPoint, Object};

use crate::background::learner::Learner;
use crate::background::model::BackgroundModel;
use crate::background::region::Region;
use crate::detection::{Detection, Detector, MAX_DETECTIONS};
use crate::geometry::calibration::{Calibration, FloorPoint};
use crate::image::frame::{DecodeError, Picture, decode};
use crate::marker::Family;
use crate::run::slot::Slot;
use crate::segmentation::{Light, Segmented, Segmenter};
use crate::settings::Settings;

/// Frames per second where a source does not say.
const RATE_HZ: f64 = 30.0;

/// Distance by which an object at rest may be found beside its forecast, in widths of the picture.
const GATE_WIDTHS: f64 = 0.0125;

/// Side of the square on the floor that bounds a position's usefulness: farther away is beyond the horizon's blur.
const FLOOR_MAX_M: f64 = 1e6;

/// Everything between a frame and its scene.
#[derive(Debug)]
pub struct Pipeline {
    settings: Settings,
    tracking: predict::Settings,
    family: Family,
    calibration: Option<Calibration>,
    /// `None` until a floor is known.
    segmenter: Option<Box<Segmenter>>,
    learning: Learning,
    region: Option<Region>,
    picture: Picture,
    detector: Detector,
    observations: Vec<Observation>,
    seen: Vec<usize>,
    /// Size of each track when it was seen last, in the order of the tracks.
    sizes: Vec<(u64, f64)>,
    tracker: Tracker<Vec<Track>>,
}

/// What is going on to know the empty floor, or to know it anew.
#[derive(Debug)]
enum Learning {
    /// Nothing.
    Idle,
    /// Frames are being collected.
    Collecting(Box<Learner>),
    /// Learned with the last frame; it counts from the next one on.
    Done(BackgroundModel),
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It was used to learn the empty floor; the slot's scene is untouched.
    Learning,
    /// The slot's scene is what the frame shows.
    Scene,
}

impl Pipeline {
    /// A pipeline for frames of one size. `rate_hz` is the rate of the frames, where it is known.
    #[must_use]
    pub fn new(
        size: Size,
        rate_hz: Option<f64>,
        settings: Settings,
        family: Family,
        calibration: Option<Calibration>,
    ) -> Self {
        let tracking = tracking(
            size,
            rate_hz.unwrap_or(RATE_HZ),
            &settings,
            calibration.as_ref(),
        );
        Self {
            tracking,
            family,
            calibration,
            segmenter: None,
            learning: Learning::Collecting(Box::new(Learner::new(size, settings.learn))),
            region: None,
            picture: Picture::new(size),
            detector: Detector::new(size),
            observations: Vec::with_capacity(MAX_DETECTIONS),
            seen: Vec::with_capacity(MAX_DETECTIONS),
            sizes: Vec::with_capacity(2 * MAX_DETECTIONS),
            tracker: Tracker::new(vec![Track::EMPTY; MAX_TRACKS]),
            settings,
        }
    }

    /// Looks at this part of the frames only, or at all of them again.
    ///
    /// # Panics
    ///
    /// When the region has another size than the frames.
    pub fn set_region(&mut self, region: Option<Region>) {
        if let Some(region) = &region {
            assert_eq!(
                region.size(),
                self.picture.size,
                "a region has another size"
            );
        }
        self.region = region;
    }

    /// Learns the empty floor anew from the next [`Settings::learn`] frames. The old one is used meanwhile; the new one applies from the frame
    /// after them on. Where one is being learned already, that one goes on.
    pub fn relearn(&mut self) {
        if !self.is_learning() {
            let learner = Learner::new(self.picture.size, self.settings.learn);
            self.learning = Learning::Collecting(Box::new(learner));
        }
    }

    /// Whether a floor is being learned that is not in use yet.
    #[must_use]
    pub fn is_learning(&self) -> bool {
        !matches!(self.learning, Learning::Idle)
    }

    /// While frames are collected to learn a floor: how many there are so far, and how many are needed.
    #[must_use]
    pub fn learning_progress(&self) -> Option<(u32, u32)> {
        match &self.learning {
            Learning::Collecting(learner) => Some((learner.seen(), learner.frames())),
            Learning::Done(_) | Learning::Idle => None,
        }
    }

    /// The floor that is in use, as it was kept true so far; `None` before one is known. Takes memory.
    #[must_use]
    pub fn floor(&self) -> Option<BackgroundModel> {
        self.segmenter.as_ref().map(|segmenter| segmenter.floor())
    }

    /// Processes the slot's frame. A background in the slot replaces the one in use; one that was learned is put into the slot
    /// of the first frame that it is used for.
    ///
    /// # Errors
    ///
    /// [`DecodeError`] when the frame's bytes are no picture; the tracks are left as they were.
    ///
    /// # Panics
    ///
    /// When the background has another size than the frames.
    pub fn process(&mut self, slot: &mut Slot) -> Result<Outcome, DecodeError> {
        decode(&slot.frame, &mut self.picture)?;
        self.update_floor(&mut slot.background);
        let Some(segmenter) = &mut self.segmenter else {
            return Ok(Outcome::Learning);
        };

        let Segmented {
            mask,
            light,
            gains,
            noise,
        } = segmenter.segment(&self.picture, &self.settings.segmentation());
        if let Some(region) = &self.region {
            region.clear_outside(mask);
        }
        let calibration = self.calibration.as_ref();
        let recognition = |at_px| {
            let floor = calibration.and_then(|calibration| on_floor(calibration, at_px));
            self.settings
                .recognition(floor.map(|floor| floor.metres_per_px()))
        };
        let (detections, overflow) = self.detector.detect(
            mask,
            &self.picture,
            noise,
            &self.family,
            self.settings.area_min as usize,
            &recognition,
        );
        self.observations.clear();
        self.seen.clear();
        for (index, detection) in detections.iter().enumerate() {
            if let Some(observation) = observe(detection, calibration) {
                self.observations.push(observation);
                self.seen.push(index);
            }
        }
        let update = self
            .tracker
            .update(slot.frame.stamp_ns, &self.observations, &self.tracking);

        let scene = &mut *slot.scene;
        scene.sequence = slot.frame.sequence;
        scene.stamp_ns = slot.frame.stamp_ns;
        scene.published_ns = 0;
        scene.frame = if calibration.is_some() {
            scene::FRAME_FLOOR
        } else {
            scene::FRAME_IMAGE
        };
        scene.n_overflow = overflow + update.overflow as u32;
        scene.light = match light {
            Light::Steady => scene::LIGHT_STEADY,
            Light::Changed { .. } => scene::LIGHT_CHANGED,
            Light::Dark => scene::LIGHT_DARK,
        };
        scene.gain = [gains.red, gains.green, gains.blue];
        scene.n_objects = 0;
        for (object, track) in scene.objects.iter_mut().zip(self.tracker.tracks()) {
            let detection = track.observed().map(|i| &detections[self.seen[i]]);
            *object = report(track, detection, &self.family, calibration);
            if detection.is_none() {
                let last = self.sizes.iter().find(|(id, _)| *id == track.id());
                object.size = last.map_or(0.0, |(_, size)| *size);
            }
            scene.n_objects += 1;
        }
        scene.objects[scene.n_objects as usize..].fill(Object::EMPTY);
        self.sizes.clear();
        self.sizes.extend(
            scene
                .objects()
                .iter()
                .map(|object| (object.track, object.size)),
        );
        Ok(Outcome::Scene)
    }

    /// Takes a floor that comes with a frame or was learned before it into use, and learns from the decoded frame.
    fn update_floor(&mut self, background: &mut Option<BackgroundModel>) {
        if background.is_some() && self.segmenter.is_none() {
            self.learning = Learning::Idle;
        }
        self.learning = match std::mem::replace(&mut self.learning, Learning::Idle) {
            Learning::Done(floor) => {
                background.get_or_insert(floor);
                Learning::Idle
            }
            Learning::Collecting(mut learner) => {
                if learner.add(&self.picture) {
                    learner.finish().map_or(Learning::Idle, Learning::Done)
                } else {
                    Learning::Collecting(learner)
                }
            }
            Learning::Idle => Learning::Idle,
        };
        if let Some(floor) = background {
            self.detector.forget_blur();
            self.tracker.forget_floor();
            match &mut self.segmenter {
                Some(segmenter) => segmenter.set_background(floor),
                None => self.segmenter = Some(Box::new(Segmenter::new(floor))),
            }
        }
    }
}

/// Settings of the tracker, in the unit of the scene.
fn tracking(
    size: Size,
    rate_hz: f64,
    settings: &Settings,
    calibration: Option<&Calibration>,
) -> predict::Settings {
    let width = size.width as f64;
    let in_pixels = predict::Settings {
        frame_period_s: 1.0 / rate_hz,
        top_speed: settings.top_speed * width,
        gate_base: GATE_WIDTHS * width,
        marker_offset: GATE_WIDTHS * width,
        max_misses: settings.misses_max,
        confirm: settings.confirm,
    };
    let middle = [(width - 1.0) / 2.0, (size.height as f64 - 1.0) / 2.0];
    match calibration.and_then(|c| c.to_floor(middle)) {
        Some(floor) => in_pixels.scaled(floor.metres_per_px()),
        None => in_pixels,
    }
}

/// A detection as the tracker takes it; `None` where it is not on the floor.
fn observe(detection: &Detection, calibration: Option<&Calibration>) -> Option<Observation> {
    let marker = detection.marker.map(|marker| marker.marker as u32);
    let heading = detection.marker.map(|marker| Heading {
        rad: f64::from(marker.heading_rad),
        variance: f64::from(marker.covariance[2][2]),
    });
    let (reach, area) = detection.outline.extent(detection.centre);
    let Some(calibration) = calibration else {
        let [x, y] = detection.centre;
        return Some(Observation {
            x,
            y,
            covariance: detection.covariance,
            heading,
            marker,
            reach,
            area,
        });
    };
    let floor = on_floor(calibration, detection.centre)?;
    let heading = heading.map(|heading| {
        let (rad, growth) = floor.heading(heading.rad);
        Heading {
            rad,
            variance: heading.variance * growth * growth,
        }
    });
    let [x, y] = floor.at;
    let metres_per_px = floor.metres_per_px();
    Some(Observation {
        x,
        y,
        covariance: floor.covariance(detection.covariance),
        heading,
        marker,
        reach: reach * metres_per_px,
        area: area * metres_per_px * metres_per_px,
    })
}

fn on_floor(calibration: &Calibration, pixel: [f64; 2]) -> Option<FloorPoint> {
    calibration
        .to_floor(pixel)
        .filter(|floor| floor.at.iter().all(|c| c.abs() < FLOOR_MAX_M))
}

/// A track as a subscriber reads it.
fn report(
    track: &Track,
    detection: Option<&Detection>,
    family: &Family,
    calibration: Option<&Calibration>,
) -> Object {
    let mut object = Object::EMPTY;
    object.track = track.id();
    [object.x, object.y] = track.position();
    [object.vx, object.vy] = track.velocity();
    object.turn_rate_rad_s = track.turn_rate_rad_s();
    object.age_s = track.age_s();
    if let Some(marker) = track.marker() {
        object.kind = scene::KIND_MARKER;
        let name = family.name(marker as usize).as_bytes();
        object.marker[..name.len()].copy_from_slice(name);
    }
    // A robot whose marker was not read is where its forecast says. Of obstacles that touch one is observed, with the outline of
    // all: something was seen there, although not which is which.
    let outline_seen = track.marker().is_none() && detection.is_some();
    if track.pose_observed() || outline_seen {
        object.flags |= scene::OBSERVED;
    }
    let [[xx, xy], [yx, yy]] = track.covariance();
    object.covariance = [[xx, xy, 0.0], [yx, yy, 0.0], [0.0; 3]];
    if let Some(heading) = track.heading() {
        object.flags |= scene::HAS_HEADING;
        object.heading_rad = heading.rad;
        object.covariance[2][2] = heading.variance;
    }
    if track.pose_observed()
        && let Some(detection) = detection
    {
        add_reading(detection, calibration, &mut object);
    }
    if let Some(detection) = detection {
        let metres = |c: &Calibration| {
            on_floor(c, detection.centre).map_or(0.0, |floor| floor.metres_per_px())
        };
        object.size = detection.size_px * calibration.map_or(1.0, metres);
        outline(detection, calibration, &mut object);
    }
    for (point, forecast) in object.forecast.iter_mut().zip(track.forecast()) {
        let predict::ForecastPoint {
            dt_s,
            x,
            y,
            covariance,
        } = *forecast;
        *point = ForecastPoint {
            dt_s,
            x,
            y,
            covariance,
        };
        object.n_forecast += 1;
    }
    object
}

/// Adds what was found when the marker was read: how sure that is, and how errors of position and heading hang together.
fn add_reading(detection: &Detection, calibration: Option<&Calibration>, object: &mut Object) {
    let Some(marker) = detection.marker else {
        return;
    };
    object.confidence = f64::from(marker.confidence);
    let in_picture = [0, 1].map(|i| f64::from(marker.covariance[i][2]));
    let with_heading = match calibration {
        Some(calibration) => on_floor(calibration, detection.centre)
            .map(|floor| floor.covariance_with_heading(f64::from(marker.heading_rad), in_picture)),
        None => Some(in_picture),
    };
    for (i, covariance) in with_heading.unwrap_or_default().into_iter().enumerate() {
        object.covariance[i][2] = covariance;
        object.covariance[2][i] = covariance;
    }
}

/// Copies the outline, onto the floor where there is a calibration; corners beyond the horizon are left out.
fn outline(detection: &Detection, calibration: Option<&Calibration>, object: &mut Object) {
    for &pixel in detection.outline.points() {
        let at = match calibration {
            Some(calibration) => on_floor(calibration, pixel).map(|floor| floor.at),
            None => Some(pixel),
        };
        if let Some(at) = at {
            object.outline[object.n_outline as usize] = at;
            object.n_outline += 1;
        }
    }
}
