//! All cameras: from observations to tracks, and from tracks to the scene that subscribers read.

use imgproc::Size;
use predict::{MAX_TRACKS, Observation, Track, Tracker};
use scene::{ForecastPoint, Object, Scene};

use crate::detection::MAX_DETECTIONS;
use crate::segmentation::Light;
use crate::settings::{Settings, frames_in};
use crate::view::{Sighting, Sightings};

/// Largest distance between an object at rest and its forecast, as a share of the picture width.
const GATE_WIDTHS: f64 = 0.0125;

/// The tracks of all objects on the floor.
#[derive(Debug)]
pub(crate) struct World {
    tracking: predict::Settings,
    /// Coordinate frame of all positions, as in [`Scene::frame`].
    frame: u32,
    /// Marker names, in the order of the family.
    names: Vec<String>,
    tracker: Tracker<Vec<Track>>,
    observations: Vec<Observation>,
    /// Last observed size of each track, in the order of the tracks.
    sizes: Vec<(u64, f64)>,
}

impl World {
    /// A world without tracks. `metres_per_px` is the width of a pixel at the image centre, if
    /// there is a calibration.
    pub(crate) fn new(
        size: Size,
        rate_hz: f64,
        settings: &Settings,
        metres_per_px: Option<f64>,
        names: Vec<String>,
    ) -> Self {
        Self {
            tracking: tracking(size, rate_hz, settings, metres_per_px),
            frame: match metres_per_px {
                Some(_) => scene::FRAME_FLOOR,
                None => scene::FRAME_IMAGE,
            },
            names,
            tracker: Tracker::new(vec![Track::EMPTY; MAX_TRACKS]),
            observations: Vec::with_capacity(MAX_DETECTIONS),
            sizes: Vec::with_capacity(2 * MAX_DETECTIONS),
        }
    }

    /// Clears the known walls, because the floor has changed. The tracks are kept.
    pub(crate) fn forget_floor(&mut self) {
        self.tracker.forget_floor();
    }

    /// Updates the tracks with the observations of one frame and writes the scene, except for its
    /// sequence number, clock and time of publication.
    pub(crate) fn update(&mut self, stamp_ns: u64, seen: &Sightings<'_>, scene: &mut Scene) {
        self.observations.clear();
        self.observations
            .extend(seen.all.iter().map(|sighting| sighting.observation));
        let update = self
            .tracker
            .update(stamp_ns, &self.observations, &self.tracking);

        scene.stamp_ns = stamp_ns;
        scene.published_ns = 0;
        scene.frame = self.frame;
        scene.n_overflow = seen.overflow + update.overflow as u32;
        scene.light = match seen.light {
            Light::Steady => scene::LIGHT_STEADY,
            Light::Changed { .. } => scene::LIGHT_CHANGED,
            Light::Dark => scene::LIGHT_DARK,
        };
        scene.gain = seen.gain;
        scene.n_objects = 0;
        for (object, track) in scene.objects.iter_mut().zip(self.tracker.tracks()) {
            let sighting = track.observed().map(|i| &seen.all[i]);
            *object = self.report(track, sighting);
            scene.n_objects += 1;
        }
        scene.objects[scene.n_objects as usize..].fill(Object::EMPTY);
        self.sizes.clear();
        let sizes = scene.objects().iter().map(|o| (o.track, o.size));
        self.sizes.extend(sizes);
    }

    /// A track in the form that subscribers read.
    fn report(&self, track: &Track, sighting: Option<&Sighting>) -> Object {
        let mut object = Object::EMPTY;
        object.track = track.id();
        [object.x, object.y] = track.position();
        [object.vx, object.vy] = track.velocity();
        object.turn_rate_rad_s = track.turn_rate_rad_s();
        object.age_s = track.age_s();
        if let Some(marker) = track.marker() {
            object.kind = scene::KIND_MARKER;
            let name = self.names[marker as usize].as_bytes();
            object.marker[..name.len()].copy_from_slice(name);
        }
        // If the marker of a robot was not read, its predicted position is reported. Of obstacles
        // that touch, one is observed, with the outline of all: something is there, but it is
        // unknown which.
        let outline_seen = track.marker().is_none() && sighting.is_some();
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
        match sighting {
            Some(sighting) => add_sighting(sighting, track.pose_observed(), &mut object),
            None => {
                let last = self.sizes.iter().find(|(id, _)| *id == track.id());
                object.size = last.map_or(0.0, |(_, size)| *size);
            }
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
}

/// Adds what was observed of a track in this frame.
fn add_sighting(sighting: &Sighting, pose_observed: bool, object: &mut Object) {
    if pose_observed {
        object.confidence = sighting.confidence;
        for (i, covariance) in sighting.heading_covariance.into_iter().enumerate() {
            object.covariance[i][2] = covariance;
            object.covariance[2][i] = covariance;
        }
    }
    object.size = sighting.size;
    let corners = sighting.outline.points();
    object.outline[..corners.len()].copy_from_slice(corners);
    object.n_outline = corners.len() as u32;
}

/// Settings of the tracker, in the unit of the scene.
fn tracking(
    size: Size,
    rate_hz: f64,
    settings: &Settings,
    metres_per_px: Option<f64>,
) -> predict::Settings {
    let width = size.width as f64;
    let in_pixels = predict::Settings {
        frame_period_s: 1.0 / rate_hz,
        top_speed: settings.top_speed * width,
        gate_base: GATE_WIDTHS * width,
        marker_offset: GATE_WIDTHS * width,
        max_misses: frames_in(settings.lost_after_s, rate_hz),
        confirm: settings.confirm,
    };
    match metres_per_px {
        Some(metres_per_px) => in_pixels.scaled(metres_per_px),
        None => in_pixels,
    }
}
