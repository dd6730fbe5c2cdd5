//! Which points are wrong where points contradict each other.
//!
//! A least-squares fit spreads the error of one point over its neighbours, and a corner, on which nothing else pulls, hides most of
//! its own: the point with the greatest residual is often another one. So each point is left out in turn, and each pair, and
//! the fit of the others tells. Of five points it does not, for any four fit: there the camera is taken to look nearly straight
//! down, and the four are compared with an affine map.

use std::fmt;

use nalgebra::{DMatrix, DVector};

use crate::geometry::calibration::{Calibration, PointPair, RESIDUAL_MAX_PX, root_mean_square};

/// A point is wrong without doubt where the others fit this much better than without any other point.
const CLEARLY_BETTER: f64 = 2.0;

/// The same for the affine maps of five points, which fit no real camera exactly.
const CLEARLY_BETTER_AFFINE: f64 = 4.0;

/// Pairs are left out only of so many points, which takes some thousand fits.
const PAIRS_MAX: usize = 60;

/// Where one point is so far off, pixels, and so many times as far as the others differ, they contradict it although the fit of all is
/// not bad.
const OFF_PX: f64 = 10.0;
const OFF_RATIO: f64 = 20.0;

/// Which points are to blame, counted from 1.
#[derive(Debug, Clone, PartialEq)]
pub enum Suspects {
    /// This one, so many pixels from where the others say it is.
    One(usize, f64),
    /// One of these, it cannot be told which.
    OneOf(Vec<usize>),
    /// Both of these.
    Two(usize, usize),
    /// There are too few points to say more: one of these two of five is the most likely.
    OneOfFive(usize, usize),
    /// No one or two; this one has the greatest residual, pixels.
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

/// What the other points say when some are left out.
struct Left {
    out: Vec<usize>,
    rms_px: f64,
}

/// Who is to blame. `residuals_px` are those of the fit of all.
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
    // The others must be six at least: of five, any four fit.
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

/// Whether one point is far from where all others say it is, although the fit of all of them is not bad.
pub(super) fn is_contradicted(points: &[PointPair]) -> bool {
    points.len() > 5
        && (0..points.len()).any(|i| {
            let Some(fit) = leave_out(points, vec![i]) else {
                return false;
            };
            off_px(points, i).is_some_and(|off| off > OFF_PX && off > OFF_RATIO * fit.rms_px)
        })
}

/// The others fit together, and much better than all of them.
fn is_good(fit: &Left, residuals_px: &[f64]) -> bool {
    fit.rms_px <= RESIDUAL_MAX_PX && CLEARLY_BETTER * fit.rms_px < root_mean_square(residuals_px)
}

/// The fit without some points; `None` where there is none.
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

/// How far a point is from where the others say it is, in the picture.
fn off_px(points: &[PointPair], point: usize) -> Option<f64> {
    let others = Calibration::fit_map(&without(points, &[point])).ok()?;
    let residuals = others.residuals_px(&points[point..=point]).ok()?;
    residuals.first().copied().filter(|px| px.is_finite())
}

/// Which of five points is the odd one where the camera looks nearly straight down.
fn one_of_five(points: &[PointPair]) -> Suspects {
    let mut scores: Vec<(usize, f64)> = (0..points.len())
        .map(|i| (i, affine_residual_px(&without(points, &[i]))))
        .collect();
    scores.sort_by(|a, b| a.1.total_cmp(&b.1));
    let [(first, best), (second, next), ..] = scores[..] else {
        return Suspects::Many(1, f64::NAN);
    };
    // Four that are no plane's picture at all are no evidence.
    if CLEARLY_BETTER_AFFINE * best < next && best <= RESIDUAL_MAX_PX {
        let off = off_px(points, first).unwrap_or(next);
        return Suspects::One(first + 1, off);
    }
    Suspects::OneOfFive(first.min(second) + 1, first.max(second) + 1)
}

/// Root mean square of what an affine map from floor to picture leaves.
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

    /// A camera, tilted by so much, a hundred pixels a metre; clicks are half a pixel off at most.
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

    /// Of six points every one is found, wherever it was moved to.
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
        // In another order of half of them nobody can be blamed.
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
        // With the fifth in the middle of two corners the others are as likely as each other.
        let mut points = clicked(&SIX[..5], 0.0);
        points[1].pixel[0] += 30.0;
        points[1].pixel[1] += 30.0;
        assert_eq!(blamed(&points), Suspects::OneOfFive(2, 4));
        let mut points = clicked(&SIX[..5], 3e-4);
        points[4].pixel[1] += 30.0;
        let said = blamed(&points).to_string();
        assert!(
            said.contains(" or point ") && said.contains("a sixth"),
            "{said}"
        );
    }
}
