//! From shapes to detections: each shape is a marked object or an obstacle (sections 2.1.2 to 2.2.3
//! of the paper).

use fourier::contour::{Region, region};
use imgproc::contour::fill_contour;
use imgproc::{Bounds, Size};

use crate::geometry::outline::{Outline, simplified};
use crate::image::frame::Picture;
use crate::marker::colour::{intensity, project};
use crate::marker::cutout::{Cutout, CutoutScratch, find_plates};
use crate::marker::optics::BlurEstimate;
use crate::marker::{Family, Recognised, RecognitionSettings};
use crate::segmentation::shapes::{Shape, Shapes, longest_contour};

/// Maximum number of detections per frame.
pub(crate) const MAX_DETECTIONS: usize = scene::MAX_OBJECTS;

/// Variance of an obstacle's centre along each axis. Contours go in steps of a pixel. The errors of
/// neighbouring steps are too strongly correlated to average out, so the variance of one step is
/// used (1/12), and twice that for the edge of the shadow.
const OBSTACLE_VARIANCE_PX2: f64 = 0.25;

/// A marker next to a shape does not belong to it: at least this share of its plate must lie inside
/// the shape's contour. The marker figure alone covers more.
const COVERED_MIN: f32 = 0.02;

/// Two plates are the same if their centres are closer than this share of their side.
const SAME_PLACE: f64 = 0.25;

/// If the shares of a plate that two shapes cover differ by less than this, both surround it.
const COVERED_ALIKE: f32 = 0.1;

/// Margin searched around a shape: this share of its width plus a number of pixels.
const MARGIN_SHARE: f32 = 0.35;
const MARGIN_PX: u16 = 3;

/// An object on the floor, in image coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Detection {
    /// The marker, if one was recognised.
    pub(crate) marker: Option<Recognised>,
    /// Centre of the plate, or centroid of the contour.
    pub(crate) centre: [f64; 2],
    /// Covariance of the centre, px².
    pub(crate) covariance: [[f64; 2]; 2],
    /// Side of the plate, or square root of the contour's area.
    pub(crate) size_px: f64,
    /// Outline of the whole object.
    pub(crate) outline: Outline,
}

/// The shape of a detection.
#[derive(Debug, Clone, Copy)]
struct ShapeOf {
    /// Index of the shape in the frame.
    number: usize,
    region: Region,
    /// Share of the marker's plate that lies inside the shape's contour, 0 to 1.
    covered: f32,
}

/// Memory for the detections of one frame, and the estimated optics of the camera.
#[derive(Debug)]
pub(crate) struct Detector {
    size: Size,
    polygon: Vec<[f32; 2]>,
    mask: Vec<u8>,
    grey: Vec<u8>,
    cutout: CutoutScratch,
    optics: BlurEstimate,
    detections: Vec<Detection>,
    /// One for each detection.
    shapes: Vec<ShapeOf>,
}

impl Detector {
    /// Allocates for frames of one size.
    pub(crate) fn new(size: Size) -> Self {
        Self {
            size,
            polygon: Vec::with_capacity(longest_contour(size)),
            mask: vec![0; size.area()],
            grey: vec![0; size.area()],
            cutout: CutoutScratch::new(size),
            optics: BlurEstimate::new(),
            detections: Vec::with_capacity(MAX_DETECTIONS),
            shapes: Vec::with_capacity(MAX_DETECTIONS),
        }
    }

    /// Resets the estimated optics of the camera: a new background may mean a new camera.
    pub(crate) fn forget_blur(&mut self) {
        self.optics = BlurEstimate::new();
    }

    /// Returns one or more detections for each shape, in reading order, and the number of shapes
    /// and markers dropped for lack of space. `noise` is the noise of a pixel in grey levels;
    /// `recognition` gives the settings for an image position.
    pub(crate) fn detect(
        &mut self,
        shapes: &Shapes,
        picture: &Picture,
        noise: f32,
        family: &Family,
        recognition: &dyn Fn([f64; 2]) -> RecognitionSettings,
    ) -> (&[Detection], u32) {
        self.detections.clear();
        self.shapes.clear();
        self.optics.noise = noise;
        let mut overflow = shapes.overflow();
        for (number, shape) in shapes.iter().enumerate() {
            overflow += if self.detections.len() < MAX_DETECTIONS {
                self.detect_in_shape(number, shape, picture, family, recognition)
            } else {
                1
            };
        }
        self.settle_plates_of_two_shapes();
        let read = self.detections.iter().filter_map(|d| d.marker);
        self.optics.learn(read.filter_map(|marker| marker.blur));
        (&self.detections, overflow)
    }

    /// Finds the markers of one shape, or reports it as an obstacle. Returns the number dropped for
    /// lack of space.
    fn detect_in_shape(
        &mut self,
        number: usize,
        shape: Shape<'_>,
        picture: &Picture,
        family: &Family,
        recognition: &dyn Fn([f64; 2]) -> RecognitionSettings,
    ) -> u32 {
        let outline = simplified(shape.contour);
        self.polygon.clear();
        self.polygon.extend(
            shape
                .contour
                .iter()
                .map(|p| [f32::from(p.x), f32::from(p.y)]),
        );
        let region = region(&self.polygon);
        let width_px = region.area.max(0.0).sqrt();
        let settings = recognition(region.centre.map(f64::from));
        for attempt in Attempt::ALL {
            let known = self.detections.len();
            let lost = self.read_markers(
                attempt,
                (shape, width_px),
                outline,
                picture,
                family,
                &settings,
            );
            self.keep_covered(known, number, region, shape);
            if lost > 0 || self.detections.len() > known {
                return lost;
            }
        }
        self.detections.push(obstacle(&region, outline));
        self.shapes.push(ShapeOf {
            number,
            region,
            covered: 0.0,
        });
        0
    }

    /// Drops those markers found for one shape, from index `known` on, that do not belong to it:
    /// the area around a shape, or a bay of its contour, may contain another object.
    fn keep_covered(&mut self, known: usize, number: usize, region: Region, shape: Shape<'_>) {
        if self.detections.len() == known {
            return;
        }
        let bounds = shape.bounds;
        let mask = &mut self.mask[..bounds.size().area()];
        fill_contour(shape.contour, bounds, mask);
        let mut kept = known;
        for i in known..self.detections.len() {
            let covered = covered(&self.detections[i], bounds, mask);
            if covered >= COVERED_MIN {
                self.detections[kept] = self.detections[i];
                kept += 1;
                self.shapes.push(ShapeOf {
                    number,
                    region,
                    covered,
                });
            }
        }
        self.detections.truncate(kept);
    }

    /// Assigns a plate found for two shapes, one around the other, to the shape that covers it; if
    /// both do, to the inner one. The other shape is an obstacle, unless it has another plate.
    fn settle_plates_of_two_shapes(&mut self) {
        let mut i = 0;
        while i < self.detections.len() {
            if !self.is_of_another(i) {
                i += 1;
                continue;
            }
            let ShapeOf { number, region, .. } = self.shapes[i];
            if self.shapes.iter().filter(|of| of.number == number).count() > 1 {
                self.detections.remove(i);
                self.shapes.remove(i);
            } else {
                self.detections[i] = obstacle(&region, self.detections[i].outline);
                i += 1;
            }
        }
    }

    /// Whether the plate of a detection belongs to another shape.
    fn is_of_another(&self, i: usize) -> bool {
        let (own, shape) = (&self.detections[i], &self.shapes[i]);
        let others = self.detections.iter().zip(&self.shapes).enumerate();
        own.marker.is_some()
            && others.filter(|&(k, _)| k != i).any(|(k, (other, of))| {
                let [dx, dy] = [0, 1].map(|axis| own.centre[axis] - other.centre[axis]);
                let is_same = other.marker.is_some() && dx.hypot(dy) < SAME_PLACE * own.size_px;
                let more = of.covered - shape.covered;
                let is_inner = of.region.area < shape.region.area
                    || (of.region.area == shape.region.area && k < i);
                is_same && (more > COVERED_ALIKE || (more >= -COVERED_ALIKE && is_inner))
            })
    }

    /// Adds the markers that one attempt finds in a shape. Returns the number dropped for lack of
    /// space.
    fn read_markers(
        &mut self,
        attempt: Attempt,
        (shape, width_px): (Shape<'_>, f32),
        outline: Outline,
        picture: &Picture,
        family: &Family,
        settings: &RecognitionSettings,
    ) -> u32 {
        let margin_px = match attempt.part {
            // The contour of a figure is traced with sub-pixel precision.
            Part::Shape => 1,
            Part::Around => (MARGIN_SHARE * width_px) as u16 + MARGIN_PX,
        };
        let around = shape.bounds.grown(margin_px, self.size);
        let size = around.size();
        let mask = &mut self.mask[..size.area()];
        match attempt.part {
            Part::Shape => fill_contour(shape.contour, around, mask),
            Part::Around => mask.fill(1),
        }
        let grey = &mut self.grey[..size.area()];
        let optics = match attempt.channel {
            Channel::Intensity => {
                intensity(picture, around, grey);
                self.optics
            }
            Channel::Colour => match project(picture, around, mask, grey) {
                Some(gain) => self.optics.of_colour(gain),
                None => return 0,
            },
        };
        let cutout = Cutout { size, grey, mask };
        let mut lost = 0;
        find_plates(cutout, &mut self.cutout, |plate| {
            let Some(marker) = family.recognise(&plate, cutout, &optics, settings) else {
                return false;
            };
            if self.detections.len() == MAX_DETECTIONS {
                lost += 1;
                return true;
            }
            let [x, y] = marker.centre;
            self.detections.push(Detection {
                marker: Some(marker),
                centre: [
                    f64::from(x) + f64::from(around.left),
                    f64::from(y) + f64::from(around.top),
                ],
                covariance: [0, 1].map(|i| [0, 1].map(|k| f64::from(marker.covariance[i][k]))),
                size_px: f64::from(marker.plate_px),
                outline,
            });
            true
        });
        lost
    }
}

fn obstacle(region: &Region, outline: Outline) -> Detection {
    Detection {
        marker: None,
        centre: region.centre.map(f64::from),
        covariance: [[OBSTACLE_VARIANCE_PX2, 0.0], [0.0, OBSTACLE_VARIANCE_PX2]],
        size_px: f64::from(region.area.max(0.0).sqrt()),
        outline,
    }
}

/// Share of the plate's inscribed circle that lies inside a filled contour. `mask` covers `bounds`.
fn covered(detection: &Detection, bounds: Bounds, mask: &[u8]) -> f32 {
    let width = bounds.size().width;
    let radius = detection.size_px / 2.0;
    let mut n_covered = 0_u32;
    for (i, _) in mask.iter().enumerate().filter(|(_, mask)| **mask != 0) {
        let x = f64::from(bounds.left) + (i % width) as f64 - detection.centre[0];
        let y = f64::from(bounds.top) + (i / width) as f64 - detection.centre[1];
        n_covered += u32::from(x.hypot(y) <= radius);
    }
    let circle = std::f64::consts::PI * radius * radius;
    (f64::from(n_covered) / circle) as f32
}

/// One way to search for markers.
#[derive(Debug, Clone, Copy)]
struct Attempt {
    part: Part,
    channel: Channel,
}

#[derive(Debug, Clone, Copy)]
enum Part {
    /// Only the shape.
    Shape,
    /// The shape and its surroundings: if the plate has the colour of the floor, only the marker
    /// differs from it.
    Around,
}

#[derive(Debug, Clone, Copy)]
enum Channel {
    Intensity,
    Colour,
}

impl Attempt {
    /// In the order of the attempts.
    const ALL: [Self; 4] = [
        Self::new(Part::Shape, Channel::Intensity),
        Self::new(Part::Shape, Channel::Colour),
        Self::new(Part::Around, Channel::Intensity),
        Self::new(Part::Around, Channel::Colour),
    ];

    const fn new(part: Part, channel: Channel) -> Self {
        Self { part, channel }
    }
}
