//! Finds markers without a background: every dark region that light surrounds may be the figure of
//! a marker.
//!
//! A pixel is dark if it is darker than the mean of a square window around it by a few times the
//! noise. The window must be about as large as the figure, and not so large that the surroundings
//! of the plate dominate the mean. So several sizes are tried, each for figures of its own range.
//! Light and dark levels are then taken from the region and the ring around it; the contour is the
//! line half-way between them, as on a plate with a known outline
//! ([`cutout`](crate::marker::cutout)).
//!
//! This finds plates that touch, plates on larger objects, plates in shadow, and plates that are
//! part of the learned floor. The candidates are judged as strictly as all others.

use fourier::contour::region;
use imgproc::contour::{
    Span, contour_capacity, fill_contour, follow_contour, next_shape, remove_shape, span_capacity,
};
use imgproc::isoline::follow_isoline;
use imgproc::morphology::dilate_3x3;
use imgproc::split::histogram;
use imgproc::tone::ToneCurve;
use imgproc::{Bounds, Point, Size, crop};

use crate::marker::cutout::{Figure, split_light};
use crate::marker::recognition::CONTRAST_DEVIATIONS;

/// Half the width of the windows, pixels.
const REACHES_PX: [u16; 4] = [4, 12, 36, 108];

/// Range of the width or height of the figures that a window is for, relative to its half width.
const EXTENT_MIN: f32 = 0.4;
const EXTENT_MAX: f32 = 2.2;

/// Minimum area of a figure. The smallest figure on a plate of ten pixels covers about as many.
const AREA_MIN_PX2: usize = 9;

/// A dark pixel is darker than the mean of its window by this many standard deviations of the
/// noise, and by at least two grey levels because of rounding.
const DARK_DEVIATIONS: f32 = 3.0;
const DARK_MIN: f32 = 2.0;

/// Width of the ring around a figure that must be light, and the minimum share of light pixels in
/// it.
const RING_PX: u16 = 2;
const RING_LIGHT_MIN: f32 = 0.8;

/// Two windows show the same figure within this distance of the centres and ratio of the areas.
const SAME_PX: f32 = 1.5;
const SAME_AREA: f32 = 1.3;

/// Maximum number of figures that are remembered during a search.
const TRIED_MAX: usize = 128;

/// Scratch memory for a search. Its content does not influence results.
#[derive(Debug)]
pub(crate) struct SearchScratch {
    /// Sum of all grey levels above and to the left (integral image).
    sums: Vec<u32>,
    dark: Vec<u8>,
    shape: Vec<u8>,
    ring: Vec<u8>,
    grey: Vec<u8>,
    points: Vec<Point>,
    spans: Vec<Span>,
    isoline: Vec<[f32; 2]>,
    tried: Vec<([f32; 2], f32)>,
}

impl SearchScratch {
    /// Allocates for pictures of at most this size.
    pub(crate) fn new(size: Size) -> Self {
        let bytes = || vec![0; size.area()];
        Self {
            sums: vec![0; (size.width + 1) * (size.height + 1)],
            dark: bytes(),
            shape: bytes(),
            ring: bytes(),
            grey: bytes(),
            points: vec![Point::default(); contour_capacity(size)],
            spans: vec![Span::default(); span_capacity(size)],
            isoline: vec![[0.0; 2]; 2 * contour_capacity(size)],
            tried: Vec::with_capacity(TRIED_MAX),
        }
    }
}

/// Calls `found` with every dark figure that light surrounds. `noise` is the standard deviation of
/// a pixel in grey levels, `tone` the camera's tone curve, `extent_px` the range of the larger of width and height of a figure.
pub(crate) fn find_figures(
    grey: &[u8],
    size: Size,
    noise: f32,
    tone: &ToneCurve,
    extent_px: [f32; 2],
    scratch: &mut SearchScratch,
    mut found: impl FnMut(Figure<'_>),
) {
    sum_up(grey, size, &mut scratch.sums);
    scratch.tried.clear();
    let margin = (DARK_DEVIATIONS * noise).max(DARK_MIN);
    for reach in REACHES_PX {
        let [min, max] = [
            (EXTENT_MIN * f32::from(reach)).max(extent_px[0]),
            (EXTENT_MAX * f32::from(reach)).min(extent_px[1]),
        ];
        if min > max || usize::from(reach) > size.width.max(size.height) {
            continue;
        }
        mark_dark(grey, size, reach, margin, &scratch.sums, &mut scratch.dark);
        let mut from = 0;
        while let Some(start) = next_shape(&scratch.dark[..size.area()], size, from) {
            from = usize::from(start.y) * size.width + usize::from(start.x);
            let dark = &mut scratch.dark[..size.area()];
            let contour = follow_contour(dark, size, start, &mut scratch.points)
                .map(<[Point]>::len)
                .ok();
            let removed = remove_shape(dark, size, start, &mut scratch.spans);
            let extent = removed.bounds.size();
            let extent = extent.width.max(extent.height) as f32;
            let Some(len) = contour else { continue };
            if removed.area < AREA_MIN_PX2
                || !(min..=max).contains(&extent)
                || touches_border(removed.bounds, size)
            {
                continue;
            }
            if let Some(figure) = figure(grey, size, noise, tone, len, removed.bounds, scratch) {
                found(figure);
            }
        }
    }
}

/// The figure of a dark shape, whose contour is at the start of the scratch's points.
fn figure<'a>(
    grey: &[u8],
    size: Size,
    noise: f32,
    tone: &ToneCurve,
    contour_len: usize,
    bounds: Bounds,
    scratch: &'a mut SearchScratch,
) -> Option<Figure<'a>> {
    let around = bounds.grown(RING_PX, size);
    let area = around.size().area();
    let [shape, ring, part] =
        [&mut scratch.shape, &mut scratch.ring, &mut scratch.grey].map(|plane| &mut plane[..area]);
    fill_contour(&scratch.points[..contour_len], around, shape);
    dilate_3x3(shape, around.size(), ring);
    // The shape and the ring around it.
    let inner = shape.iter().map(|&s| usize::from(s)).sum::<usize>();
    dilate_3x3(ring, around.size(), shape);
    crop(grey, size, around, part);
    let split = split_light(&histogram(part, shape), tone)?;
    if split.light - split.dark < CONTRAST_DEVIATIONS * noise {
        return None;
    }
    let width = around.size().width;
    let is_dark = |i: usize| f32::from(part[i]) < split.threshold;
    let n_dark = (0..area).filter(|&i| shape[i] != 0 && is_dark(i)).count();
    // Some dark pixels in the ring belong to the blurred edge of the figure.
    let n_ring = shape.iter().map(|&s| usize::from(s)).sum::<usize>() - inner;
    let ring_dark = n_dark.saturating_sub(inner) as f32;
    if ring_dark > (1.0 - RING_LIGHT_MIN) * n_ring as f32 {
        return None;
    }
    let first = (1..area).find(|&i| {
        !i.is_multiple_of(width) && shape[i] & shape[i - 1] != 0 && is_dark(i) && !is_dark(i - 1)
    })?;
    let start = Point {
        x: around.left + (first % width) as u16,
        y: around.top + (first / width) as u16,
    };
    let contour = follow_isoline(grey, size, start, split.threshold, &mut scratch.isoline).ok()?;
    let region = region(contour);
    // A contour that leaves the figure encloses more than its dark pixels.
    let plausible = region.area > 0.5 * n_dark as f32 && region.area < 1.5 * n_dark as f32 + 8.0;
    let same = |&(centre, area): &([f32; 2], f32)| {
        let [dx, dy] = [0, 1].map(|i| centre[i] - region.centre[i]);
        dx.hypot(dy) < SAME_PX && (area / region.area).max(region.area / area) < SAME_AREA
    };
    if !plausible || scratch.tried.iter().any(same) {
        return None;
    }
    if scratch.tried.len() < TRIED_MAX {
        scratch.tried.push((region.centre, region.area));
    }
    Some(Figure { contour, region })
}

/// Computes the integral image: for every corner between pixels the sum of all grey levels above
/// and to the left of it.
fn sum_up(grey: &[u8], size: Size, sums: &mut [u32]) {
    let stride = size.width + 1;
    sums[..stride].fill(0);
    for (y, row) in grey.chunks_exact(size.width).enumerate() {
        let (before, here) = sums[y * stride..].split_at_mut(stride);
        here[0] = 0;
        let mut sum = 0;
        for (x, &grey) in row.iter().enumerate() {
            sum += u32::from(grey);
            // May wrap in huge pictures; differences over a window are still correct.
            here[x + 1] = before[x + 1].wrapping_add(sum);
        }
    }
}

/// Marks pixels that are darker than the mean of their window by more than `margin`. Windows are
/// clipped at the border of the picture.
fn mark_dark(grey: &[u8], size: Size, reach: u16, margin: f32, sums: &[u32], dark: &mut [u8]) {
    let reach = usize::from(reach);
    let stride = size.width + 1;
    let margin = (margin * 16.0) as u32;
    for y in 0..size.height {
        let (top, bottom) = (y.saturating_sub(reach), (y + reach + 1).min(size.height));
        let (above, below) = (&sums[top * stride..], &sums[bottom * stride..]);
        let row = y * size.width..(y + 1) * size.width;
        for (x, (dark, &grey)) in dark[row.clone()].iter_mut().zip(&grey[row]).enumerate() {
            let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(size.width));
            let n = ((bottom - top) * (right - left)) as u32;
            let sum = below[right]
                .wrapping_add(above[left])
                .wrapping_sub(below[left])
                .wrapping_sub(above[right]);
            let limit = u64::from(16 * u32::from(grey) + margin) * u64::from(n);
            *dark = u8::from(limit < 16 * u64::from(sum));
        }
    }
}

fn touches_border(bounds: Bounds, size: Size) -> bool {
    bounds.left == 0
        || bounds.top == 0
        || usize::from(bounds.right) + 1 >= size.width
        || usize::from(bounds.bottom) + 1 >= size.height
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size {
        width: 90,
        height: 60,
    };

    /// Draws rectangles on top of each other, (left, top, right, bottom, grey), and returns areas
    /// and centres of the figures found.
    fn figures(floor: u8, rectangles: &[(usize, usize, usize, usize, u8)]) -> Vec<(f32, [f32; 2])> {
        let mut grey = vec![floor; SIZE.area()];
        for &(left, top, right, bottom, value) in rectangles {
            for y in top..=bottom {
                grey[y * SIZE.width + left..=y * SIZE.width + right].fill(value);
            }
        }
        let mut found = Vec::new();
        let mut scratch = SearchScratch::new(SIZE);
        let tone = ToneCurve::new(1.0);
        find_figures(
            &grey,
            SIZE,
            1.0,
            &tone,
            [3.0, 60.0],
            &mut scratch,
            |figure| {
                found.push((figure.region.area, figure.region.centre));
            },
        );
        found
    }

    fn assert_is_at(figures: &[(f32, [f32; 2])], area: f32, centre: [f32; 2]) {
        let hit = figures.iter().any(|(found, at)| {
            (found - area).abs() < 3.0
                && (at[0] - centre[0]).abs() < 0.2
                && (at[1] - centre[1]).abs() < 0.2
        });
        assert!(hit, "{area} at {centre:?}: {figures:?}");
    }

    #[test]
    fn figures_on_plates_are_found_on_any_floor() {
        for floor in [0, 100, 200, 220, 255] {
            let found = figures(floor, &[(15, 10, 44, 39, 220), (25, 15, 34, 34, 40)]);
            assert_is_at(&found, 200.0, [29.5, 24.5]);
        }
    }

    #[test]
    fn plates_that_touch_are_two() {
        let found = figures(
            100,
            &[
                (15, 10, 34, 29, 220),
                (20, 14, 28, 24, 40),
                (35, 12, 54, 31, 220),
                (41, 16, 49, 26, 40),
            ],
        );
        assert_is_at(&found, 99.0, [24.0, 19.0]);
        assert_is_at(&found, 99.0, [45.0, 21.0]);
    }

    #[test]
    fn contrast_is_measured_in_noise() {
        let faint = |ink| figures(60, &[(15, 10, 34, 29, 70), (20, 14, 28, 24, ink)]);
        assert_is_at(&faint(55), 99.0, [24.0, 19.0]);
        assert!(faint(67).is_empty());
    }

    #[test]
    fn sums_are_those_of_the_pixels_above_and_to_the_left() {
        let grey: Vec<u8> = (0..SIZE.area()).map(|i| (i * 37 % 251) as u8).collect();
        let mut sums = vec![7; (SIZE.width + 1) * (SIZE.height + 1)];
        sum_up(&grey, SIZE, &mut sums);
        for (x, y) in [(0, 0), (5, 0), (0, 9), (1, 1), (90, 60), (33, 41)] {
            let expected: u32 = (0..y)
                .flat_map(|row| &grey[row * SIZE.width..row * SIZE.width + x])
                .map(|&grey| u32::from(grey))
                .sum();
            assert_eq!(sums[y * (SIZE.width + 1) + x], expected);
        }
    }
}
