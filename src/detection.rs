//! From the mask to detections: every shape is a marked object or an obstacle (sections 2.1.2 to 2.2.3 of the paper).

use fourier::contour::region;
use imgproc::contour::{
    Span, fill_contour, follow_contour, next_shape, remove_shape, span_capacity,
};
use imgproc::{Bounds, Point, Size};

use crate::frame::Picture;
use crate::marker::colour::{intensity, project};
use crate::marker::cutout::{Cutout, CutoutScratch, contour_capacity, find_plates};
use crate::marker::optics::Optics;
use crate::marker::{Family, Recognised, RecognitionSettings};
use crate::outline::{Outline, simplified};

/// Most detections of one frame.
pub(crate) const MAX_DETECTIONS: usize = scene::MAX_OBJECTS;

/// Variance of an obstacle's centre in either axis. Contours go in steps of a pixel; the errors of neighbouring steps are too
/// much alike to average out, so that of one step is taken (1/12), and twice that for the shadow's edge.
const OBSTACLE_VARIANCE_PX2: f64 = 0.25;

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

/// Memory for one frame's detections, and what is known of the camera's optics.
#[derive(Debug)]
pub(crate) struct Detector {
    size: Size,
    contour: Vec<Point>,
    polygon: Vec<[f32; 2]>,
    spans: Vec<Span>,
    mask: Vec<u8>,
    grey: Vec<u8>,
    cutout: CutoutScratch,
    optics: Optics,
    detections: Vec<Detection>,
}

impl Detector {
    /// Memory for frames of a size.
    pub(crate) fn new(size: Size) -> Self {
        Self {
            size,
            contour: vec![Point::default(); contour_capacity(size)],
            polygon: Vec::with_capacity(contour_capacity(size)),
            spans: vec![Span::default(); span_capacity(size)],
            mask: vec![0; size.area()],
            grey: vec![0; size.area()],
            cutout: CutoutScratch::new(size),
            optics: Optics::new(),
            detections: Vec::with_capacity(MAX_DETECTIONS),
        }
    }

    /// Forgets what is known of the camera's optics: another floor may mean another camera.
    pub(crate) fn forget_optics(&mut self) {
        self.optics = Optics::new();
    }

    /// Everything in the mask, in reading order, and how many shapes and markers found no room or had too long a contour.
    /// Uses the mask up. `noise` is that of a pixel, grey levels; `recognition` gives the settings for a place in the picture.
    pub(crate) fn detect(
        &mut self,
        mask: &mut [u8],
        picture: &Picture,
        noise: f32,
        family: &Family,
        area_min_px2: usize,
        recognition: &dyn Fn([f64; 2]) -> RecognitionSettings,
    ) -> (&[Detection], u32) {
        self.detections.clear();
        self.optics.noise = noise;
        let mut overflow = 0;
        let mut from = 0;
        while let Some(start) = next_shape(mask, self.size, from) {
            from = usize::from(start.y) * self.size.width + usize::from(start.x);
            let contour =
                follow_contour(mask, self.size, start, &mut self.contour).map(<[Point]>::len);
            let removed = remove_shape(mask, self.size, start, &mut self.spans);
            if removed.area < area_min_px2 {
                continue;
            }
            match contour {
                Ok(len) if self.detections.len() < MAX_DETECTIONS => {
                    overflow +=
                        self.detect_in_shape(len, removed.bounds, picture, family, recognition);
                }
                _ => overflow += 1,
            }
        }
        let read = self.detections.iter().filter_map(|d| d.marker);
        self.optics.learn(read.filter_map(|marker| marker.blur));
        (&self.detections, overflow)
    }

    /// The markers of one shape, or the obstacle that it is. Returns how many found no room.
    fn detect_in_shape(
        &mut self,
        contour_len: usize,
        bounds: Bounds,
        picture: &Picture,
        family: &Family,
        recognition: &dyn Fn([f64; 2]) -> RecognitionSettings,
    ) -> u32 {
        let contour = &self.contour[..contour_len];
        let outline = simplified(contour);
        self.polygon.clear();
        self.polygon
            .extend(contour.iter().map(|p| [f32::from(p.x), f32::from(p.y)]));
        let region = region(&self.polygon);
        let width_px = region.area.max(0.0).sqrt();
        let settings = recognition(region.centre.map(f64::from));
        for view in View::ALL {
            let known = self.detections.len();
            let lost = self.read_markers(
                view,
                (contour_len, bounds, width_px),
                outline,
                picture,
                family,
                &settings,
            );
            if lost > 0 || self.detections.len() > known {
                return lost;
            }
        }
        self.detections.push(Detection {
            marker: None,
            centre: region.centre.map(f64::from),
            covariance: [[OBSTACLE_VARIANCE_PX2, 0.0], [0.0, OBSTACLE_VARIANCE_PX2]],
            size_px: f64::from(width_px),
            outline,
        });
        0
    }

    /// Adds the markers that one view of a shape shows. Returns how many found no room.
    fn read_markers(
        &mut self,
        view: View,
        (contour_len, bounds, width_px): (usize, Bounds, f32),
        outline: Outline,
        picture: &Picture,
        family: &Family,
        settings: &RecognitionSettings,
    ) -> u32 {
        let margin_px = match view.part {
            // The contour of a figure is followed between pixels.
            Part::Shape => 1,
            Part::Around => (MARGIN_SHARE * width_px) as u16 + MARGIN_PX,
        };
        let around = bounds.grown(margin_px, self.size);
        let size = around.size();
        let mask = &mut self.mask[..size.area()];
        match view.part {
            Part::Shape => fill_contour(&self.contour[..contour_len], around, mask),
            Part::Around => mask.fill(1),
        }
        let grey = &mut self.grey[..size.area()];
        let optics = match view.channel {
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

/// One way to look for markers.
#[derive(Debug, Clone, Copy)]
struct View {
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

impl View {
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
