//! From shapes to detections: every shape is a marked object or an obstacle (sections 2.1.2 to 2.2.3 of the paper).

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

/// Most detections of one frame.
pub(crate) const MAX_DETECTIONS: usize = scene::MAX_OBJECTS;

/// Variance of an obstacle's centre in either axis. Contours go in steps of a pixel; the errors of neighbouring steps are too
/// much alike to average out, so that of one step is taken (1/12), and twice that for the shadow's edge.
const OBSTACLE_VARIANCE_PX2: f64 = 0.25;

/// A marker beside a shape is none of the shape's: so much of its plate, a share, must lie in the shape's contour. The figure
/// of a marker alone covers more.
const COVERED_MIN: f32 = 0.02;

/// Two plates are one if their centres are closer than this share of their side.
const SAME_PLACE: f64 = 0.25;

/// Shapes that cover a plate equally well, but for this share of it, both lie around it.
const COVERED_ALIKE: f32 = 0.1;

/// What is looked at around a shape: this share of its width, and so many pixels more.
const MARGIN_SHARE: f32 = 0.35;
const MARGIN_PX: u16 = 3;

/// Something that stands on the floor. Image coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Detection {
    /// The marker, where one was recognised.
    pub(crate) marker: Option<Recognised>,
    /// Centre of the plate, or of the contour's area.
    pub(crate) centre: [f64; 2],
    /// Covariance of the centre, px².
    pub(crate) covariance: [[f64; 2]; 2],
    /// Side of the plate, or square root of the contour's area.
    pub(crate) size_px: f64,
    /// The whole object.
    pub(crate) outline: Outline,
}

/// The shape of a detection.
#[derive(Debug, Clone, Copy)]
struct ShapeOf {
    /// Number of the shape in the frame.
    number: usize,
    region: Region,
    /// How much of the marker's plate lies in the shape's contour, 0 to 1.
    covered: f32,
}

/// Memory for one frame's detections, and what is known of the camera's optics.
#[derive(Debug)]
pub(crate) struct Detector {
    size: Size,
    polygon: Vec<[f32; 2]>,
    mask: Vec<u8>,
    grey: Vec<u8>,
    cutout: CutoutScratch,
    optics: BlurEstimate,
    detections: Vec<Detection>,
    /// Of each detection.
    shapes: Vec<ShapeOf>,
}

impl Detector {
    /// Memory for frames of a size.
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

    /// Forgets what is known of the camera's optics: another floor may mean another camera.
    pub(crate) fn forget_blur(&mut self) {
        self.optics = BlurEstimate::new();
    }

    /// One or more detections of each shape, in reading order, and how many shapes and markers found
    /// no room. `noise` is that of a pixel, grey levels; `recognition` gives the settings for a
    /// place in the picture.
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

    /// The markers of one shape, or the obstacle that it is. Returns how many found no room.
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

    /// Of the markers from index `known` on, which one shape gave, drops those that are not its own: what is around a shape, or in its
    /// bay, may be another thing.
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

    /// A plate that two shapes gave, one around the other, belongs to that which covers it, of two to the inner one. The other shape is an
    /// obstacle, unless it has another plate.
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

    /// Whether a detection's plate belongs to the shape of another one.
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

    /// Adds the markers that one attempt of a shape shows. Returns how many found no room.
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
            // The contour of a figure is followed between pixels.
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

/// How much of the largest circle on a plate lies in a filled contour, whose mask covers `bounds`.
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

/// One way to look for markers.
#[derive(Debug, Clone, Copy)]
struct Attempt {
    part: Part,
    channel: Channel,
}

#[derive(Debug, Clone, Copy)]
enum Part {
    /// The shape alone.
    Shape,
    /// The shape and what is around it: of a marker on a plate like the floor, the marker is all that differs.
    Around,
}

#[derive(Debug, Clone, Copy)]
enum Channel {
    Intensity,
    Colour,
}

impl Attempt {
    /// In the order in which they are tried.
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
