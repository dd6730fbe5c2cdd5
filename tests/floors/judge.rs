//! What was published against what is true, counted in points: 4x4 in each pixel.

use imgproc::Size;
use scene::{Object, Scene};

use crate::body::Body;
use crate::canvas::{Canvas, SUBSAMPLES, span};

/// Share of an object's outline that must be filled by true objects, or the object is false.
const TRUE_SHARE_MIN: f64 = 0.1;

/// Overlap (intersection over union) from which an object is that body.
const SAME_OVERLAP_MIN: f64 = 0.5;

/// Distance from objects within which a pixel is an edge and says nothing about shadows.
const EDGE_PX: usize = 2;

/// Points of a rectangle of pixels; a bit for each point, row by row from the lowest bit.
#[derive(Debug, Clone)]
pub(crate) struct Region {
    left: usize,
    top: usize,
    width: usize,
    bits: Vec<u16>,
}

impl Region {
    /// Where a body stands, holes included.
    pub(crate) fn of_body(body: &Body, size: Size) -> Self {
        let reach = body.shape.reach();
        let mut region = Self::within(
            span(body.at[0], reach, size.width),
            span(body.at[1], reach, size.height),
        );
        let (left, top, width) = (region.left, region.top, region.width);
        let distance = body.distances();
        for (i, bits) in region.bits.iter_mut().enumerate() {
            let (x, y) = ((left + i % width) as f32, (top + i / width) as f32);
            // No point of a pixel is 1 px from its centre.
            *bits = match distance([x, y]) {
                1.0.. => 0,
                ..-1.0 => u16::MAX,
                _ => points()
                    .enumerate()
                    .map(|(bit, (dx, dy))| u16::from(distance([x + dx, y + dy]) <= 0.0) << bit)
                    .sum(),
            };
        }
        region
    }

    /// What a polygon encloses, by the parity of its edges to the left of a point.
    pub(crate) fn of_polygon(corners: &[[f64; 2]], size: Size) -> Self {
        let bounds = |axis: usize, length: usize| {
            let low = corners.iter().map(|c| c[axis]).fold(f64::MAX, f64::min);
            let high = corners.iter().map(|c| c[axis]).fold(f64::MIN, f64::max);
            if corners.is_empty() {
                0..0
            } else {
                span(
                    ((low + high) / 2.0) as f32,
                    ((high - low) / 2.0) as f32,
                    length,
                )
            }
        };
        let mut region = Self::within(bounds(0, size.width), bounds(1, size.height));
        let mut crossings = Vec::new();
        let rows = region.bits.len() / region.width.max(1);
        for row in 0..rows {
            for (sub, dy) in SUBSAMPLES.into_iter().enumerate() {
                let y = (region.top + row) as f64 + f64::from(dy);
                crossings.clear();
                for (i, &[x0, y0]) in corners.iter().enumerate() {
                    let [x1, y1] = corners[(i + 1) % corners.len()];
                    if (y0 <= y) != (y1 <= y) {
                        crossings.push(x0 + (y - y0) / (y1 - y0) * (x1 - x0));
                    }
                }
                crossings.sort_by(f64::total_cmp);
                for inside in crossings.as_chunks::<2>().0 {
                    region.fill(row, sub, *inside);
                }
            }
        }
        region
    }

    fn within(columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> Self {
        Self {
            left: columns.start,
            top: rows.start,
            width: columns.len(),
            bits: vec![0; columns.len() * rows.len()],
        }
    }

    /// Sets the points of one line of points between two places.
    fn fill(&mut self, row: usize, sub: usize, [from, to]: [f64; 2]) {
        let first = (from.floor().max(self.left as f64) as usize - self.left).min(self.width);
        let last = ((to + 1.0).ceil().max(self.left as f64) as usize - self.left).min(self.width);
        for column in first.min(last)..last {
            for (i, dx) in SUBSAMPLES.into_iter().enumerate() {
                let x = (self.left + column) as f64 + f64::from(dx);
                if from < x && x <= to {
                    self.bits[row * self.width + column] |= 1 << (4 * sub + i);
                }
            }
        }
    }

    /// Number of points.
    pub(crate) fn area(&self) -> u64 {
        self.bits
            .iter()
            .map(|bits| u64::from(bits.count_ones()))
            .sum()
    }

    /// Number of points that it shares with a picture's points.
    fn shared(&self, points: &[u16], picture_width: usize) -> u64 {
        self.rows(picture_width)
            .flat_map(|(start, row)| row.iter().zip(&points[start..]))
            .map(|(a, b)| u64::from((a & b).count_ones()))
            .sum()
    }

    /// Number of points that it shares with another region.
    fn shared_with(&self, other: &Self) -> u64 {
        let columns = |region: &Self| region.left..region.left + region.width;
        let rows = |region: &Self| region.top..region.top + region.bits.len() / region.width.max(1);
        let (left, right) = (
            self.left.max(other.left),
            columns(self).end.min(columns(other).end),
        );
        let (top, bottom) = (self.top.max(other.top), rows(self).end.min(rows(other).end));
        if left >= right {
            return 0;
        }
        let row = |region: &'_ Self, y: usize| {
            let start = (y - region.top) * region.width + left - region.left;
            start..start + right - left
        };
        (top..bottom)
            .flat_map(|y| {
                self.bits[row(self, y)]
                    .iter()
                    .zip(&other.bits[row(other, y)])
            })
            .map(|(a, b)| u64::from((a & b).count_ones()))
            .sum()
    }

    /// Adds its points to a picture's.
    pub(crate) fn add_to(&self, points: &mut [u16], picture_width: usize) {
        for (start, row) in self.rows(picture_width) {
            for (all, bits) in points[start..].iter_mut().zip(row) {
                *all |= bits;
            }
        }
    }

    /// Its rows, and where each begins in a picture.
    fn rows(&self, picture_width: usize) -> impl Iterator<Item = (usize, &[u16])> {
        self.bits
            .chunks_exact(self.width.max(1))
            .enumerate()
            .map(move |(y, row)| ((self.top + y) * picture_width + self.left, row))
    }
}

fn points() -> impl Iterator<Item = (f32, f32)> {
    SUBSAMPLES
        .into_iter()
        .flat_map(|dy| SUBSAMPLES.into_iter().map(move |dx| (dx, dy)))
}

/// One frame's scene beside its truth.
pub(crate) struct Judged<'a> {
    canvas: &'a Canvas,
    /// Objects that were observed, and what their outlines enclose.
    pub(crate) observed: Vec<(&'a Object, Region)>,
    /// Points that lie in some outline.
    found: Vec<u16>,
}

impl<'a> Judged<'a> {
    pub(crate) fn new(scene: &'a Scene, canvas: &'a Canvas) -> Self {
        let observed: Vec<_> = scene
            .objects()
            .iter()
            .filter(|object| object.observed())
            .map(|object| (object, Region::of_polygon(object.outline(), canvas.size)))
            .collect();
        let mut found = vec![0; canvas.size.area()];
        for (_, region) in &observed {
            region.add_to(&mut found, canvas.size.width);
        }
        Self {
            canvas,
            observed,
            found,
        }
    }

    /// Whether a body was seen as one object.
    pub(crate) fn sees(&self, body: usize) -> bool {
        let body = &self.canvas.bodies[body];
        self.observed.iter().any(|(_, region)| {
            let shared = region.shared_with(body);
            shared as f64 >= SAME_OVERLAP_MIN * (region.area() + body.area() - shared) as f64
        })
    }

    /// Observed objects where nothing stands.
    pub(crate) fn false_objects(&self) -> impl Iterator<Item = &'a Object> {
        self.observed
            .iter()
            .filter(|(_, region)| {
                let filled = region.shared(&self.canvas.truth, self.canvas.size.width);
                filled == 0 || (filled as f64) < TRUE_SHARE_MIN * region.area() as f64
            })
            .map(|(object, _)| *object)
    }

    /// Share of a body's points that are in some object.
    pub(crate) fn recall_of(&self, body: usize) -> Share {
        let body = &self.canvas.bodies[body];
        Share {
            part: body.shared(&self.found, self.canvas.size.width),
            all: body.area(),
        }
    }

    /// Share of shadow that was taken for an object, where the light left is within a range and no
    /// object's edge is near.
    pub(crate) fn shadow_taken(&self, light_left: std::ops::RangeInclusive<f32>) -> Share {
        let near = self.near_objects();
        let mut share = Share::default();
        for (i, left) in self.canvas.light_left.iter().enumerate() {
            if light_left.contains(left) && !near[i] {
                share.all += 16;
                share.part += u64::from(self.found[i].count_ones());
            }
        }
        share
    }

    fn near_objects(&self) -> Vec<bool> {
        let Size { width, height } = self.canvas.size;
        let mut near = vec![false; width * height];
        for (i, _) in self
            .canvas
            .truth
            .iter()
            .enumerate()
            .filter(|(_, bits)| **bits != 0)
        {
            let (x, y) = (i % width, i / width);
            for y in y.saturating_sub(EDGE_PX)..(y + EDGE_PX + 1).min(height) {
                near[y * width + x.saturating_sub(EDGE_PX)
                    ..y * width + (x + EDGE_PX + 1).min(width)]
                    .fill(true);
            }
        }
        near
    }
}

/// Part of a whole, summed over frames.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Share {
    part: u64,
    all: u64,
}

impl Share {
    pub(crate) fn add(&mut self, other: Self) {
        self.part += other.part;
        self.all += other.all;
    }

    /// 0 to 1. A scene that shows nothing of the kind is a mistake of the test.
    pub(crate) fn value(self) -> f64 {
        assert!(self.all > 0, "nothing was there to be counted");
        self.part as f64 / self.all as f64
    }
}

/// Objects against everything else, summed over frames.
#[derive(Debug, Default)]
pub(crate) struct MaskScore {
    hit: u64,
    truth: u64,
    found: u64,
}

impl MaskScore {
    pub(crate) fn add(&mut self, judged: &Judged) {
        for (truth, found) in judged.canvas.truth.iter().zip(&judged.found) {
            self.hit += u64::from((truth & found).count_ones());
            self.truth += u64::from(truth.count_ones());
            self.found += u64::from(found.count_ones());
        }
    }

    /// 2PR / (P + R).
    pub(crate) fn f_measure(&self) -> f64 {
        2.0 * self.hit as f64 / (self.truth + self.found).max(1) as f64
    }
}

/// Longest run of frames in a row of which something is said.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LongestRun {
    now: usize,
    pub(crate) longest: usize,
}

impl LongestRun {
    pub(crate) fn add(&mut self, happens: bool) {
        self.now = if happens { self.now + 1 } else { 0 };
        self.longest = self.longest.max(self.now);
    }
}

/// What a test demands: every figure is printed and all that fail are named together.
#[derive(Debug, Default)]
pub(crate) struct Demands {
    failed: Vec<String>,
}

impl Demands {
    pub(crate) fn demand(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.failed.push(what());
        }
    }

    pub(crate) fn check(self) {
        assert!(self.failed.is_empty(), "\n{}", self.failed.join("\n"));
    }
}

#[test]
fn polygons_are_filled_on_points() {
    let size = Size {
        width: 20,
        height: 16,
    };
    // From the edge of one pixel to the edge of another: 6 x 4 pixels of 16 points.
    let square = [[3.5, 2.5], [9.5, 2.5], [9.5, 6.5], [3.5, 6.5]];
    let region = Region::of_polygon(&square, size);
    assert_eq!(region.area(), 6 * 4 * 16);
    let mut all = vec![0; size.area()];
    region.add_to(&mut all, size.width);
    assert_eq!(all.iter().filter(|bits| **bits == u16::MAX).count(), 24);
    assert_eq!(
        (all[3 * 20 + 4], all[3 * 20 + 3], all[6 * 20 + 9]),
        (u16::MAX, 0, u16::MAX)
    );
    assert_eq!(region.shared(&all, 20), region.area());
    // Half of it, and the part of one that sticks out of the picture.
    let triangle = [[3.5, 2.5], [9.5, 6.5], [3.5, 6.5]];
    let triangle = Region::of_polygon(&triangle, size);
    assert_eq!(triangle.shared_with(&region), triangle.area());
    let half = triangle.area() as f64;
    assert!((half / (3.0 * 4.0 * 16.0) - 1.0).abs() < 0.06, "{half}");
    let outside = [[-5.0, -5.0], [1.5, -5.0], [1.5, 1.5], [-5.0, 1.5]];
    assert_eq!(Region::of_polygon(&outside, size).area(), 4 * 16);
    assert_eq!(Region::of_polygon(&[], size).area(), 0);
    assert_eq!(Region::of_polygon(&[[4.0, 4.0]], size).area(), 0);
}
