//! Where to search for markers without the background: near those that were just read, and in one
//! tile of the picture per frame.

use imgproc::{Bounds, Size};

use crate::detection::{Detection, MAX_DETECTIONS};

/// Number of tiles in a row and in a column. The square of it is the number of frames in which the
/// whole picture is searched once.
const TILES: usize = 6;

/// Overlap of a tile with its neighbours, so that figures at a border lie entirely in one of them.
const OVERLAP_PX: usize = 24;

/// A missing marker is searched for near its last position for this long.
const KEPT_S: f64 = 0.5;

/// Half width of a search window, in sides of the plate.
const WINDOW_PLATES: f64 = 1.25;

/// Two readings agree if heading and size differ by no more than this between two frames: an angle, and
/// a ratio.
const AGREEING_TURN: f64 = 0.35;
const AGREEING_SIZE: f64 = 1.15;

/// Maximum number of known markers.
pub(crate) const KNOWN_MAX: usize = 2 * MAX_DETECTIONS;

/// A marker that was read.
#[derive(Debug, Clone, Copy)]
struct Known {
    marker: usize,
    centre: [f64; 2],
    heading_rad: f64,
    plate_px: f64,
    /// Number of frames since it was read.
    missed: u32,
}

impl Known {
    fn of(detection: &Detection) -> Option<Self> {
        detection.marker.map(|marker| Self {
            marker: marker.marker,
            centre: detection.centre,
            heading_rad: f64::from(marker.heading_rad),
            plate_px: detection.size_px,
            missed: 0,
        })
    }
}

/// The markers of the last frames, and the next tile.
#[derive(Debug)]
pub(crate) struct KnownMarkers {
    size: Size,
    known: Vec<Known>,
    kept_frames: u32,
    /// Maximum motion of a marker per frame, pixels.
    motion_px: f64,
    next_tile: usize,
}

impl KnownMarkers {
    /// No markers yet. `motion_px` is the maximum motion of a marker per frame.
    pub(crate) fn new(size: Size, rate_hz: f64, motion_px: f64) -> Self {
        Self {
            size,
            known: Vec::with_capacity(KNOWN_MAX),
            kept_frames: crate::settings::frames_in(KEPT_S, rate_hz),
            motion_px,
            next_tile: 0,
        }
    }

    /// Adds the search windows of all known markers that are not among the detections.
    pub(crate) fn add_windows_of_missing(
        &self,
        detections: &[Detection],
        windows: &mut Vec<Bounds>,
    ) {
        for known in &self.known {
            let reach = known.plate_px + self.motion_px;
            let is_read = detections.iter().any(|detection| {
                detection.marker.is_some_and(|m| m.marker == known.marker)
                    && distance(detection.centre, known.centre) < reach
            });
            if !is_read {
                let half = WINDOW_PLATES * known.plate_px + self.motion_px;
                windows.push(Bounds::around(known.centre, half, self.size));
            }
        }
    }

    /// The tile to be searched in this frame.
    pub(crate) fn next_tile(&mut self) -> Bounds {
        let (column, row) = (self.next_tile % TILES, self.next_tile / TILES);
        self.next_tile = (self.next_tile + 1) % (TILES * TILES);
        let Size { width, height } = self.size;
        let span = |i: usize, length: usize| {
            let from = (i * length / TILES).saturating_sub(OVERLAP_PX);
            let to = ((i + 1) * length / TILES + OVERLAP_PX).min(length);
            (from as u16, to as u16 - 1)
        };
        let ((left, right), (top, bottom)) = (span(column, width), span(row, height));
        Bounds {
            left,
            top,
            right,
            bottom,
        }
    }

    /// Whether a marker that was found without a shape agrees with one that was read before. A single
    /// reading is not enough to report a marker; it is kept, and confirmed by the next one.
    pub(crate) fn confirms(&mut self, found: &Detection) -> bool {
        let Some(new) = Known::of(found) else {
            return false;
        };
        let is_confirmed = self.known.iter().any(|known| {
            let turn = (new.heading_rad - known.heading_rad).sin().abs();
            let half_turn = (new.heading_rad - known.heading_rad).cos() < 0.0;
            known.marker == new.marker
                && known.missed > 0
                && distance(known.centre, new.centre) < new.plate_px + self.motion_px
                && turn < AGREEING_TURN.sin()
                && !half_turn
                && (new.plate_px / known.plate_px).ln().abs() < AGREEING_SIZE.ln()
        });
        if !is_confirmed && self.known.len() < KNOWN_MAX {
            self.known.push(new);
        }
        is_confirmed
    }

    /// Begins a frame.
    pub(crate) fn begin_frame(&mut self) {
        for known in &mut self.known {
            known.missed += 1;
        }
    }

    /// Updates the known markers with those of a frame.
    pub(crate) fn update(&mut self, detections: &[Detection]) {
        let (kept_frames, motion_px) = (self.kept_frames, self.motion_px);
        let read = detections.iter().filter_map(Known::of);
        for new in read {
            let same = |known: &&mut Known| {
                known.marker == new.marker
                    && known.missed > 0
                    && distance(known.centre, new.centre) < new.plate_px + motion_px
            };
            if let Some(known) = self.known.iter_mut().find(same) {
                *known = new;
            } else if self.known.len() < KNOWN_MAX {
                self.known.push(new);
            }
        }
        self.known.retain(|known| known.missed <= kept_frames);
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_the_picture() {
        let size = Size {
            width: 101,
            height: 67,
        };
        let mut covered = vec![0u8; size.area()];
        let mut markers = KnownMarkers::new(size, 30.0, 16.0);
        for _ in 0..TILES * TILES {
            let tile = markers.next_tile();
            for y in usize::from(tile.top)..=usize::from(tile.bottom) {
                let row = y * size.width;
                covered[row + usize::from(tile.left)..=row + usize::from(tile.right)].fill(1);
            }
        }
        assert!(covered.iter().all(|&covered| covered == 1));
    }
}
