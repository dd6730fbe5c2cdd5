//! The homography between two planes: direct linear transform on normalised points (Hartley and
//! Zisserman, "Multiple View Geometry", algorithm 4.2).

use nalgebra::{DMatrix, Matrix3, Point2, Vector3};

use crate::geometry::calibration::{CalibrationError, PointPair};

/// Minimum ratio of the second smallest singular value of the equations to the largest. Below it,
/// the points are collinear and any map fits.
pub(super) const INDEPENDENCE_MIN: f64 = 1e-3;

/// Fits the homography to at least four points.
pub(super) fn homography(points: &[PointPair]) -> Result<Matrix3<f64>, CalibrationError> {
    let image = normalisation(points.iter().map(|p| p.pixel))?;
    let floor = normalisation(points.iter().map(|p| p.floor))?;
    // Two equations per point; at least nine rows, so that the decomposition has nine singular
    // values.
    let mut equations = DMatrix::zeros((2 * points.len()).max(9), 9);
    for (i, pair) in points.iter().enumerate() {
        let from = image.transform_point(&Point2::from(pair.pixel));
        let to = floor.transform_point(&Point2::from(pair.floor));
        let (x, y, u, v) = (from.x, from.y, to.x, to.y);
        let rows = [
            [x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y, -u],
            [0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y, -v],
        ];
        for (row, coefficients) in rows.iter().enumerate() {
            for (column, &coefficient) in coefficients.iter().enumerate() {
                equations[(2 * i + row, column)] = coefficient;
            }
        }
    }
    let svd = equations.svd(false, true);
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&a, &b| svd.singular_values[b].total_cmp(&svd.singular_values[a]));
    let independence = svd.singular_values[order[7]] / svd.singular_values[order[0]];
    let v_t = svd
        .v_t
        .filter(|_| independence >= INDEPENDENCE_MIN)
        .ok_or(CalibrationError::Degenerate(independence))?;
    let solution = v_t.row(order[8]);
    let normalised = Matrix3::from_fn(|row, column| solution[3 * row + column]);
    let back = floor
        .try_inverse()
        .ok_or(CalibrationError::Degenerate(0.0))?;
    let map = back * normalised * image;
    // The scale is free; choose its sign so that the first point is on the positive side of the
    // horizon.
    let [x, y] = points[0].pixel;
    let side = (map * Vector3::new(x, y, 1.0)).z;
    if side.abs() < f64::EPSILON || !side.is_finite() {
        return Err(CalibrationError::Degenerate(independence));
    }
    Ok(map / side)
}

/// Translates points to the origin and scales their mean distance from it to √2.
fn normalisation(
    points: impl Iterator<Item = [f64; 2]> + Clone,
) -> Result<Matrix3<f64>, CalibrationError> {
    let n = points.clone().count() as f64;
    let sum = points
        .clone()
        .fold([0.0, 0.0], |sum, p| [sum[0] + p[0], sum[1] + p[1]]);
    let [x, y] = sum.map(|s| s / n);
    let distance = points.map(|p| (p[0] - x).hypot(p[1] - y)).sum::<f64>() / n;
    if distance <= f64::EPSILON {
        return Err(CalibrationError::Degenerate(0.0));
    }
    let scale = std::f64::consts::SQRT_2 / distance;
    Ok(Matrix3::new(
        scale,
        0.0,
        -scale * x,
        0.0,
        scale,
        -scale * y,
        0.0,
        0.0,
        1.0,
    ))
}
