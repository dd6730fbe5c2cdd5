//! The appearance of a marker to the camera, measured on rendered plates.
//!
//! Each marker is rendered on its plate at several sizes, blurs and rotations, rounded to 8 bits,
//! and processed by the same code as live frames; a reference is the mean over the rotations. The
//! effects of pixels and lens on small markers, above all rounded corners, are thus part of the
//! reference and not an error. The drawing itself is used for comparison only where nothing has
//! been lost.

use fourier::affine::{Normalised, normalise};
use fourier::contour::resample;
use fourier::descriptor::{Descriptor, NoDescriptor, describe};
use fourier::matching::distances;
use fourier::{Complex32, N, wrapped};
use imgproc::Size;
use imgproc::tone::ToneCurve;

use crate::geometry::raster::{Vertex, blur, fill_polygon};
use crate::marker::cutout::{Cutout, CutoutScratch, find_plates};
use crate::marker::drawing::Drawing;

/// Sides of the rendered plates, in pixels. A figure is compared with the references of the nearest
/// size.
pub(crate) const PLATES_PX: [f32; 6] = [12.0, 16.0, 24.0, 32.0, 48.0, 80.0];

/// Blurs of the rendered plates, standard deviation in pixels: a sharp lens, a good one, two that
/// are out of focus.
pub(crate) const BLURS_PX: [f32; 4] = [0.3, 0.6, 1.0, 1.5];

/// Number of rotations of a rendered plate. Not a divisor of a quarter turn, so each has a
/// different alignment with the pixel grid.
const TURNS: usize = 5;

/// Elongation below which a contour has no orientation; markers need much more.
pub(crate) const ORIENTATION_MIN: f32 = 0.02;

/// Appearance of an upright marker on plates of one size and blur.
#[derive(Debug, Clone)]
pub(crate) struct Reference {
    pub(crate) descriptor: Descriptor,
    /// Magnitudes of the descriptor.
    pub(crate) magnitudes: [f32; N],
    /// Ratio of the plate's side to the descriptor's size.
    pub(crate) plate_per_size: f32,
    /// From the figure's centroid to the plate's centre, in units of the descriptor's size.
    pub(crate) centre_from_figure: [f32; 2],
    /// For plates that are seen at an angle.
    pub(crate) at_an_angle: AngleReference,
}

/// Appearance of a marker apart from any affine map.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AngleReference {
    pub(crate) normalised: Normalised,
    /// Magnitudes of the normalised contour.
    pub(crate) magnitudes: [f32; N],
    /// Of the upright plate that was measured, pixels.
    pub(crate) plate_px: f32,
    pub(crate) centre_from_figure_px: [f32; 2],
}

impl AngleReference {
    /// Size of the figure: that by which its contour was divided.
    pub(crate) fn size_px(&self) -> f32 {
        size_px(&self.normalised)
    }
}

/// The size by which a normalised contour was divided, pixels.
pub(crate) fn size_px(normalised: &Normalised) -> f32 {
    let [[a, b], [c, d]] = normalised.to_pixels;
    (a * d - b * c).sqrt()
}

/// Reasons why a rendered plate gives no reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum NoReference {
    /// No dark figure was found.
    Unseen,
    /// The figure has no orientation; its elongation.
    Orientation(f32),
}

impl Reference {
    /// Mean of the measurements on a rendered plate over all rotations.
    pub(crate) fn learn(
        drawing: &Drawing,
        plate_px: f32,
        blur_px: f32,
    ) -> Result<Self, NoReference> {
        let upright = measure(drawing, plate_px, blur_px, 0.0)?;
        let mut coefficients = [Complex32::default(); N];
        let (mut size_px, mut orientation) = (0.0, 0.0);
        let mut centre = [0.0; 2];
        for i in 0..TURNS {
            let turn = std::f32::consts::TAU * i as f32 / TURNS as f32;
            let seen = measure(drawing, plate_px, blur_px, turn)?;
            let [same, half_turn] = distances(&seen.descriptor, &upright.descriptor);
            let sign = if half_turn < same { -1.0 } else { 1.0 };
            for (k, (mean, c)) in coefficients
                .iter_mut()
                .zip(seen.descriptor.coefficients)
                .enumerate()
            {
                *mean += c * if k % 2 == 0 { sign } else { 1.0 };
            }
            // Relative to the first one and modulo half a turn, so that the averaged angles are
            // close to each other.
            let relative =
                seen.descriptor.orientation_rad - turn - upright.descriptor.orientation_rad;
            orientation += nearest_half_turn(relative);
            size_px += seen.descriptor.size_px;
            let (sin, cos) = turn.sin_cos();
            let [x, y] = seen.centre_from_figure;
            centre[0] += cos * x + sin * y;
            centre[1] += cos * y - sin * x;
        }
        let n = TURNS as f32;
        let size = size_px / n;
        let descriptor = Descriptor {
            coefficients: coefficients.map(|c| c / n),
            size_px: size,
            orientation_rad: upright.descriptor.orientation_rad + orientation / n,
            ..upright.descriptor
        };
        Ok(Self {
            descriptor,
            magnitudes: descriptor.magnitudes(),
            plate_per_size: plate_px / size,
            centre_from_figure: centre.map(|c| c / n / size),
            at_an_angle: AngleReference {
                normalised: upright.normalised,
                magnitudes: upright.normalised.magnitudes(),
                plate_px,
                centre_from_figure_px: upright.centre_from_figure,
            },
        })
    }
}

/// Reduces an angle to within a quarter turn of zero by adding half turns.
fn nearest_half_turn(angle_rad: f32) -> f32 {
    wrapped(2.0 * angle_rad) / 2.0
}

/// Measurements on one rendered plate.
struct Measured {
    descriptor: Descriptor,
    normalised: Normalised,
    centre_from_figure: [f32; 2],
}

/// Renders a plate and measures it like a live frame.
fn measure(
    drawing: &Drawing,
    plate_px: f32,
    blur_px: f32,
    turn_rad: f32,
) -> Result<Measured, NoReference> {
    let side = (plate_px * 1.5) as usize + 8;
    let size = Size {
        width: side,
        height: side,
    };
    // A different sub-pixel offset for each rotation.
    let centre = [
        side as f32 / 2.0 + 0.3 * turn_rad.cos(),
        side as f32 / 2.0 + 0.3 * turn_rad.sin(),
    ];
    let place = Placement {
        centre,
        turn_rad,
        plate_px,
    };
    let mut grey = render(drawing, size, place, blur_px);
    let mut mask = vec![1; size.area()];
    if drawing.touches() {
        mask = plate_mask(size, place);
        // Same as in live frames where nothing surrounds the figure.
        for (grey, mask) in grey.iter_mut().zip(&mut mask) {
            if *mask == 0 {
                (*grey, *mask) = (PAPER as u8, 1);
            }
        }
    }
    let cutout = Cutout {
        size,
        grey: &grey,
        mask: &mask,
    };
    let mut measured = Err(NoReference::Unseen);
    find_plates(
        cutout,
        &ToneCurve::new(1.0),
        &mut CutoutScratch::new(size),
        |plate| {
            let Some(figure) = plate.figure else {
                return false;
            };
            let Some(normalised) = normalise(figure.contour) else {
                return false;
            };
            measured = match describe(&resample(figure.contour), ORIENTATION_MIN) {
                Ok(descriptor) => Ok(Measured {
                    descriptor,
                    normalised,
                    centre_from_figure: [
                        centre[0] - figure.region.centre[0],
                        centre[1] - figure.region.centre[1],
                    ],
                }),
                Err(NoDescriptor::NoOrientation { elongation }) => {
                    Err(NoReference::Orientation(elongation))
                }
                Err(NoDescriptor::NoExtent) => Err(NoReference::Unseen),
            };
            true
        },
    );
    measured
}

/// Position of a plate in a picture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placement {
    pub(crate) centre: [f32; 2],
    pub(crate) turn_rad: f32,
    pub(crate) plate_px: f32,
}

/// Grey levels of the rendered plates.
const FLOOR: f32 = 110.0;
const PAPER: f32 = 225.0;
const INK: f32 = 35.0;

/// Pixels at least half covered by a plate.
pub(crate) fn plate_mask(size: Size, place: Placement) -> Vec<u8> {
    let mut share = vec![0.0; size.area()];
    let polygon = placed(&PLATE, place.centre, place.turn_rad, place.plate_px);
    fill_polygon(&polygon, size, &mut share);
    share.iter().map(|&s| u8::from(s >= 0.5)).collect()
}

/// Draws a plate with its marker on a grey floor.
pub(crate) fn render(drawing: &Drawing, size: Size, place: Placement, blur_px: f32) -> Vec<u8> {
    let mut plane = vec![FLOOR; size.area()];
    let mut scratch = vec![0.0; size.area()];
    for (outline, level) in [(&PLATE[..], PAPER), (&drawing.outline[..], INK)] {
        let polygon = placed(outline, place.centre, place.turn_rad, place.plate_px);
        fill_polygon(&polygon, size, &mut scratch);
        for (pixel, share) in plane.iter_mut().zip(&scratch) {
            *pixel += share * (level - *pixel);
        }
    }
    blur(&mut plane, size, blur_px, &mut scratch);
    plane.iter().map(|v| v.round() as u8).collect()
}

/// Outline of the plate, in units of its side.
pub(crate) const PLATE: [Vertex; 4] = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];

/// The outline of a drawing, rotated, scaled and translated.
pub(crate) fn placed(
    outline: &[Vertex],
    centre: [f32; 2],
    turn_rad: f32,
    scale: f32,
) -> Vec<Vertex> {
    let (sin, cos) = turn_rad.sin_cos();
    let place = |&[x, y]: &Vertex| {
        [
            centre[0] + scale * (cos * x - sin * y),
            centre[1] + scale * (sin * x + cos * y),
        ]
    };
    outline.iter().map(place).collect()
}
