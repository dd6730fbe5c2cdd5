//! The best possible accuracy of a marker's pose: the Cramér-Rao bound, from the border of its
//! drawing alone.
//!
//! Noise limits how well the displacement of a border can be measured. If a border of contrast C,
//! blurred to a standard deviation of s pixels, moves by a small distance along its normal, the sum
//! of the squared pixel changes is C²/(2 √π s) per pixel of its length and per squared pixel of the
//! distance. The Fisher information about the pose is obtained by integrating the displacement
//! along the normal over the border.

use std::f32::consts::PI;

use nalgebra::{Matrix3, Vector3};

use crate::marker::drawing::Drawing;

/// Viewing conditions of a plate.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    /// Side of the plate, pixels.
    pub(crate) plate_px: f32,
    /// Standard deviation of the lens blur, pixels.
    pub(crate) blur_px: f32,
    /// Standard deviation of a pixel's noise, relative to the contrast of marker and plate.
    pub(crate) noise: f32,
}

/// Minimum covariance of an unbiased estimate of the pose: x and y of the plate's centre in pixels,
/// heading in radians, in the frame of the drawing (x to the right, y down). `None` if the pose
/// cannot be determined, as for a disc.
///
/// Borders closer together than the blur give less information than assumed here: on plates of 24
/// pixels errors can be a fifth larger, on plates of 12 pixels a half.
pub(crate) fn least_covariance(drawing: &Drawing, view: View) -> Option<Matrix3<f32>> {
    let View {
        plate_px,
        blur_px,
        noise,
    } = view;
    // The pixel area widens the border by its own variance.
    let width = (blur_px * blur_px + 1.0 / 12.0).sqrt();
    let density = 1.0 / (2.0 * PI.sqrt() * width * noise * noise);
    let outline = &drawing.outline;
    let mut information = Matrix3::zeros();
    for (from, to) in outline.iter().zip(outline.iter().cycle().skip(1)) {
        let (from, to) = (from.map(|c| c * plate_px), to.map(|c| c * plate_px));
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        if length == 0.0 {
            continue;
        }
        let along = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
        let lever = |at: [f32; 2]| at[0] * along[0] + at[1] * along[1];
        // The lever arm varies linearly along an edge, so three points integrate its square exactly
        // (Simpson's rule).
        for (share, weight) in [(0.0, 1.0), (0.5, 4.0), (1.0, 1.0)] {
            let moved = Vector3::new(along[1], -along[0], -(lever(from) + share * length));
            information += moved * moved.transpose() * (density * weight / 6.0 * length);
        }
    }
    information.try_inverse()
}

/// Minimum standard deviation of the heading, radians; infinite if undetermined.
pub(crate) fn least_heading_sigma(drawing: &Drawing, view: View) -> f32 {
    least_covariance(drawing, view).map_or(f32::INFINITY, |covariance| covariance[(2, 2)].sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::built_in_files;
    use crate::marker::drawing::read_drawing;

    const SHARP: View = View {
        plate_px: 100.0,
        blur_px: 0.6,
        noise: 0.02,
    };

    fn drawing(outline: &[[f32; 2]]) -> Drawing {
        Drawing {
            name: String::new(),
            outline: outline.to_vec(),
        }
    }

    #[test]
    fn a_rectangle_is_as_its_sides_say() {
        let (w, h) = (0.6, 0.3);
        let rectangle = drawing(&[
            [-w / 2.0, -h / 2.0],
            [w / 2.0, -h / 2.0],
            [w / 2.0, h / 2.0],
            [-w / 2.0, h / 2.0],
        ]);
        let covariance = least_covariance(&rectangle, SHARP).expect("a pose");
        let density = 1.0 / (2.0 * PI.sqrt() * (0.36f32 + 1.0 / 12.0).sqrt() * 0.0004);
        let (w, h) = (w * 100.0, h * 100.0);
        // Two sides determine each coordinate, all four the heading: the integral of the squared
        // lever arm over each.
        let expected =
            [2.0 * h, 2.0 * w, (w.powi(3) + h.powi(3)) / 6.0].map(|i| 1.0 / (density * i));
        for i in 0..3 {
            let ratio = covariance[(i, i)] / expected[i];
            assert!((ratio - 1.0).abs() < 1e-3, "{i}: {ratio}");
        }
    }

    #[test]
    fn a_marker_off_the_centre_ties_its_place_to_its_heading() {
        let file = built_in_files().remove(0);
        let centred = read_drawing(&file.name, &file.svg).expect("a marker");
        let moved = drawing(
            &centred
                .outline
                .iter()
                .map(|[x, y]| [*x, y + 0.1])
                .collect::<Vec<_>>(),
        );
        let at = |drawing: &Drawing| least_covariance(drawing, SHARP).expect("a pose");
        let (a, b) = (at(&centred), at(&moved));
        assert!((b[(2, 2)] / a[(2, 2)] - 1.0).abs() < 1e-2);
        assert!(b[(0, 2)] != a[(0, 2)]);
    }

    #[test]
    fn a_disc_has_no_heading() {
        let corners: Vec<[f32; 2]> = (0..64)
            .map(|i| 2.0 * PI * i as f32 / 64.0)
            .map(|angle| [0.3 * angle.cos(), 0.3 * angle.sin()])
            .collect();
        let arrow = built_in_files().remove(0);
        let arrow = read_drawing(&arrow.name, &arrow.svg).expect("a marker");
        let [disc, arrow] = [&drawing(&corners), &arrow].map(|d| least_heading_sigma(d, SHARP));
        assert!(disc > 10.0 * arrow, "{disc} {arrow}");
    }
}
