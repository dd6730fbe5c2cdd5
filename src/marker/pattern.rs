//! Light and dark over a whole plate: the last check of a recognised marker.
//!
//! A descriptor knows the outline of the dark figure and nothing of what lies around it. A dark spot that happens to have a
//! marker's outline, on something bright that is no plate, differs from a marker there.

use crate::marker::cutout::Cutout;
use crate::marker::drawing::Drawing;
use crate::marker::reference::{Placement, placed};
use crate::raster::fill_polygon;
use imgproc::Size;

/// Points across the plate.
const ACROSS: usize = 14;

/// Pixels across the neighbourhood of a point that must be all light or all dark in the drawing, for it to count.
const CELL: usize = 5;

/// Points of the plate that are clearly light or clearly dark.
#[derive(Debug, Clone)]
pub(crate) struct Pattern {
    points: Vec<PatternPoint>,
}

/// A point in units of the plate's side, from its centre.
#[derive(Debug, Clone, Copy)]
struct PatternPoint {
    at: [f32; 2],
    dark: bool,
}

impl Pattern {
    /// The pattern of a drawing.
    pub(crate) fn learn(drawing: &Drawing) -> Self {
        let side = ACROSS * CELL;
        let size = Size {
            width: side,
            height: side,
        };
        let middle = (side as f32 - 1.0) / 2.0;
        let mut coverage = vec![0.0; size.area()];
        fill_polygon(
            &placed(&drawing.outline, [middle, middle], 0.0, side as f32),
            size,
            &mut coverage,
        );
        let mut points = Vec::new();
        // The outermost points lie where the plate ends and blur mixes in what is outside.
        for (row, column) in
            (1..ACROSS - 1).flat_map(|row| (1..ACROSS - 1).map(move |column| (row, column)))
        {
            let pixel =
                |i: usize| coverage[(row * CELL + i / CELL) * side + column * CELL + i % CELL];
            let covered = (0..CELL * CELL).map(pixel).sum::<f32>() / (CELL * CELL) as f32;
            if !(0.01..=0.99).contains(&covered) {
                let at =
                    [column, row].map(|i| ((i * CELL + CELL / 2) as f32 - middle) / side as f32);
                points.push(PatternPoint {
                    at,
                    dark: covered > 0.5,
                });
            }
        }
        Self { points }
    }

    /// Share of the points that are light or dark in a picture as they are in the drawing; what lies outside the picture is not.
    pub(crate) fn agreement(&self, place: Placement, cutout: Cutout<'_>, threshold: f32) -> f32 {
        let (sin, cos) = place.turn_rad.sin_cos();
        let (width, height) = (cutout.size.width as f32, cutout.size.height as f32);
        let agrees = |point: &&PatternPoint| {
            let [u, v] = point.at.map(|c| c * place.plate_px);
            let x = (place.centre[0] + cos * u - sin * v).round();
            let y = (place.centre[1] + sin * u + cos * v).round();
            let inside = x >= 0.0 && y >= 0.0 && x < width && y < height;
            inside
                && (f32::from(cutout.grey[y as usize * cutout.size.width + x as usize]) < threshold)
                    == point.dark
        };
        self.points.iter().filter(agrees).count() as f32 / self.points.len().max(1) as f32
    }
}
