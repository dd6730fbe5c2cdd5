//! Where to search for markers without the background: near those that were just read, and in one
//! tile of the picture per frame.

use imgproc::{Bounds, Size};

use crate::settings::frames_in;

/// Number of tiles in a row and in a column. The square of it is the number of frames in which the
/// whole picture is searched once.
const TILES: usize = 6;

/// Overlap of a tile with its neighbours, so that figures at a border lie entirely in one of them.
const OVERLAP_PX: usize = 24;

/// A missing marker is searched for near its last position for this long.
const KEPT_S: f64 = 0.5;

/// Half width of a search window, in sides of the plate.
const WINDOW_PLATES: f64 = 1.25;

/// Two readings agree if heading and size differ by no more than this angle and this ratio.
const AGREEING_TURN_RAD: f32 = 0.35;
const AGREEING_SIZE: f64 = 1.15;

/// A marker is expected after this many readings. What was mistaken for one once must not go on.
const READ_MIN: u32 = 3;

/// A marker that is read where it is expected is searched for in every so many frames.
const SEARCHED_EVERY: u32 = 8;

/// Maximum number of known markers.
pub(crate) const KNOWN_MAX: usize = 2 * scene::MAX_OBJECTS;

/// A marker that was read in a frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reading {
    /// Index in the family.
    pub(crate) marker: usize,
    pub(crate) centre: [f64; 2],
    pub(crate) heading_rad: f64,
    pub(crate) plate_px: f64,
    /// Area of the shape that it lies in, divided among the markers of the shape. That of the plate
    /// without a shape.
    pub(crate) shape_px2: f64,
}

/// A marker of the last frames.
#[derive(Debug, Clone, Copy)]
struct Known {
    last: Reading,
    /// Motion per frame: x, y in pixels, turn in radians.
    motion: [f64; 3],
    /// Number of frames since it was read.
    missed: u32,
    /// Number of frames in which it was read.
    n_read: u32,
}

impl Known {
    fn new(last: Reading) -> Self {
        Self {
            last,
            motion: [0.0; 3],
            missed: 0,
            n_read: 1,
        }
    }

    /// The same marker, read again.
    fn read_again(&self, new: Reading) -> Self {
        let per_frame = 1.0 / f64::from(self.missed.max(1));
        let [dx, dy] = [0, 1].map(|i| new.centre[i] - self.last.centre[i]);
        let turn = fourier::wrapped((new.heading_rad - self.last.heading_rad) as f32);
        Self {
            last: new,
            motion: [dx, dy, f64::from(turn)].map(|d| d * per_frame),
            missed: 0,
            n_read: self.n_read.saturating_add(1),
        }
    }

    /// Where it is in this frame if it goes on as before.
    fn expected(&self) -> Reading {
        let [dx, dy, turn] = self.motion.map(|d| d * f64::from(self.missed));
        Reading {
            centre: [self.last.centre[0] + dx, self.last.centre[1] + dy],
            heading_rad: self.last.heading_rad + turn,
            ..self.last
        }
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
            kept_frames: frames_in(KEPT_S, rate_hz),
            motion_px,
            next_tile: 0,
        }
    }

    /// Adds the search windows of all known markers that are not among the readings of this frame.
    pub(crate) fn add_windows_of_missing(
        &self,
        readings: impl Iterator<Item = Reading> + Clone,
        windows: &mut Vec<Bounds>,
    ) {
        for Known { last, .. } in &self.known {
            if !readings.clone().any(|new| self.may_be(last, &new)) {
                let half = WINDOW_PLATES * last.plate_px + self.motion_px;
                windows.push(Bounds::around(last.centre, half, self.size));
            }
        }
    }

    /// Where markers are expected that were read often enough and in the last frame, and whether they
    /// are to be searched for all the same.
    pub(crate) fn again(&self) -> impl Iterator<Item = (Reading, bool)> {
        self.known
            .iter()
            .filter(|known| known.n_read >= READ_MIN && known.missed == 1)
            .map(|known| {
                let is_search_due = known.n_read.is_multiple_of(SEARCHED_EVERY);
                (known.expected(), is_search_due)
            })
    }

    /// Where markers are expected that were read often enough, but are not among the readings of this
    /// frame.
    pub(crate) fn missing(
        &self,
        readings: impl Iterator<Item = Reading> + Clone,
    ) -> impl Iterator<Item = Reading> {
        self.known
            .iter()
            .filter(|known| known.n_read >= READ_MIN)
            .filter(move |known| !readings.clone().any(|new| self.may_be(&known.last, &new)))
            .map(Known::expected)
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

    /// Whether a marker that was found without a shape agrees with one of an earlier frame. A
    /// single reading is not enough to report a marker; it is kept, and confirmed by the next one.
    pub(crate) fn confirms(&mut self, new: Reading) -> bool {
        let mut earlier = self.known.iter().filter(|known| known.missed > 0);
        let is_confirmed = earlier.any(|Known { last, .. }| {
            let turn = fourier::wrapped((new.heading_rad - last.heading_rad) as f32).abs();
            self.may_be(last, &new)
                && turn < AGREEING_TURN_RAD
                && (new.plate_px / last.plate_px).ln().abs() < AGREEING_SIZE.ln()
        });
        if !is_confirmed {
            self.add(new);
        }
        is_confirmed
    }

    /// Begins a frame.
    pub(crate) fn begin_frame(&mut self) {
        for known in &mut self.known {
            known.missed += 1;
        }
    }

    /// Ends a frame: updates the known markers with its readings.
    pub(crate) fn end_frame(&mut self, readings: impl Iterator<Item = Reading>) {
        for new in readings {
            let same = |known: &Known| known.missed > 0 && self.may_be(&known.last, &new);
            match self.known.iter().position(same) {
                Some(i) => self.known[i] = self.known[i].read_again(new),
                None => self.add(new),
            }
        }
        let kept_frames = self.kept_frames;
        self.known.retain(|known| known.missed < kept_frames);
    }

    fn add(&mut self, new: Reading) {
        if self.known.len() < KNOWN_MAX {
            self.known.push(Known::new(new));
        }
    }

    /// Whether two readings of successive frames may be the same marker.
    fn may_be(&self, last: &Reading, new: &Reading) -> bool {
        let [dx, dy] = [0, 1].map(|i| new.centre[i] - last.centre[i]);
        last.marker == new.marker && dx.hypot(dy) < new.plate_px + self.motion_px
    }
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

    fn reading(centre: [f64; 2], heading_rad: f64) -> Reading {
        Reading {
            marker: 3,
            centre,
            heading_rad,
            plate_px: 24.0,
            shape_px2: 576.0,
        }
    }

    #[test]
    fn a_reading_counts_once_a_later_one_agrees() {
        let size = Size {
            width: 320,
            height: 240,
        };
        let mut markers = KnownMarkers::new(size, 30.0, 8.0);
        let mut confirmed = |new: Reading| {
            markers.begin_frame();
            let confirms = markers.confirms(new);
            markers.end_frame(confirms.then_some(new).into_iter());
            confirms
        };
        assert!(!confirmed(reading([100.0, 80.0], 3.1)));
        assert!(!confirmed(reading([200.0, 80.0], 3.1)), "far away");
        assert!(!confirmed(reading([101.0, 80.0], 0.1)), "turned round");
        assert!(
            confirmed(reading([102.0, 80.0], -3.1)),
            "across the half turn"
        );
        assert!(confirmed(reading([104.0, 80.0], -3.0)));
    }

    #[test]
    fn a_missing_marker_is_searched_for_until_it_is_forgotten() {
        let size = Size {
            width: 320,
            height: 240,
        };
        let mut markers = KnownMarkers::new(size, 10.0, 8.0);
        let known = reading([100.0, 80.0], 0.0);
        markers.begin_frame();
        markers.end_frame([known].into_iter());
        let mut windows = Vec::new();
        markers.begin_frame();
        markers.add_windows_of_missing([known].into_iter(), &mut windows);
        assert!(windows.is_empty(), "it is read");
        for frame in 0..8 {
            windows.clear();
            markers.add_windows_of_missing(std::iter::empty(), &mut windows);
            markers.end_frame(std::iter::empty());
            markers.begin_frame();
            assert_eq!(windows.len(), usize::from(frame < 5), "frame {frame}");
        }
    }

    #[test]
    fn a_marker_is_expected_where_its_motion_leads_once_it_was_read_often() {
        let size = Size {
            width: 320,
            height: 240,
        };
        let mut markers = KnownMarkers::new(size, 10.0, 8.0);
        let at = |i: u32| reading([100.0 + 2.0 * f64::from(i), 80.0], 0.1 * f64::from(i));
        for i in 0..4 {
            markers.begin_frame();
            let expected: Vec<Reading> = markers.missing(std::iter::empty()).collect();
            assert_eq!(expected.len(), usize::from(i >= READ_MIN), "frame {i}");
            assert_eq!(
                markers.missing([at(i)].into_iter()).count(),
                0,
                "it is read"
            );
            markers.end_frame([at(i)].into_iter());
        }
        // Two frames later.
        markers.begin_frame();
        markers.end_frame(std::iter::empty());
        markers.begin_frame();
        let expected = markers.missing(std::iter::empty()).next();
        let expected = expected.expect("it was read four times");
        assert!((expected.centre[0] - at(5).centre[0]).abs() < 1e-6);
        assert!((expected.heading_rad - at(5).heading_rad).abs() < 1e-6);
    }
}
