//! From shapes to detections: each shape is a marked object or an obstacle (sections 2.1.2 to 2.2.3
//! of the paper).

mod attempt;
mod expected;
pub(crate) mod known;
mod searched;

use fourier::contour::{Region, region};
use imgproc::contour::{contour_capacity, fill_contour};
use imgproc::{Bounds, Size};

use crate::detection::attempt::{Attempt, Channel, Part};
use crate::detection::expected::Again;
use crate::detection::known::{KNOWN_MAX, KnownMarkers, Reading};
use crate::detection::searched::SearchedShapes;
use crate::geometry::outline::{Outline, simplified};
use crate::image::frame::Picture;
use crate::marker::colour::{intensity, project};
use crate::marker::cutout::{Cutout, CutoutScratch, find_plates};
use crate::marker::optics::{Imaging, Optics};
use crate::marker::perspective::{Perspective, Vote};
use crate::marker::search::{SearchScratch, find_figures};
use crate::marker::{Family, Recognised, RecognitionSettings};
use crate::segmentation::SeenPlate;
use crate::segmentation::shapes::{Shape, Shapes};

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

/// Minimum extent of a figure, relative to the side of its plate.
const FIGURE_MIN: f32 = 0.3;

/// A figure closer than this to the centre of a plate that was read, in sides of the plate, belongs
/// to it.
const SAME_PLATE: f64 = 0.5;

/// Maximum residual of a marker without a shape, as a share of that for others: there is no other
/// evidence for it.
const SEARCHED_RESIDUAL: f32 = 0.8;

/// Smallest plate and least contrast, in grey levels, of a marker without a shape. Its contrast is
/// limited by the noise as well.
const SEARCHED_PLATE_MIN_PX: f32 = 12.0;
const SEARCHED_CONTRAST_MIN: f32 = 8.0;

/// Maximum area of a robot, in areas of its plate.
const ROBOT_PLATES: f64 = 6.0;

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

impl Detection {
    /// Whether the marker's plate lies at a pixel.
    fn is_plate_at(&self, pixel: [f64; 2]) -> bool {
        self.marker.is_some() && distance(self.centre, pixel) < SAME_PLATE * self.size_px
    }

    /// The reading, if the marker's shape has this area.
    fn reading(&self, shape_px2: f64) -> Option<Reading> {
        self.marker.map(|marker| Reading {
            marker: marker.marker,
            centre: self.centre,
            heading_rad: f64::from(marker.heading_rad),
            plate_px: self.size_px,
            shape_px2,
        })
    }
}

/// [`ShapeOf::number`] of a marker without a shape.
const NO_SHAPE: usize = usize::MAX;

/// The shape of a detection.
#[derive(Debug, Clone, Copy)]
struct ShapeOf {
    /// Index of the shape in the frame.
    number: usize,
    region: Region,
    /// Share of the marker's plate that lies inside the shape's contour, 0 to 1.
    covered: f32,
}

/// What is read in a frame, and how.
#[derive(Clone, Copy)]
pub(crate) struct Input<'a> {
    pub(crate) picture: &'a Picture,
    pub(crate) family: &'a Family,
    /// The settings for an image position.
    pub(crate) recognition: &'a dyn Fn([f64; 2]) -> RecognitionSettings,
}

/// Memory for the detections of one frame, and the estimated optics of the camera.
#[derive(Debug)]
pub(crate) struct Detector {
    size: Size,
    polygon: Vec<[f32; 2]>,
    mask: Vec<u8>,
    grey: Vec<u8>,
    cutout: CutoutScratch,
    search: SearchScratch,
    imaging: Imaging,
    perspective: Perspective,
    votes: Vec<Vote>,
    /// Markers of the last frame that were read where they were expected.
    again: Vec<Again>,
    /// Markers that are expected and not read.
    missing: Vec<Reading>,
    searched: SearchedShapes,
    detections: Vec<Detection>,
    /// One for each detection.
    shapes: Vec<ShapeOf>,
}

impl Detector {
    /// Allocates for frames of one size.
    pub(crate) fn new(size: Size, rate_hz: f64) -> Self {
        Self {
            size,
            polygon: Vec::with_capacity(contour_capacity(size)),
            mask: vec![0; size.area()],
            grey: vec![0; size.area()],
            cutout: CutoutScratch::new(size),
            search: SearchScratch::new(size),
            imaging: Imaging::new(),
            perspective: Perspective::new(size),
            votes: Vec::with_capacity(MAX_DETECTIONS),
            again: Vec::with_capacity(KNOWN_MAX),
            missing: Vec::with_capacity(KNOWN_MAX),
            searched: SearchedShapes::new(rate_hz),
            detections: Vec::with_capacity(MAX_DETECTIONS),
            shapes: Vec::with_capacity(MAX_DETECTIONS),
        }
    }

    /// Resets the estimated optics of the camera: a new background may mean a new camera.
    pub(crate) fn forget_optics(&mut self) {
        self.imaging = Imaging::new();
        self.perspective = Perspective::new(self.size);
    }

    /// Begins a frame. `noise` is the noise of a pixel in grey levels.
    pub(crate) fn begin_frame(&mut self, noise: f32) {
        self.imaging.noise = noise;
        self.again.clear();
        self.searched.begin_frame();
    }

    /// Returns one or more detections for each shape, in reading order, and the number of shapes
    /// and markers dropped for lack of space.
    pub(crate) fn detect(&mut self, shapes: &Shapes, input: &Input<'_>) -> u32 {
        let was_known = self.imaging.is_known();
        let overflow = self.detect_in_shapes(shapes, input);
        if was_known {
            return overflow;
        }
        // What the first markers show of the camera makes themselves as exact as later ones. Once
        // only: markers that show nothing of it, such as coloured ones, are not read twice a frame.
        self.learn_imaging();
        if !self.imaging.is_known() {
            return overflow;
        }
        self.votes.clear();
        self.detect_in_shapes(shapes, input)
    }

    fn detect_in_shapes(&mut self, shapes: &Shapes, input: &Input<'_>) -> u32 {
        self.detections.clear();
        self.shapes.clear();
        let mut overflow = shapes.overflow();
        for (number, shape) in shapes.iter().enumerate() {
            overflow += if self.detections.len() < MAX_DETECTIONS {
                self.detect_in_shape(number, shape, input)
            } else {
                1
            };
        }
        self.settle_plates_of_two_shapes();
        overflow + self.add_unclaimed()
    }

    /// The detections of the frame so far.
    pub(crate) fn detections(&self) -> &[Detection] {
        &self.detections
    }

    /// The markers that were read in the frame.
    pub(crate) fn readings(&self) -> impl Iterator<Item = Reading> + Clone + '_ {
        let all = self.detections.iter().zip(&self.shapes);
        all.filter_map(|(detection, shape)| {
            let of_shape = |other: &&ShapeOf| other.number == shape.number;
            let n_markers = match shape.number {
                NO_SHAPE => 1,
                _ => self.shapes.iter().filter(of_shape).count(),
            };
            detection.reading(f64::from(shape.region.area) / n_markers as f64)
        })
    }

    /// The plates that were read in the frame.
    pub(crate) fn plates(&self) -> impl Iterator<Item = SeenPlate> + Clone + '_ {
        let all = self.detections.iter().zip(&self.shapes);
        all.filter(|(detection, _)| detection.marker.is_some())
            .map(|(detection, shape)| SeenPlate {
                centre: detection.centre,
                side_px: detection.size_px,
                has_shape: shape.number != NO_SHAPE,
            })
    }

    /// Ends a frame: updates the optics of the camera from its markers.
    pub(crate) fn end_frame(&mut self) {
        self.learn_imaging();
        let places = self.detections.iter().filter_map(|d| {
            let stretch = d.marker?.stretch?;
            Some((d.centre, stretch))
        });
        self.perspective.learn(places);
        self.perspective.vote(self.votes.drain(..));
    }

    fn learn_imaging(&mut self) {
        let read = self.detections.iter().filter_map(|d| d.marker);
        self.imaging.learn(read.filter_map(|marker| marker.imaging));
    }

    /// Searches part of the picture for markers without the background, and adds those that no
    /// shape gave. Returns the number dropped for lack of space.
    pub(crate) fn search(
        &mut self,
        bounds: Bounds,
        input: &Input<'_>,
        known: &mut KnownMarkers,
    ) -> u32 {
        let Input {
            picture,
            family,
            recognition,
        } = *input;
        let size = bounds.size();
        let (grey, mask) = (&mut self.grey[..size.area()], &mut self.mask[..size.area()]);
        intensity(picture, bounds, grey);
        mask.fill(1);
        let cutout = Cutout { size, grey, mask };
        let corner = [f64::from(bounds.left), f64::from(bounds.top)];
        let (imaging, perspective) = (self.imaging, &self.perspective);
        let (detections, votes) = (&mut self.detections, &mut self.votes);
        let mut lost = 0;
        let at_middle = recognition([
            corner[0] + size.width as f64 / 2.0,
            corner[1] + size.height as f64 / 2.0,
        ]);
        let extent_px = [FIGURE_MIN * at_middle.plate_min_px, at_middle.plate_max_px];
        find_figures(
            grey,
            size,
            imaging.noise,
            &imaging.tone(),
            extent_px,
            &mut self.search,
            |figure| {
                let centre = [0, 1].map(|i| f64::from(figure.region.centre[i]) + corner[i]);
                if detections.iter().any(|d| d.is_plate_at(centre)) {
                    return;
                }
                let settings = recognition(centre);
                let optics = Optics {
                    imaging,
                    stretch: perspective.at(centre),
                };
                let stricter = RecognitionSettings {
                    residual_ratio_max: SEARCHED_RESIDUAL * settings.residual_ratio_max,
                    plate_min_px: settings.plate_min_px.max(SEARCHED_PLATE_MIN_PX),
                    contrast_min: SEARCHED_CONTRAST_MIN,
                    ..settings
                };
                let read = family.recognise_figure(&figure, cutout, &optics, &stricter);
                if let Some(marker) = read.filter(|read| is_reading(read, corner, votes)) {
                    let found = marked(marker, corner, plate_outline(&marker, corner));
                    let reading = found.reading(found.size_px * found.size_px);
                    if reading.is_some_and(|reading| known.confirms(reading)) {
                        lost += add_searched(detections, &mut self.shapes, found);
                    }
                }
            },
        );
        lost
    }

    /// Finds the markers of one shape, or reports it as an obstacle. Returns the number dropped for
    /// lack of space.
    fn detect_in_shape(&mut self, number: usize, shape: Shape<'_>, input: &Input<'_>) -> u32 {
        let outline = simplified(shape.contour);
        self.polygon.clear();
        self.polygon.extend(
            shape
                .contour
                .iter()
                .map(|p| [f32::from(p.x), f32::from(p.y)]),
        );
        let region = region(&self.polygon);
        let first = self.detections.len();
        if self.claim(first, number, region, shape, outline) {
            return 0;
        }
        self.detections.truncate(first);
        self.shapes.truncate(first);
        let in_vain = self.searched.in_vain(&region);
        let mut lost = 0;
        for attempt in self.searched.attempts(&in_vain) {
            // What remains of a shape that is cut off may look like another marker.
            if shape.is_cut && matches!(attempt.part, Part::Shape) {
                continue;
            }
            lost = self.read_markers(attempt, shape, &region, outline, input);
            self.keep_covered(first, number, region, shape);
            if lost > 0 || self.detections.len() > first {
                break;
            }
        }
        self.claim(first, number, region, shape, outline);
        if lost == 0 && self.detections.len() == first {
            self.searched.add(in_vain);
            self.detections.push(obstacle(&region, outline));
            self.shapes.push(ShapeOf {
                number,
                region,
                covered: 0.0,
            });
        }
        lost
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
        shape: Shape<'_>,
        region: &Region,
        outline: Outline,
        input: &Input<'_>,
    ) -> u32 {
        let Input {
            picture,
            family,
            recognition,
        } = *input;
        let settings = recognition(region.centre.map(f64::from));
        let width_px = region.area.max(0.0).sqrt();
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
        let imaging = match attempt.channel {
            Channel::Intensity => {
                intensity(picture, around, grey);
                self.imaging
            }
            Channel::Colour => match project(picture, around, mask, grey) {
                Some(gain) => self.imaging.of_colour(gain),
                None => return 0,
            },
        };
        let middle = [
            f64::from(around.left) + size.width as f64 / 2.0,
            f64::from(around.top) + size.height as f64 / 2.0,
        ];
        let optics = Optics {
            imaging,
            stretch: self.perspective.at(middle),
        };
        let cutout = Cutout { size, grey, mask };
        let mut lost = 0;
        find_plates(cutout, &imaging.tone(), &mut self.cutout, |plate| {
            let corner = [f64::from(around.left), f64::from(around.top)];
            let read = family.recognise(&plate, cutout, &optics, &settings);
            let Some(marker) = read.filter(|read| is_reading(read, corner, &mut self.votes)) else {
                return false;
            };
            if self.detections.len() == MAX_DETECTIONS {
                lost += 1;
                return true;
            }
            self.detections.push(marked(marker, corner, outline));
            true
        });
        lost
    }
}

/// A marker that was read in a part of the picture whose top left pixel is at `corner`.
fn marked(marker: Recognised, corner: [f64; 2], outline: Outline) -> Detection {
    Detection {
        marker: Some(marker),
        centre: [0, 1].map(|i| f64::from(marker.centre[i]) + corner[i]),
        covariance: [0, 1].map(|i| [0, 1].map(|k| f64::from(marker.covariance[i][k]))),
        size_px: f64::from(marker.plate_px),
        outline,
    }
}

/// The outline of a plate without a shape.
fn plate_outline(marker: &Recognised, corner: [f64; 2]) -> Outline {
    Outline::square(
        [0, 1].map(|i| f64::from(marker.centre[i]) + corner[i]),
        f64::from(marker.plate_px),
        f64::from(marker.heading_rad),
    )
}

/// Whether a marker is certain. If not, it is a vote for the perspective of the camera.
fn is_reading(marker: &Recognised, corner: [f64; 2], votes: &mut Vec<Vote>) -> bool {
    if let Some(reading) = marker.stretch.filter(|_| !marker.is_certain)
        && votes.len() < MAX_DETECTIONS
    {
        votes.push(Vote {
            pixel: [0, 1].map(|i| f64::from(marker.centre[i]) + corner[i]),
            marker: marker.marker,
            heading_rad: marker.heading_rad,
            reading,
        });
    }
    marker.is_certain
}

/// Adds a marker without a shape. An obstacle around it that is not much larger than its plate is
/// the robot that carries it. Returns the number dropped for lack of space.
fn add_searched(
    detections: &mut Vec<Detection>,
    shapes: &mut Vec<ShapeOf>,
    found: Detection,
) -> u32 {
    let plate_px2 = found.size_px * found.size_px;
    let carries = |d: &Detection| {
        d.marker.is_none()
            && d.size_px * d.size_px < ROBOT_PLATES * plate_px2
            && distance(d.centre, found.centre) < 0.5 * d.size_px.max(found.size_px)
    };
    if let Some(robot) = detections.iter_mut().find(|d| carries(d)) {
        *robot = Detection {
            outline: robot.outline,
            ..found
        };
        return 0;
    }
    if detections.len() == MAX_DETECTIONS {
        return 1;
    }
    detections.push(found);
    shapes.push(ShapeOf {
        number: NO_SHAPE,
        region: Region {
            area: plate_px2 as f32,
            centre: found.centre.map(|c| c as f32),
        },
        covered: 1.0,
    });
    0
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
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
