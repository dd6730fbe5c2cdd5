//! Accuracy of positions, and plausibility of a calibration.
//!
//! Points are clicked by hand. The effect of a small click error on positions depends on the layout
//! of the points: it is small near the corners of the floor, and very large if they are nearly
//! collinear. With four points the residual does not show this.

use imgproc::Size;

use crate::geometry::calibration::{Calibration, FloorPoint, PointPair};

/// Click error: standard deviation in each direction, pixels.
pub(super) const CLICKED_PX: f64 = 0.5;

/// Effect of [`CLICKED_PX`] on positions among the points, in pixels, from which on there is a
/// warning, and above which the points are rejected. Four points at the corners of the image area
/// in use give 0.7.
const INEXACT_PX: f64 = 4.0;
pub(super) const INEXACT_MAX_PX: f64 = 25.0;

/// A wider pixel is implausible: 640 pixels would cover a floor of 190 m.
const WIDE_PIXEL_M: f64 = 0.3;

/// Effect of [`CLICKED_PX`] on positions, at the worst place of the bounding rectangle of the
/// points.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Inexactness {
    pub(super) metres: f64,
    pub(super) pixels: f64,
}

impl Calibration {
    /// The effect of click errors, computed by moving each point in turn.
    pub(super) fn inexactness(&self, points: &[PointPair]) -> Inexactness {
        const PLACES: usize = 5;
        let extreme = |axis: usize, pick: fn(f64, f64) -> f64| {
            points
                .iter()
                .map(|p| p.pixel[axis])
                .reduce(pick)
                .unwrap_or_default()
        };
        let place = |i: usize, axis: usize| {
            let (min, max) = (extreme(axis, f64::min), extreme(axis, f64::max));
            min + (max - min) * i as f64 / (PLACES - 1) as f64
        };
        // Places beyond the horizon have no position, but the points themselves have.
        let places: Vec<([f64; 2], FloorPoint)> = (0..PLACES * PLACES)
            .map(|i| [place(i % PLACES, 0), place(i / PLACES, 1)])
            .filter_map(|pixel| Some((pixel, self.to_floor(pixel)?)))
            .collect();
        let mut variances = vec![0.0; places.len()];
        for (i, axis) in (0..points.len()).flat_map(|i| [(i, 0), (i, 1)]) {
            let mut clicked = points.to_vec();
            clicked[i].pixel[axis] += CLICKED_PX;
            let moved = Self::fit_map(&clicked).ok();
            for ((pixel, floor), variance) in places.iter().zip(&mut variances) {
                *variance += match moved.as_ref().and_then(|moved| moved.to_floor(*pixel)) {
                    Some(FloorPoint { at: [x, y], .. }) => {
                        (x - floor.at[0]).powi(2) + (y - floor.at[1]).powi(2)
                    }
                    None => f64::INFINITY,
                };
            }
        }
        let mut worst = Inexactness::default();
        for ((_, floor), variance) in places.iter().zip(variances) {
            let metres = variance.sqrt();
            worst.metres = worst.metres.max(metres);
            worst.pixels = worst.pixels.max(metres / floor.metres_per_px());
        }
        worst
    }

    /// Remarks for the user, one per line: the accuracy of positions, and anything implausible.
    #[must_use]
    pub(crate) fn remarks(&self, size: Size) -> Vec<String> {
        let Inexactness { metres, pixels } = self.inexactness;
        let residual = match self.n_points {
            4 => "four points leave no residual to check them by".to_owned(),
            _ => format!("the calibration's residual is {:.2} px", self.residual_px),
        };
        let mut remarks = vec![format!(
            "positions are in metres on the floor; {residual}; clicks {CLICKED_PX} px off move them by up to {metres:.3} m among the points"
        )];
        if pixels > INEXACT_PX {
            remarks.push(format!(
                "that is {pixels:.0} px: the calibration's points lie nearly on a line or close together; add some near the corners of the floor"
            ));
        }
        if let Some(width_m) = self.metres_per_px().filter(|width| *width > WIDE_PIXEL_M) {
            let floor_m = width_m * size.width as f64;
            remarks.push(format!(
                "a pixel is {width_m:.2} m wide and the picture {floor_m:.0} m: if the calibration's floor points are in millimetres or \
                 centimetres, write them in metres"
            ));
        }
        remarks
    }

    /// Smallest and largest size in pixels at which plates of a given size appear in the image.
    pub(crate) fn plate_px(&self, plate_mm: f32, size: Size) -> Option<(f64, f64)> {
        const PLACES: usize = 5;
        let place = |i: usize, side: usize| (side - 1) as f64 * i as f64 / (PLACES - 1) as f64;
        let widths = (0..PLACES * PLACES)
            .map(|i| {
                [
                    place(i % PLACES, size.width),
                    place(i / PLACES, size.height),
                ]
            })
            .filter_map(|pixel| self.to_floor(pixel))
            .map(|floor| f64::from(plate_mm) / 1000.0 / floor.metres_per_px());
        widths.fold(None, |range, width| {
            let (min, max) = range.unwrap_or((width, width));
            Some((width.min(min), width.max(max)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::calibration::CalibrationError;
    use crate::geometry::calibration::tests::{CORNERS, pairs};

    /// Three of four points near a line: half a pixel decides on which side the fourth corner is.
    #[test]
    fn points_nearly_on_a_line_are_refused_with_what_they_would_do() {
        let near = [[20.0, 20.0], [160.5, 118.8], [300.0, 220.0], [25.0, 215.0]];
        let error = Calibration::fit(&pairs(&near)).expect_err("inexact");
        let CalibrationError::Inexact { metres, pixels } = error else {
            panic!("{error}")
        };
        assert!(pixels > 25.0 && metres > 0.25, "{error}");
        assert!(error.to_string().contains("nearly on a line"), "{error}");
    }

    #[test]
    fn what_is_odd_is_remarked() {
        const VGA: Size = Size {
            width: 640,
            height: 480,
        };
        let remarks = |points: &[PointPair]| Calibration::fit(points).expect("a fit").remarks(VGA);
        let good = remarks(&pairs(&CORNERS));
        assert_eq!(good.len(), 1, "{good:?}");
        assert!(
            good[0].contains("four points leave no residual"),
            "{good:?}"
        );
        assert!(good[0].contains("by up to 0.00"), "{good:?}");

        let mut more = CORNERS.to_vec();
        more.push([300.0, 200.0]);
        let more = remarks(&pairs(&more));
        assert!(more[0].contains("residual is 0.00 px"), "{more:?}");

        let close = [[20.0, 20.0], [300.0, 200.0], [300.0, 220.0], [25.0, 60.0]];
        let close = remarks(&pairs(&close));
        assert!(
            close[1].contains("nearly on a line or close together"),
            "{close:?}"
        );

        let mut millimetres = pairs(&CORNERS);
        millimetres
            .iter_mut()
            .for_each(|p| p.floor = p.floor.map(|c| 1000.0 * c));
        let wide = remarks(&millimetres);
        assert!(
            wide[1].contains("m wide") && wide[1].contains("write them in metres"),
            "{wide:?}"
        );
        let calibration = Calibration::fit(&millimetres).expect("a fit");
        let (min, max) = calibration.plate_px(300.0, VGA).expect("on the floor");
        assert!(0.02 < min && max < 0.05, "{min} {max}");
    }
}
