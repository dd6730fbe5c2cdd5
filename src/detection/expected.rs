//! Markers that are known from the last frames: read again before anything is searched, and searched
//! for under a cover at last.

use fourier::contour::Region;
use imgproc::Bounds;

use super::known::{KnownMarkers, Reading};
use super::{Detection, Detector, Input, MAX_DETECTIONS, add_searched, marked, plate_outline};
use crate::geometry::outline::Outline;
use crate::marker::colour::intensity;
use crate::marker::cutout::Cutout;
use crate::marker::optics::Optics;
use crate::marker::{Expected, Family, Recognised, RecognitionSettings};
use crate::segmentation::shapes::Shape;

/// Half the diagonal of a plate, in units of its side, and what an expected plate may be off.
const HALF_DIAGONAL: f64 = 0.71;
const MARGIN_PX: f64 = 4.0;

/// Nothing new is in a shape if its width exceeds that of its markers' last shapes by no more than
/// this share and a number of pixels.
const GROWN: (f64, f64) = (0.03, 1.0);

/// A marker that was read where it was expected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Again {
    detection: Detection,
    /// Its share of the area of its shape in the last frame.
    shape_px2: f64,
    /// Its shape is searched all the same, now and then: for what came into it, and to compare the
    /// marker with others.
    is_search_due: bool,
}

/// How an expected marker is read.
type Recognise =
    fn(&Family, &Expected, Cutout<'_>, &Optics, &RecognitionSettings) -> Option<Recognised>;

impl Detector {
    /// Reads the markers of the last frame where they are expected. The shapes of this frame claim
    /// them.
    pub(crate) fn read_again(&mut self, known: &KnownMarkers, input: &Input<'_>) {
        for (expected, is_search_due) in known.again() {
            let read = self.read_expected(&expected, input, Family::recognise_again);
            self.again.extend(read.map(|detection| Again {
                detection,
                shape_px2: expected.shape_px2,
                is_search_due,
            }));
        }
    }

    /// Adds the markers read again that lie in a shape and that a search of it, from index `first` on,
    /// did not find. Returns whether they are all that is in the shape.
    pub(super) fn claim(
        &mut self,
        first: usize,
        number: usize,
        region: Region,
        shape: Shape<'_>,
        outline: Outline,
    ) -> bool {
        let n_found = self.detections.len();
        for again in &self.again {
            let Detection { centre, .. } = again.detection;
            let found = &self.detections[first..];
            if is_near(shape.bounds, &again.detection)
                && self.detections.len() < MAX_DETECTIONS
                && !found.iter().any(|found| found.is_plate_at(centre))
            {
                self.detections.push(Detection {
                    outline,
                    ..again.detection
                });
            }
        }
        self.keep_covered(n_found, number, region, shape);
        let claimed = &self.detections[n_found..];
        let is_claimed =
            |again: &&Again| claimed.iter().any(|d| d.centre == again.detection.centre);
        let (mut shape_px2, mut is_search_due) = (0.0, claimed.is_empty());
        for again in self.again.iter().filter(is_claimed) {
            shape_px2 += again.shape_px2;
            is_search_due |= again.is_search_due;
        }
        let (share, px) = GROWN;
        let width_max = (1.0 + share) * shape_px2.sqrt() + px;
        !is_search_due && f64::from(region.area) <= width_max * width_max
    }

    /// Adds the markers read again that are in no shape. Returns the number dropped for lack of space.
    pub(super) fn add_unclaimed(&mut self) -> u32 {
        let mut lost = 0;
        for i in 0..self.again.len() {
            let found = self.again[i].detection;
            if !self.detections.iter().any(|d| d.is_plate_at(found.centre)) {
                lost += add_searched(&mut self.detections, &mut self.shapes, found);
            }
        }
        lost
    }

    /// Adds markers that are where they are expected although a part of the plate is covered. Returns
    /// the number dropped for lack of space.
    pub(crate) fn read_covered(&mut self, known: &KnownMarkers, input: &Input<'_>) -> u32 {
        let mut missing = std::mem::take(&mut self.missing);
        missing.extend(known.missing(self.readings()));
        let mut lost = 0;
        for expected in missing.drain(..) {
            let is_taken = |d: &Detection| d.is_plate_at(expected.centre);
            if self.detections.iter().any(is_taken) {
                continue;
            }
            if let Some(found) = self.read_expected(&expected, input, Family::recognise_covered) {
                lost += add_searched(&mut self.detections, &mut self.shapes, found);
            }
        }
        self.missing = missing;
        lost
    }

    fn read_expected(
        &mut self,
        expected: &Reading,
        input: &Input<'_>,
        recognise: Recognise,
    ) -> Option<Detection> {
        let half_px = HALF_DIAGONAL * expected.plate_px + MARGIN_PX;
        let bounds = Bounds::around(expected.centre, half_px, self.size);
        let size = bounds.size();
        let (grey, mask) = (&mut self.grey[..size.area()], &mut self.mask[..size.area()]);
        intensity(input.picture, bounds, grey);
        mask.fill(1);
        let corner = [f64::from(bounds.left), f64::from(bounds.top)];
        let optics = Optics {
            imaging: self.imaging,
            stretch: self.perspective.at(expected.centre),
        };
        let marker = recognise(
            input.family,
            &Expected {
                marker: expected.marker,
                centre: [0, 1].map(|i| (expected.centre[i] - corner[i]) as f32),
                heading_rad: expected.heading_rad as f32,
                plate_px: expected.plate_px as f32,
            },
            Cutout { size, grey, mask },
            &optics,
            &(input.recognition)(expected.centre),
        );
        marker.map(|marker| marked(marker, corner, plate_outline(&marker, corner)))
    }
}

/// Whether a plate may touch a rectangle.
fn is_near(bounds: Bounds, plate: &Detection) -> bool {
    let reach = plate.size_px / 2.0;
    let spans = [(bounds.left, bounds.right), (bounds.top, bounds.bottom)];
    plate
        .centre
        .iter()
        .zip(spans)
        .all(|(&at, (from, to))| (f64::from(from) - reach..=f64::from(to) + reach).contains(&at))
}
