//! From the pixels of one shape to the contours of the dark figures on its bright plates (section
//! 2.2.1 of the paper).
//!
//! 1. The histogram of the shape's pixels gives the levels of light and dark; the threshold is
//!    where the light is half-way between theirs ([`ToneCurve`]).
//! 2. Every light region is a plate that may carry a marker. Its filled contour includes the dark
//!    pixels inside it.
//! 3. The threshold is computed again inside the plate, without rim, robot and floor. The largest
//!    dark region surrounded by light is the marker.
//! 4. The light and dark levels are computed once more, around the marker; its contour is the
//!    isoline half-way between them.
//!
//! A figure that reaches the border of its plate is not surrounded by light. If nothing else was
//! found in a shape, the whole shape is treated as a plate, and its surroundings as light.
//!
//! On a plate of a dozen pixels, blur removes the light between the figure and a dark area next to
//! the plate. The figure then has no contour, but the plate is still a square, whose position and
//! rotation are a start for the fit ([`Square`]).
//!
//! # Differences from the paper
//!
//! * The paper uses one threshold and takes the dark pixels for the marker. A coloured or dark rim
//!   of the plate, or a robot darker than the marker, then becomes part of it, and nothing is
//!   recognised. Here a marker is what is dark *inside* something light.
//! * Opening and closing after thresholding erase structures narrower than 3 pixels: all of a small
//!   marker, and the white border of a larger one. They are applied to the dark regions of plates
//!   from [`OPENING_MIN_PX`] on, and only to select the marker; the contour follows the grey
//!   values.

use fourier::contour::{Region, region};
use imgproc::contour::{
    Removed, Span, contour_capacity, fill_contour, follow_contour, next_shape, remove_shape,
    span_capacity,
};
use imgproc::fit::Within;
use imgproc::isoline::follow_isoline;
use imgproc::morphology::{close_3x3, open_3x3};
use imgproc::split::{Histogram, Split, histogram, split};
use imgproc::tone::ToneCurve;
use imgproc::{Bounds, Point, Size, crop};

/// Minimum width and height of a plate for opening and closing.
const OPENING_MIN_PX: usize = 40;

/// Minimum light area of a plate.
const LIGHT_MIN_PX2: usize = 24;

/// Maximum aspect ratio of a square.
const SQUARE_MAX: f32 = 1.35;

/// In a shape of at most this width and height, the light pixels may be one plate in several
/// pieces.
const BROKEN_MAX_PX: usize = 40;

/// Directions tested for the sides of a square, over a quarter turn.
const DIRECTIONS: usize = 18;

/// Subdivisions between two of them, for an exact direction.
const FINE: usize = 20;

/// Minimum share of its plate's contour that a marker covers.
const MARKER_SHARE_MIN: f32 = 0.04;

/// Minimum difference between light and dark, grey levels.
const CONTRAST_MIN: f32 = 30.0;

/// Width of the light margin of a figure that is used for its levels.
const MARGIN_PX: u16 = 2;

/// Grey pixels of a shape's bounding box, with the mask of the shape.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cutout<'a> {
    /// Width and height of both planes.
    pub(crate) size: Size,
    /// Intensity.
    pub(crate) grey: &'a [u8],
    /// 1 for pixels of the shape.
    pub(crate) mask: &'a [u8],
}

/// A light region that may be a plate, in coordinates of the cut-out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plate<'a> {
    /// The dark figure on it.
    pub(crate) figure: Option<Figure<'a>>,
    /// The light region, or at least its border.
    border: Border<'a>,
    /// The pixels that show the plate, and their number.
    pub(crate) paper: Within<'a>,
    pub(crate) paper_px2: usize,
    /// Whether the figure may reach the border of the paper.
    pub(crate) touches: bool,
}

/// Pixels to which a square can be fitted.
#[derive(Debug, Clone, Copy)]
enum Border<'a> {
    /// Points of a contour.
    Contour(&'a [Point]),
    /// Non-zero pixels of a mask.
    Mask(&'a [u8], Size),
}

impl Plate<'_> {
    /// Its position, if it is a square.
    pub(crate) fn square(&self) -> Option<Square> {
        let step = std::f32::consts::FRAC_PI_2 / DIRECTIONS as f32;
        self.square_along((0..DIRECTIONS).map(|i| step * i as f32))
    }

    /// The same, with rotation and side as exact as the border allows.
    pub(crate) fn exact_square(&self) -> Option<Square> {
        let rough = self.square()?.turn_rad;
        let step = std::f32::consts::FRAC_PI_2 / DIRECTIONS as f32 / FINE as f32;
        self.square_along((0..=2 * FINE).map(|i| rough + step * (i as f32 - FINE as f32)))
    }

    fn square_along(&self, turns_rad: impl Iterator<Item = f32>) -> Option<Square> {
        match self.border {
            Border::Contour(contour) => square_around(|| contour.iter().copied(), turns_rad),
            Border::Mask(mask, size) => square_around(|| pixels(mask, size), turns_rad),
        }
    }
}

/// A dark figure on a bright plate.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Figure<'a> {
    /// Contour, clockwise on the screen.
    pub(crate) contour: &'a [[f32; 2]],
    /// Area and centre of the contour.
    pub(crate) region: Region,
}

/// Position of a plate, to within a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Square {
    pub(crate) centre: [f32; 2],
    /// Direction of a side, 0 to a quarter turn.
    pub(crate) turn_rad: f32,
    pub(crate) side_px: f32,
}

/// Memory for cut-outs up to a given size. Its content does not carry over between calls.
#[derive(Debug)]
pub(crate) struct CutoutScratch {
    light: Vec<u8>,
    plate: Vec<u8>,
    closed: Vec<u8>,
    grey: Vec<u8>,
    dark: Vec<u8>,
    spare: Vec<u8>,
    points: Vec<Point>,
    spans: Vec<Span>,
    isoline: Vec<[f32; 2]>,
}

/// The part of the scratch memory used for one plate.
struct PlateScratch<'a> {
    grey: &'a mut [u8],
    dark: &'a mut [u8],
    spare: &'a mut [u8],
    spans: &'a mut [Span],
    isoline: &'a mut [[f32; 2]],
}

impl CutoutScratch {
    /// Allocates for cut-outs of at most this size.
    pub(crate) fn new(size: Size) -> Self {
        Self {
            light: vec![0; size.area()],
            plate: vec![0; size.area()],
            closed: vec![0; size.area()],
            grey: vec![0; size.area()],
            dark: vec![0; size.area()],
            spare: vec![0; size.area()],
            points: vec![Point::default(); contour_capacity(size)],
            spans: vec![Span::default(); span_capacity(size)],
            isoline: vec![[0.0; 2]; 2 * contour_capacity(size)],
        }
    }
}

/// Calls `found` with every light region, in reading order, and in a small shape finally with all
/// of them together. `found` returns whether it was a plate.
pub(crate) fn find_plates(
    cutout: Cutout<'_>,
    tone: &ToneCurve,
    scratch: &mut CutoutScratch,
    mut found: impl FnMut(Plate<'_>) -> bool,
) {
    let Cutout { size, grey, mask } = cutout;
    let Some(split) = split_light(&histogram(grey, mask), tone).filter(has_contrast) else {
        return;
    };
    let light = &mut scratch.light[..size.area()];
    mark_light(cutout, split.threshold, light);
    let (mut from, mut any) = (0, false);
    while let Some(start) = next_shape(&scratch.light[..size.area()], size, from) {
        from = usize::from(start.y) * size.width + usize::from(start.x);
        let light = &mut scratch.light[..size.area()];
        let contour = follow_contour(light, size, start, &mut scratch.points);
        let removed = remove_shape(light, size, start, &mut scratch.spans);
        let Ok(contour) = contour else { continue };
        if removed.area < LIGHT_MIN_PX2 {
            continue;
        }
        let plate = &mut scratch.plate[..removed.bounds.size().area()];
        fill_contour(contour, removed.bounds, plate);
        let memory = PlateScratch {
            grey: &mut scratch.grey,
            dark: &mut scratch.dark,
            spare: &mut scratch.spare,
            spans: &mut scratch.spans,
            isoline: &mut scratch.isoline,
        };
        let figure = figure_on_plate(cutout, tone, removed.bounds, plate, memory);
        any |= found(Plate {
            figure,
            border: Border::Contour(contour),
            paper: Within {
                mask: plate,
                bounds: removed.bounds,
            },
            paper_px2: count(plate),
            touches: false,
        });
    }
    if !any {
        whole_as_plate(cutout, tone, &split, scratch, found);
    }
}

/// Calls `found` with the whole shape as one plate, if it is small or its surroundings are masked:
/// blur may have broken the light into pieces, or the figure may reach the border of its plate.
fn whole_as_plate(
    cutout: Cutout<'_>,
    tone: &ToneCurve,
    split: &Split,
    scratch: &mut CutoutScratch,
    mut found: impl FnMut(Plate<'_>) -> bool,
) {
    let Cutout { size, grey, mask } = cutout;
    let broken = size.width.max(size.height) <= BROKEN_MAX_PX;
    let is_part = mask.contains(&0);
    if !(broken || is_part) {
        return;
    }
    let closed = &mut scratch.closed[..size.area()];
    for ((closed, &grey), &mask) in closed.iter_mut().zip(grey).zip(mask) {
        *closed = if mask == 0 { split.light as u8 } else { grey };
    }
    let closed = Cutout {
        grey: closed,
        ..cutout
    };
    let whole = size.bounds();
    let memory = PlateScratch {
        grey: &mut scratch.grey,
        dark: &mut scratch.dark,
        spare: &mut scratch.spare,
        spans: &mut scratch.spans,
        isoline: &mut scratch.isoline,
    };
    let figure = if is_part {
        figure_on_plate(closed, tone, whole, mask, memory)
    } else {
        None
    };
    // The regions have been removed from it one by one.
    let light = &mut scratch.light[..size.area()];
    mark_light(cutout, split.threshold, light);
    found(Plate {
        figure,
        border: if broken {
            Border::Mask(light, size)
        } else {
            Border::Contour(&[])
        },
        paper: Within {
            mask,
            bounds: whole,
        },
        paper_px2: count(mask),
        touches: true,
    });
}

/// Number of non-zero pixels in a mask.
fn count(mask: &[u8]) -> usize {
    mask.iter().map(|&m| usize::from(m != 0)).sum()
}

/// Marks the light pixels of the shape.
fn mark_light(cutout: Cutout<'_>, threshold: f32, light: &mut [u8]) {
    for ((light, &grey), &mask) in light.iter_mut().zip(cutout.grey).zip(cutout.mask) {
        *light = mask & u8::from(f32::from(grey) >= threshold);
    }
}

/// The pixels of a mask.
fn pixels(mask: &[u8], size: Size) -> impl Iterator<Item = Point> + '_ {
    let at = move |i: usize| Point {
        x: (i % size.width) as u16,
        y: (i / size.width) as u16,
    };
    (0..mask.len()).filter(|&i| mask[i] != 0).map(at)
}

/// The square around pixels: of the bounding rectangles with these rotations, the one with the
/// smallest area, if it is a square.
fn square_around<Points: Iterator<Item = Point>>(
    points: impl Fn() -> Points,
    turns_rad: impl Iterator<Item = f32>,
) -> Option<Square> {
    let mut min: Option<(f32, Square, f32)> = None;
    for turn_rad in turns_rad {
        let (sin, cos) = turn_rad.sin_cos();
        let mut spans = [[f32::INFINITY, f32::NEG_INFINITY]; 2];
        for Point { x, y } in points() {
            let (x, y) = (f32::from(x), f32::from(y));
            for (span, at) in spans.iter_mut().zip([cos * x + sin * y, cos * y - sin * x]) {
                *span = [span[0].min(at), span[1].max(at)];
            }
        }
        // From pixel centres to pixel borders.
        let [along, across] = spans.map(|[from, to]| to - from + 1.0);
        let [u, v] = spans.map(|[from, to]| (from + to) / 2.0);
        let area = along * across;
        if area.is_finite() && min.is_none_or(|(before, ..)| area < before) {
            let square = Square {
                centre: [cos * u - sin * v, sin * u + cos * v],
                turn_rad,
                side_px: area.sqrt(),
            };
            min = Some((area, square, along.max(across) / along.min(across)));
        }
    }
    let (_, square, length_per_width) = min?;
    (length_per_width <= SQUARE_MAX).then_some(square)
}

/// The largest dark region surrounded by light of the plate. `plate` is the filled contour of the
/// plate, in `bounds`.
fn figure_on_plate<'a>(
    cutout: Cutout<'_>,
    tone: &ToneCurve,
    bounds: Bounds,
    plate: &[u8],
    scratch: PlateScratch<'a>,
) -> Option<Figure<'a>> {
    let PlateScratch {
        grey,
        dark,
        spare,
        spans,
        isoline,
    } = scratch;
    let size = bounds.size();
    let (grey, dark) = (&mut grey[..size.area()], &mut dark[..size.area()]);
    crop(cutout.grey, cutout.size, bounds, grey);
    let rough = split_light(&histogram(grey, plate), tone).filter(has_contrast)?;
    for ((dark, &plate), &grey) in dark.iter_mut().zip(plate).zip(&*grey) {
        *dark = plate & u8::from(f32::from(grey) < rough.threshold);
    }
    if size.width.min(size.height) >= OPENING_MIN_PX {
        let spare = &mut spare[..size.area()];
        open_3x3(dark, size, spare);
        close_3x3(dark, size, spare);
    }
    let largest = largest_shape(dark, size, spans)?;
    let around = largest.bounds.grown(MARGIN_PX, size);
    let split = split_around(grey, plate, tone, size, around)?;
    let start = first_dark(grey, plate, size, around, split.threshold)?;
    let start = Point {
        x: start.x + bounds.left,
        y: start.y + bounds.top,
    };
    let contour = follow_isoline(cutout.grey, cutout.size, start, split.threshold, isoline).ok()?;
    let region = region(contour);
    // If the isoline leaves the plate, it encloses more than the dark pixels inside the plate.
    let plausible =
        region.area > 0.5 * largest.area as f32 && region.area < 1.5 * largest.area as f32 + 8.0;
    let large_enough = region.area >= MARKER_SHARE_MIN * count(plate) as f32;
    (plausible && large_enough).then_some(Figure { contour, region })
}

/// The largest shape of a mask, by area. The mask is empty afterwards.
fn largest_shape(mask: &mut [u8], size: Size, spans: &mut [Span]) -> Option<Removed> {
    let mut largest: Option<Removed> = None;
    let mut from = 0;
    while let Some(start) = next_shape(mask, size, from) {
        from = usize::from(start.y) * size.width + usize::from(start.x);
        let removed = remove_shape(mask, size, start, spans);
        if largest.is_none_or(|largest| removed.area > largest.area) {
            largest = Some(removed);
        }
    }
    largest
}

/// Divides a histogram into light and dark where the light is half-way between theirs.
pub(crate) fn split_light(histogram: &Histogram, tone: &ToneCurve) -> Option<Split> {
    split(histogram).map(|split| Split {
        threshold: tone.half_way(split.dark, split.light),
        ..split
    })
}

/// The threshold in the neighbourhood of a figure, where a rim that is neither light nor dark does
/// not shift it.
fn split_around(
    grey: &[u8],
    plate: &[u8],
    tone: &ToneCurve,
    size: Size,
    around: Bounds,
) -> Option<Split> {
    let mut levels = [0; 256];
    for y in around.top..=around.bottom {
        let row = usize::from(y) * size.width;
        let columns = row + usize::from(around.left)..=row + usize::from(around.right);
        for (&grey, &plate) in grey[columns.clone()].iter().zip(&plate[columns]) {
            levels[usize::from(grey)] += u32::from(plate);
        }
    }
    split_light(&levels, tone).filter(has_contrast)
}

/// The first dark pixel of the plate with light to its left, in reading order.
fn first_dark(
    grey: &[u8],
    plate: &[u8],
    size: Size,
    around: Bounds,
    threshold: f32,
) -> Option<Point> {
    let index = |x: u16, y: u16| usize::from(y) * size.width + usize::from(x);
    let is_dark = |i: usize| f32::from(grey[i]) < threshold;
    (around.top..=around.bottom)
        .flat_map(|y| (around.left + 1..=around.right).map(move |x| Point { x, y }))
        .find(|&Point { x, y }| {
            let (left, here) = (index(x - 1, y), index(x, y));
            plate[left] & plate[here] != 0 && is_dark(here) && !is_dark(left)
        })
}

fn has_contrast(split: &Split) -> bool {
    split.light - split.dark >= CONTRAST_MIN
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws rectangles in sequence, (left, top, right, bottom, grey), and returns the areas of the
    /// figures found.
    fn figures(rectangles: &[(usize, usize, usize, usize, u8)]) -> Vec<(f32, [f32; 2])> {
        let size = Size {
            width: 60,
            height: 50,
        };
        let mut grey = vec![100; size.area()];
        for &(left, top, right, bottom, value) in rectangles {
            for y in top..=bottom {
                grey[y * size.width + left..=y * size.width + right].fill(value);
            }
        }
        let cutout = Cutout {
            size,
            grey: &grey,
            mask: &vec![1; size.area()],
        };
        let mut found = Vec::new();
        find_plates(
            cutout,
            &ToneCurve::new(1.0),
            &mut CutoutScratch::new(size),
            |plate| {
                found.extend(plate.figure.map(|f| (f.region.area, f.region.centre)));
                plate.figure.is_some()
            },
        );
        found
    }

    /// A bar of 10 x 20 pixels. An isoline cuts the corners and passes half-way between the pixels.
    fn assert_is_the_bar(figures: &[(f32, [f32; 2])]) {
        let [(area, centre)] = figures else {
            panic!("{figures:?}")
        };
        assert!((area - 200.0).abs() < 2.0, "{area}");
        assert!(
            (centre[0] - 29.5).abs() < 0.1 && (centre[1] - 24.5).abs() < 0.1,
            "{centre:?}"
        );
    }

    const PLATE: (usize, usize, usize, usize, u8) = (15, 10, 44, 39, 220);
    const BAR: (usize, usize, usize, usize, u8) = (25, 15, 34, 34, 40);

    #[test]
    fn a_dark_figure_on_a_bare_plate() {
        assert_is_the_bar(&figures(&[PLATE, BAR]));
    }

    #[test]
    fn rims_of_any_brightness() {
        for rim in [0, 60, 120, 180, 250] {
            assert_is_the_bar(&figures(&[(10, 5, 49, 44, rim), PLATE, BAR]));
        }
    }

    #[test]
    fn a_robot_darker_than_its_marker() {
        let marker = (25, 15, 34, 34, 90);
        assert_is_the_bar(&figures(&[(0, 0, 59, 49, 10), PLATE, marker]));
    }

    #[test]
    fn a_bright_robot_around_a_dark_rim() {
        assert_is_the_bar(&figures(&[
            (2, 2, 57, 47, 210),
            (10, 5, 49, 44, 30),
            PLATE,
            BAR,
        ]));
    }

    #[test]
    fn two_plates_in_one_shape() {
        let two = [
            (5, 5, 24, 24, 220),
            (10, 10, 19, 19, 40),
            (32, 5, 51, 24, 220),
            (38, 8, 45, 20, 40),
        ];
        assert_eq!(figures(&two).len(), 2);
    }

    #[test]
    fn no_figure_without_contrast_or_without_light_around_it() {
        assert!(figures(&[]).is_empty());
        assert!(figures(&[(15, 10, 44, 39, 110)]).is_empty());
        // The dark bar reaches the border of its plate.
        assert!(figures(&[PLATE, (25, 10, 34, 34, 40)]).is_empty());
    }
}
