//! The rendered image of a drawing, which decides what the marker is.
//!
//! The plate is rendered large on white, with a margin that shows whatever extends beyond the
//! plate. The darkness of a pixel is 0 for the drawing's own paper and 1 for its ink.

use std::ops::Range;

use imgproc::isoline::follow_isoline;
use imgproc::{Point, Size};
use resvg::tiny_skia::{Color, Pixmap, Transform};

use crate::geometry::raster::fill_polygon;
use crate::marker::drawing::content::luma;

/// Side of the plate in pixels, for comparing an image with an outline, and for tracing an outline.
pub(super) const COMPARED: usize = 1024;
pub(super) const TRACED: usize = 2048;

/// The margin is the plate's side divided by this.
const MARGIN: usize = 32;

/// Regions smaller than this, in units of the plate's area, are ignored: a square of a 256th of its
/// side.
const DUST: f32 = 1.0 / 65_536.0;

/// Tolerance of the darkness around 0 and 1.
const TONE: f32 = 0.25;

/// Tolerance between the darkness of a pixel and its coverage by an outline. The renderer samples
/// four by four points of a pixel, so at a border up to an eighth is rounding.
const COVERAGE: f32 = 0.25;

/// The same for a shape that is drawn twice: the second layer covers part of what the first left of
/// a border pixel.
const COVERAGE_TWICE: f32 = 0.5;

/// Maximum rounding error by which a shape may extend beyond the plate, as a share of its side.
const REACH: f32 = 0.002;

/// Distance of a simplified outline from the traced one, pixels of [`TRACED`]: a hundredth of a
/// pixel on a plate 100 pixels wide.
const TOLERANCE: f32 = 0.2;

/// The rendered plate and its margin.
pub(super) struct Canvas {
    per_plate: usize,
    margin: usize,
    size: Size,
    luma: Vec<u8>,
    paper: f32,
    ink: f32,
}

/// The dark regions of an image.
#[derive(Debug, PartialEq)]
pub(super) struct Figures {
    /// Number of dark regions on the plate.
    pub(super) regions: usize,
    /// Number of light regions inside them.
    pub(super) holes: usize,
    pub(super) reaches_out: bool,
    /// The border of the plate is dark.
    pub(super) fills_plate: bool,
    /// The first pixel, in reading order, of the last region.
    start: Option<Point>,
}

impl Canvas {
    /// Renders a tree. `None` if nothing is dark.
    pub(super) fn draw(tree: &usvg::Tree, per_plate: usize) -> Option<Self> {
        let margin = per_plate / MARGIN;
        let side = per_plate + 2 * margin;
        let mut pixmap = Pixmap::new(side as u32, side as u32)?;
        pixmap.fill(Color::WHITE);
        let scale = per_plate as f32 / tree.size().width();
        let transform =
            Transform::from_scale(scale, scale).post_translate(margin as f32, margin as f32);
        resvg::render(tree, transform, &mut pixmap.as_mut());
        let luma: Vec<u8> = pixmap
            .data()
            .chunks_exact(4)
            .map(|p| luma([p[0], p[1], p[2]]).round() as u8)
            .collect();
        let mut canvas = Self {
            per_plate,
            margin,
            size: Size {
                width: side,
                height: side,
            },
            luma,
            paper: 255.0,
            ink: 0.0,
        };
        let mut levels = [0usize; 256];
        for y in canvas.plate() {
            let row = &canvas.luma[y * side..][canvas.plate()];
            row.iter()
                .for_each(|&level| levels[usize::from(level)] += 1);
        }
        let dark: usize = levels[..128].iter().sum();
        if (dark as f32) < canvas.dust() {
            return None;
        }
        canvas.ink = median(&levels[..128]) as f32;
        canvas.paper = 128.0 + median(&levels[128..]) as f32;
        Some(canvas)
    }

    fn plate(&self) -> Range<usize> {
        self.margin..self.margin + self.per_plate
    }

    fn dust(&self) -> f32 {
        DUST * (self.per_plate * self.per_plate) as f32
    }

    fn darkness(&self, pixel: usize) -> f32 {
        (self.paper - f32::from(self.luma[pixel])) / (self.paper - self.ink)
    }

    fn threshold(&self) -> f32 {
        (self.paper + self.ink) / 2.0
    }

    /// Whether part of the plate is neither paper nor ink, apart from the borders between them.
    pub(super) fn has_half_tones(&self) -> bool {
        // A border is one pixel wide: paper and ink are both close.
        const NEAR: usize = 2;
        let side = self.size.width;
        let mut count = 0.0;
        for y in self.plate() {
            for x in self.plate() {
                let darkness = self.darkness(y * side + x);
                if darkness.abs() <= TONE || (darkness - 1.0).abs() <= TONE {
                    continue;
                }
                let (mut paper, mut ink) = (false, false);
                for near in (y - NEAR..=y + NEAR)
                    .flat_map(|y| (x - NEAR..=x + NEAR).map(move |x| y * side + x))
                {
                    let darkness = self.darkness(near);
                    paper |= darkness.abs() <= TONE;
                    ink |= (darkness - 1.0).abs() <= TONE;
                }
                if !(paper && ink) {
                    count += 1.0;
                }
            }
        }
        count >= self.dust()
    }

    /// Counts the dark regions on the plate and the holes in them.
    pub(super) fn figures(&self) -> Figures {
        let threshold = self.threshold();
        let side = self.size.width;
        let dark: Vec<bool> = self
            .luma
            .iter()
            .map(|&luma| f32::from(luma) < threshold)
            .collect();
        let plate = self.plate();
        let border = plate.clone().flat_map(|i| {
            let [first, last] = [plate.start, plate.end - 1];
            [
                first * side + i,
                last * side + i,
                i * side + first,
                i * side + last,
            ]
        });
        let dark_border = border.filter(|&pixel| dark[pixel]).count();
        let mut figures = Figures {
            regions: 0,
            holes: 0,
            reaches_out: false,
            fills_plate: dark_border > 3 * self.per_plate,
            start: None,
        };
        let beyond = (REACH * self.per_plate as f32).ceil() as usize;
        let inside = plate.start - beyond..plate.end + beyond;
        let mut unseen = dark.clone();
        for start in 0..dark.len() {
            if !unseen[start] {
                continue;
            }
            let (mut on_plate, mut reaches_out) = (0.0, false);
            flood(&mut unseen, side, start, true, |x, y| {
                if plate.contains(&x) && plate.contains(&y) {
                    on_plate += 1.0;
                }
                reaches_out |= !inside.contains(&x) || !inside.contains(&y);
            });
            if on_plate >= self.dust() {
                figures.regions += 1;
                figures.reaches_out |= reaches_out;
                figures.start = Some(Point {
                    x: (start % side) as u16,
                    y: (start / side) as u16,
                });
            }
        }
        // A light region not connected to the border of the image is a hole.
        let mut unseen: Vec<bool> = dark.iter().map(|dark| !dark).collect();
        for start in 0..dark.len() {
            if !unseen[start] {
                continue;
            }
            let (mut area, mut at_border) = (0.0, false);
            flood(&mut unseen, side, start, false, |x, y| {
                at_border |= x == 0 || y == 0 || x == side - 1 || y == side - 1;
                area += 1.0;
            });
            figures.holes += usize::from(!at_border && area >= self.dust());
        }
        figures
    }

    /// Whether the image shows exactly the area of an outline, drawn once or `twice`. The outline
    /// is in units of the plate's side from its centre.
    pub(super) fn shows(&self, outline: &[[f32; 2]], twice: bool) -> bool {
        let max = if twice { COVERAGE_TWICE } else { COVERAGE };
        let from_plate = |c: f32| (c + 0.5) * self.per_plate as f32 + self.margin as f32 - 0.5;
        let polygon: Vec<[f32; 2]> = outline.iter().map(|p| p.map(from_plate)).collect();
        let mut coverage = vec![0.0; self.size.area()];
        fill_polygon(&polygon, self.size, &mut coverage);
        let differs =
            |(pixel, covered): (usize, &f32)| (self.darkness(pixel) - covered).abs() > max;
        let different = coverage.iter().enumerate().filter(|&c| differs(c)).count();
        (different as f32) < self.dust()
    }

    /// The outline of the figure, in units of the plate's side from its centre, clockwise.
    pub(super) fn outline(&self, figures: &Figures) -> Option<Vec<[f32; 2]>> {
        let mut points = vec![[0.0; 2]; 64 * self.size.width];
        let traced = follow_isoline(
            &self.luma,
            self.size,
            figures.start?,
            self.threshold(),
            &mut points,
        );
        let to_plate = |c: f32| {
            ((c + 0.5 - self.margin as f32) / self.per_plate as f32 - 0.5).clamp(-0.5, 0.5)
        };
        let corners = simplified(traced.ok()?);
        Some(corners.into_iter().map(|p| p.map(to_plate)).collect())
    }
}

/// Median of a histogram.
fn median(counts: &[usize]) -> usize {
    let half = counts.iter().sum::<usize>() / 2;
    let mut sum = 0;
    let reached = |&count: &usize| {
        sum += count;
        sum > half
    };
    counts.iter().position(reached).unwrap_or(counts.len() - 1)
}

/// Clears the set pixels connected to `start`, by sides or, if `diagonal`, also by corners, and
/// calls `visit` with the column and row of each.
fn flood(
    set: &mut [bool],
    side: usize,
    start: usize,
    diagonal: bool,
    mut visit: impl FnMut(usize, usize),
) {
    const AROUND: [(isize, isize); 8] = [
        (1, 0),
        (-1, 0),
        (0, 1),
        (0, -1),
        (1, 1),
        (-1, 1),
        (1, -1),
        (-1, -1),
    ];
    let around = &AROUND[..if diagonal { 8 } else { 4 }];
    let mut stack = vec![start];
    set[start] = false;
    while let Some(pixel) = stack.pop() {
        let (x, y) = (pixel % side, pixel / side);
        visit(x, y);
        for &(dx, dy) in around {
            let (x, y) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            if x < side && y < side && set[y * side + x] {
                set[y * side + x] = false;
                stack.push(y * side + x);
            }
        }
    }
}

/// The corners of a closed line that stays within [`TOLERANCE`] of another one (Douglas and Peucker
/// 1973).
fn simplified(line: &[[f32; 2]]) -> Vec<[f32; 2]> {
    let n = line.len();
    let at = |i: usize| line[i % n];
    let from_first = |p: &[f32; 2]| (p[0] - line[0][0]).hypot(p[1] - line[0][1]);
    let opposite = (0..n)
        .max_by(|&a, &b| from_first(&line[a]).total_cmp(&from_first(&line[b])))
        .unwrap_or(0);
    let mut corners = Vec::new();
    let mut ends = vec![n, opposite];
    let mut from = 0;
    while let Some(&to) = ends.last() {
        let (a, b) = (at(from), at(to));
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = dx.hypot(dy);
        let distance = |i: usize| {
            let [px, py] = [line[i][0] - a[0], line[i][1] - a[1]];
            if length > 0.0 {
                (px * dy - py * dx).abs() / length
            } else {
                px.hypot(py)
            }
        };
        let farthest = (from + 1..to)
            .map(|i| (i, distance(i)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match farthest {
            Some((middle, distance)) if distance > TOLERANCE => ends.push(middle),
            _ => {
                corners.push(a);
                from = to;
                ends.pop();
            }
        }
    }
    corners
}
