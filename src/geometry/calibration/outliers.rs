//! Finds the wrong points if the points contradict each other.
//!
//! A least-squares fit spreads the error of one point over its neighbours, and a corner point,
//! which no other point constrains, hides most of its own error: the largest residual is often at
//! another point. So each point, and each pair of points, is left out in turn, and the fit of the
//! others is compared. With five points this is impossible, since any four fit. In that case the
//! camera is assumed to look nearly straight down, and the four are compared with an affine map.

use std::fmt;

use nalgebra::{DMatrix, DVector};

use crate::geometry::calibration::{Calibration, PointPair, RESIDUAL_MAX_PX, root_mean_square};

/// A point is certainly wrong if the others fit this much better than after leaving out any other
/// point.
const CLEARLY_BETTER: f64 = 2.0;

/// The same for the affine maps of five points, which fit no real camera exactly.
const CLEARLY_BETTER_AFFINE: f64 = 4.0;

/// Pairs are left out for at most this many points, which takes some thousand fits.
const PAIRS_MAX: usize = 60;

/// If one point is off by this many pixels, and by this many times the residual of the others, it
/// contradicts them even if the fit of all is acceptable.
const OFF_PX: f64 = 10.0;
const OFF_RATIO: f64 = 20.0;

/// The points at fault, counted from 1.
#[derive(Debug, Clone, PartialEq)]
pub enum Suspects {
    /// This point, and its distance in pixels from the position predicted by the others.
    One(usize, f64),
    /// One of these; which one is undetermined.
    OneOf(Vec<usize>),
    /// Both of these.
    Two(usize, usize),
    /// One of these two of five is the most likely; there are too few points for more.
    OneOfFive(usize, usize),
    /// More than two; this one has the largest residual, pixels.
    Many(usize, f64),
}

impl fmt::Display for Suspects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::One(point, off_px) => {
                write!(
                    f,
                    "point {point} is off by {off_px:.1} px: measure it again"
                )
            }
            Self::OneOf(points) => {
                let names: Vec<String> = points.iter().map(usize::to_string).collect();
                write!(
                    f,
                    "one of the points {} is wrong: measure them again",
                    names.join(", ")
                )
            }
            Self::Two(a, b) => write!(f, "the points {a} and {b} are wrong: measure them again"),
            Self::OneOfFive(a, b) => write!(
                f,
                "it is most likely point {a} or point {b}, which five points do not tell: measure both again, or a sixth"
            ),
            Self::Many(point, off_px) => write!(
                f,
                "no one or two of them are to blame: check the order of the points, or whether the lens bends straight lines; \
                 the greatest residual, {off_px:.1} px, is that of point {point}"
            ),
        }
    }
}

/// The fit without some of the points.
struct Left {
    out: Vec<usize>,
    rms_px: f64,
}

/// The points at fault. `residuals_px` are the residuals of the fit of all points.
pub(super) fn suspects(points: &[PointPair], residuals_px: &[f64]) -> Suspects {
    if points.len() == 5 {
        return one_of_five(points);
    }
    let singles = (0..points.len()).map(|i| vec![i]);
    let mut fits: Vec<Left> = singles.filter_map(|out| leave_out(points, out)).collect();
    fits.sort_by(|a, b| a.rms_px.total_cmp(&b.rms_px));
    if let Some(best) = fits.first().filter(|fit| is_good(fit, residuals_px)) {
        let alike = |fit: &&Left| fit.rms_px < CLEARLY_BETTER * best.rms_px;
        let likely: Vec<usize> = fits
            .iter()
            .take_while(alike)
            .map(|fit| fit.out[0] + 1)
            .collect();
        return match likely[..] {
            [] | [_] => {
                let point = best.out[0];
                Suspects::One(
                    point + 1,
                    off_px(points, point).unwrap_or(residuals_px[point]),
                )
            }
            _ => Suspects::OneOf(likely),
        };
    }
    // At least six points must remain: of five, any four fit.
    if (8..=PAIRS_MAX).contains(&points.len()) {
        let pairs = (0..points.len()).flat_map(|i| (0..i).map(move |j| vec![j, i]));
        let best = pairs
            .filter_map(|out| leave_out(points, out))
            .min_by(|a, b| a.rms_px.total_cmp(&b.rms_px));
        if let Some(best) = best.filter(|fit| is_good(fit, residuals_px)) {
            return Suspects::Two(best.out[0] + 1, best.out[1] + 1);
        }
    }
    let worst = residuals_px
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(b.1));
    worst.map_or(Suspects::Many(1, f64::NAN), |(i, px)| {
        Suspects::Many(i + 1, *px)
    })
}

/// Whether one point is far from the position predicted by all others, although the fit of all is
/// acceptable.
pub(super) fn is_contradicted(points: &[PointPair]) -> bool {
    points.len() > 5
        && (0..points.len()).any(|i| {
            let Some(fit) = leave_out(points, vec![i]) else {
                return false;
            };
            off_px(points, i).is_some_and(|off| off > OFF_PX && off > OFF_RATIO * fit.rms_px)
        })
}

/// Whether the remaining points fit together, and much better than all points.
fn is_good(fit: &Left, residuals_px: &[f64]) -> bool {
    fit.rms_px <= RESIDUAL_MAX_PX && CLEARLY_BETTER * fit.rms_px < root_mean_square(residuals_px)
}

/// The fit without some points; `None` if there is none.
fn leave_out(points: &[PointPair], out: Vec<usize>) -> Option<Left> {
    let others = without(points, &out);
    let residuals = Calibration::fit_map(&others)
        .ok()?
        .residuals_px(&others)
        .ok()?;
    let rms_px = root_mean_square(&residuals);
    rms_px.is_finite().then_some(Left { out, rms_px })
}

fn without(points: &[PointPair], out: &[usize]) -> Vec<PointPair> {
    let others = points.iter().enumerate().filter(|(i, _)| !out.contains(i));
    others.map(|(_, pair)| *pair).collect()
}

/// Distance in the image between a point and its position predicted by the others.
fn off_px(points: &[PointPair], point: usize) -> Option<f64> {
    let others = Calibration::fit_map(&without(points, &[point])).ok()?;
    let residuals = others.residuals_px(&points[point..=point]).ok()?;
    residuals.first().copied().filter(|px| px.is_finite())
}

/// The outlier of five points for a camera that looks nearly straight down.
fn one_of_five(points: &[PointPair]) -> Suspects {
    let mut scores: Vec<(usize, f64)> = (0..points.len())
        .map(|i| (i, affine_residual_px(&without(points, &[i]))))
        .collect();
    scores.sort_by(|a, b| a.1.total_cmp(&b.1));
    let [(first, best), (second, next), ..] = scores[..] else {
        return Suspects::Many(1, f64::NAN);
    };
    // Four points that no plane fits are no evidence.
    if CLEARLY_BETTER_AFFINE * best < next && best <= RESIDUAL_MAX_PX {
        let off = off_px(points, first).unwrap_or(next);
        return Suspects::One(first + 1, off);
    }
    Suspects::OneOfFive(first.min(second) + 1, first.max(second) + 1)
}

/// RMS residual of an affine map from floor to image.
fn affine_residual_px(points: &[PointPair]) -> f64 {
    let n = points.len();
    let floor = DMatrix::from_fn(n, 3, |row, column| {
        points[row].floor.get(column).copied().unwrap_or(1.0)
    });
    let svd = floor.clone().svd(true, true);
    let squares = [0, 1].map(|axis| {
        let pixels = DVector::from_fn(n, |row, _| points[row].pixel[axis]);
        match svd.solve(&pixels, 1e-12) {
            Ok(map) => (floor.clone() * map - pixels).norm_squared(),
            Err(_) => f64::INFINITY,
        }
    });
    (squares.iter().sum::<f64>() / n as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::calibration::CalibrationError;

    /// A camera with a tilt, a hundred pixels per metre; click errors are at most half a pixel.
    fn clicked(pixels: &[[f64; 2]], tilt: f64) -> Vec<PointPair> {
        let floor = |[x, y]: [f64; 2]| {
            let w = 1.0 + tilt * (0.5 * x - y);
            [(0.01 * x - 3.2) / w, (2.4 - 0.01 * y) / w]
        };
        let off = |i: usize| [0.5 * (i as f64 * 2.4).sin(), 0.5 * (i as f64 * 1.7).cos()];
        pixels
            .iter()
            .enumerate()
            .map(|(i, &pixel)| PointPair {
                pixel: [pixel[0] + off(i)[0], pixel[1] + off(i)[1]],
                floor: floor(pixel),
            })
            .collect()
    }

    fn blamed(points: &[PointPair]) -> Suspects {
        match Calibration::fit(points) {
            Err(CalibrationError::BadFit { suspects, .. }) => suspects,
            other => panic!("{other:?}"),
        }
    }

    const SIX: [[f64; 2]; 6] = [
        [40.0, 40.0],
        [600.0, 40.0],
        [600.0, 440.0],
        [40.0, 440.0],
        [320.0, 240.0],
        [320.0, 40.0],
    ];

    /// Each of six points is found, wherever it was moved to.
    #[test]
    fn the_wrong_one_of_six_is_named() {
        for tilt in [0.0, 2e-4] {
            for (bad, turn) in (0..6).flat_map(|bad| (0..8).map(move |turn| (bad, turn))) {
                let mut points = clicked(&SIX, tilt);
                let angle = f64::from(turn) * std::f64::consts::FRAC_PI_4;
                points[bad].pixel[0] += 30.0 * angle.cos();
                points[bad].pixel[1] += 30.0 * angle.sin();
                let suspects = blamed(&points);
                let named = match &suspects {
                    Suspects::One(point, off) => *point == bad + 1 && (20.0..45.0).contains(off),
                    Suspects::OneOf(points) => points.len() < 3 && points.contains(&(bad + 1)),
                    _ => false,
                };
                assert!(named, "{bad} {turn} {tilt}: {suspects:?}");
            }
        }
    }

    #[test]
    fn two_wrong_ones_of_nine_are_named() {
        let grid: Vec<[f64; 2]> = (0..9)
            .map(|i| {
                [
                    60.0 + 260.0 * f64::from(i % 3),
                    50.0 + 180.0 * f64::from(i / 3),
                ]
            })
            .collect();
        let mut points = clicked(&grid, 1e-4);
        points[2].pixel[0] += 25.0;
        points[6].pixel[1] -= 40.0;
        assert_eq!(blamed(&points), Suspects::Two(3, 7));
        // With half of them in another order, no point can be singled out.
        let mut points = clicked(&grid, 1e-4);
        for i in 0..4 {
            let floor = points[i].floor;
            points[i].floor = points[(i + 4) % 9].floor;
            points[(i + 4) % 9].floor = floor;
        }
        if let Err(error) = Calibration::fit(&points) {
            assert!(!error.to_string().contains("is off by"), "{error}");
        }
    }

    #[test]
    fn of_five_the_odd_one_is_named_only_where_it_shows() {
        let mut five = SIX[..5].to_vec();
        five[4] = [450.0, 110.0];
        let mut points = clicked(&five, 0.0);
        points[1].pixel[0] += 30.0;
        points[1].pixel[1] += 30.0;
        assert!(
            matches!(blamed(&points), Suspects::One(2, _)),
            "{:?}",
            blamed(&points)
        );
        // With the fifth point midway between two corners, the others are equally likely.
        let mut points = clicked(&SIX[..5], 0.0);
        points[1].pixel[0] += 30.0;
        points[1].pixel[1] += 30.0;
        assert_eq!(blamed(&points), Suspects::OneOfFive(2, 4));
        let mut points = clicked(&SIX[..5], 3e-4);
        points[4].pixel[1] += 30.0;
        let message = blamed(&points).to_string();
        assert!(
            message.contains(" or point ") && message.contains("a sixth"),
            "{message}"
        );
    }
}
