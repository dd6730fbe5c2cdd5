//! One camera: from a frame to the objects on the floor, in the unit and coordinate frame of the
//! scene.
//!
//! A view holds its camera's background, region, optics and calibration, and no tracks. With
//! several cameras there will be one view per camera. Lens and height will be part of its
//! calibration.

use imgproc::{Bounds, Size};
use predict::{Heading, Observation};

use crate::background::learner::Learner;
use crate::background::model::BackgroundModel;
use crate::background::region::Region;
use crate::detection::known::{KNOWN_MAX, KnownMarkers};
use crate::detection::{Detection, Detector, Input, MAX_DETECTIONS};
use crate::geometry::calibration::{Calibration, FloorPoint};
use crate::geometry::outline::Outline;
use crate::image::frame::{DecodeError, Frame, Picture, decode};
use crate::marker::Family;
use crate::segmentation::{Light, Segmented, Segmenter};
use crate::settings::Settings;

/// Positions farther from the origin are dropped: near the horizon one pixel covers many metres.
const FLOOR_MAX_M: f64 = 1e6;

/// One camera, with all the memory needed to process its frames.
#[derive(Debug)]
pub(crate) struct View {
    rate_hz: f64,
    settings: Settings,
    family: Family,
    calibration: Option<Calibration>,
    /// `None` until a background is known.
    segmenter: Option<Box<Segmenter>>,
    learning: Learning,
    region: Option<Region>,
    picture: Picture,
    detector: Detector,
    known: KnownMarkers,
    /// Parts of the picture to be searched for markers in this frame.
    windows: Vec<Bounds>,
    /// The floor is new: the whole picture is searched for markers that it may contain.
    is_floor_new: bool,
    sightings: Vec<Sighting>,
}

/// Progress of learning the empty floor.
#[derive(Debug)]
enum Learning {
    Idle,
    /// Frames are being collected.
    Collecting(Box<Learner>),
    /// Learned with the last frame; used from the next one on.
    Done(BackgroundModel),
}

/// The objects observed in one frame.
#[derive(Debug)]
pub(crate) struct Sightings<'a> {
    /// In reading order, without those beyond the horizon.
    pub(crate) all: &'a [Sighting],
    /// Number of shapes and markers dropped for lack of space.
    pub(crate) overflow: u32,
    pub(crate) light: Light,
    /// Brightness of the frame relative to the background: red, green, blue.
    pub(crate) gain: [f32; 3],
}

/// An object observed in a frame. In metres on the floor with a calibration, otherwise in image
/// pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sighting {
    /// Input of the tracker.
    pub(crate) observation: Observation,
    /// Side of the plate, or square root of the area.
    pub(crate) size: f64,
    /// Corners beyond the horizon are left out.
    pub(crate) outline: Outline,
    /// Confidence of the marker recognition, 0 to 1; 0 without a marker.
    pub(crate) confidence: f64,
    /// Covariances of x and y with the heading; 0 without a marker.
    pub(crate) heading_covariance: [f64; 2],
}

impl View {
    /// A view for frames of one size.
    pub(crate) fn new(
        size: Size,
        rate_hz: f64,
        settings: Settings,
        family: Family,
        calibration: Option<Calibration>,
    ) -> Self {
        Self {
            rate_hz,
            family,
            calibration,
            segmenter: None,
            learning: Learning::Collecting(Box::new(Learner::new(size, settings.learn))),
            region: None,
            picture: Picture::new(size),
            detector: Detector::new(size, rate_hz),
            known: KnownMarkers::new(
                size,
                rate_hz,
                settings.top_speed * size.width as f64 / rate_hz,
            ),
            windows: Vec::with_capacity(KNOWN_MAX + 1),
            is_floor_new: false,
            sightings: Vec::with_capacity(MAX_DETECTIONS),
            settings,
        }
    }

    /// Restricts detection to a region of the frames, or removes the restriction.
    ///
    /// # Panics
    ///
    /// If the size of the region differs from that of the frames.
    pub(crate) fn set_region(&mut self, region: Option<Region>) {
        if let Some(region) = &region {
            assert_eq!(
                region.size(),
                self.picture.size,
                "a region has another size"
            );
        }
        self.region = region;
    }

    /// Starts learning the empty floor again, unless learning is already in progress.
    pub(crate) fn relearn(&mut self) {
        if !self.is_learning() {
            let learner = Learner::new(self.picture.size, self.settings.learn);
            self.learning = Learning::Collecting(Box::new(learner));
        }
    }

    /// Whether a background is being learned that is not yet in use.
    pub(crate) fn is_learning(&self) -> bool {
        !matches!(self.learning, Learning::Idle)
    }

    /// While learning: the number of frames collected so far and the number needed.
    pub(crate) fn learning_progress(&self) -> Option<(u32, u32)> {
        match &self.learning {
            Learning::Collecting(learner) => Some((learner.seen(), learner.frames())),
            Learning::Done(_) | Learning::Idle => None,
        }
    }

    /// The current background, with all updates; `None` before there is one. Allocates.
    pub(crate) fn floor(&self) -> Option<BackgroundModel> {
        self.segmenter.as_ref().map(|segmenter| segmenter.floor())
    }

    /// Decodes a frame and switches to the background that applies from this frame on: `background`
    /// if it is given. A background learned with the previous frame is stored there. Returns
    /// whether the background changed.
    ///
    /// # Errors
    ///
    /// [`DecodeError`] if the frame cannot be decoded; nothing is changed.
    ///
    /// # Panics
    ///
    /// If the size of the background differs from that of the frames.
    pub(crate) fn take(
        &mut self,
        frame: &Frame,
        background: &mut Option<BackgroundModel>,
    ) -> Result<bool, DecodeError> {
        decode(frame, &mut self.picture)?;
        self.learn(background);
        let Some(floor) = background else {
            return Ok(false);
        };
        self.detector.forget_optics();
        self.is_floor_new = true;
        match &mut self.segmenter {
            Some(segmenter) => segmenter.set_background(floor),
            None => self.segmenter = Some(Box::new(Segmenter::new(floor, self.rate_hz))),
        }
        Ok(true)
    }

    /// Learns from the decoded frame. The first background that comes with a frame cancels
    /// learning.
    fn learn(&mut self, background: &mut Option<BackgroundModel>) {
        if background.is_some() && self.segmenter.is_none() {
            self.learning = Learning::Idle;
        }
        self.learning = match std::mem::replace(&mut self.learning, Learning::Idle) {
            Learning::Done(mut floor) => {
                if let Some(segmenter) = &mut self.segmenter {
                    segmenter.keep_floor_under_objects(&mut floor);
                }
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
    }

    /// The objects on the floor in the last decoded frame; `None` while there is no background.
    pub(crate) fn look(&mut self) -> Option<Sightings<'_>> {
        let segmenter = self.segmenter.as_mut()?;
        let Segmented {
            shapes,
            light,
            gains,
            noise,
        } = segmenter.segment(
            &self.picture,
            self.region.as_ref(),
            &self.settings.segmentation(),
        );
        let calibration = self.calibration.as_ref();
        let recognition = |at_px| {
            let floor = calibration.and_then(|calibration| on_floor(calibration, at_px));
            self.settings
                .recognition(floor.map(|floor| floor.metres_per_px()))
        };
        let input = Input {
            picture: &self.picture,
            family: &self.family,
            recognition: &recognition,
        };
        self.known.begin_frame();
        self.detector.begin_frame(noise);
        if light != Light::Dark {
            self.detector.read_again(&self.known, &input);
        }
        let mut overflow = self.detector.detect(shapes, &input);
        if light != Light::Dark {
            let first = if std::mem::take(&mut self.is_floor_new) {
                input.picture.size.bounds()
            } else {
                self.known.next_tile()
            };
            self.windows.clear();
            self.windows.push(first);
            self.known
                .add_windows_of_missing(self.detector.readings(), &mut self.windows);
            for &bounds in &self.windows {
                overflow += self.detector.search(bounds, &input, &mut self.known);
            }
            overflow += self.detector.read_covered(&self.known, &input);
        }
        self.detector.end_frame();
        let detections = self.detector.detections();
        self.known.end_frame(self.detector.readings());
        segmenter.note_markers(self.detector.plates());
        self.sightings.clear();
        let sighted = detections.iter().filter_map(|d| sight(d, calibration));
        self.sightings.extend(sighted);
        Some(Sightings {
            all: &self.sightings,
            overflow,
            light,
            gain: [gains.red, gains.green, gains.blue],
        })
    }
}

/// A detection in the unit of the scene; `None` if it is not on the floor.
fn sight(detection: &Detection, calibration: Option<&Calibration>) -> Option<Sighting> {
    match calibration {
        None => Some(in_picture(detection)),
        Some(calibration) => projected(detection, calibration),
    }
}

fn in_picture(detection: &Detection) -> Sighting {
    let [x, y] = detection.centre;
    let (reach, area) = detection.outline.extent(detection.centre);
    Sighting {
        observation: Observation {
            x,
            y,
            covariance: detection.covariance,
            heading: heading(detection),
            marker: detection.marker.map(|marker| marker.marker as u32),
            reach,
            area,
        },
        size: detection.size_px,
        outline: detection.outline,
        confidence: confidence(detection),
        heading_covariance: heading_covariance_px(detection).unwrap_or_default(),
    }
}

fn projected(detection: &Detection, calibration: &Calibration) -> Option<Sighting> {
    let floor = on_floor(calibration, detection.centre)?;
    let metres_per_px = floor.metres_per_px();
    let in_picture = in_picture(detection);
    let heading_px = in_picture.observation.heading;
    let heading_covariance =
        heading_covariance_px(detection)
            .zip(detection.marker)
            .map(|(covariance, marker)| {
                floor.covariance_with_heading(f64::from(marker.heading_rad), covariance)
            });
    let [x, y] = floor.at;
    Some(Sighting {
        observation: Observation {
            x,
            y,
            covariance: floor.covariance(detection.covariance),
            heading: heading_px.map(|heading| {
                let (rad, growth) = floor.heading(heading.rad);
                Heading {
                    rad,
                    variance: heading.variance * growth * growth,
                }
            }),
            reach: in_picture.observation.reach * metres_per_px,
            area: in_picture.observation.area * metres_per_px * metres_per_px,
            ..in_picture.observation
        },
        size: detection.size_px * metres_per_px,
        outline: detection
            .outline
            .mapped(|pixel| on_floor(calibration, pixel).map(|floor| floor.at)),
        heading_covariance: heading_covariance.unwrap_or_default(),
        ..in_picture
    })
}

fn heading(detection: &Detection) -> Option<Heading> {
    detection.marker.map(|marker| Heading {
        rad: f64::from(marker.heading_rad),
        variance: f64::from(marker.covariance[2][2]),
    })
}

fn confidence(detection: &Detection) -> f64 {
    detection
        .marker
        .map_or(0.0, |marker| f64::from(marker.confidence))
}

fn heading_covariance_px(detection: &Detection) -> Option<[f64; 2]> {
    detection
        .marker
        .map(|marker| [0, 1].map(|i| f64::from(marker.covariance[i][2])))
}

fn on_floor(calibration: &Calibration, pixel: [f64; 2]) -> Option<FloorPoint> {
    calibration
        .to_floor(pixel)
        .filter(|floor| floor.at.iter().all(|c| c.abs() < FLOOR_MAX_M))
}
