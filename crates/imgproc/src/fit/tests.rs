//! Fits of plates whose picture is known exactly.

use super::view::PIXEL_VARIANCE;
use super::*;
use random::SplitMix64;
use std::{vec, vec::Vec};

const SIDE: usize = 105;
const PER_PLATE: f32 = 96.0;
const FIRST_BLUR: f32 = 0.01;
const LAYERS: usize = 11;

/// Rectangles of a flag on its pole: left, top, right, bottom in units of the plate.
const FLAG: [[f32; 4]; 2] = [[-0.2, -0.35, -0.05, 0.35], [-0.05, -0.35, 0.3, 0.0]];

/// The error function, to 1e-7 (Abramowitz and Stegun 7.1.26).
fn erf(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.3275911 * x.abs());
    let poly = [
        1.061405429,
        -1.453152027,
        1.421413741,
        -0.284496736,
        0.254829592,
    ]
    .into_iter()
    .fold(0.0, |sum, c| (sum + c) * t);
    (1.0 - poly * (-x * x).exp()).copysign(x)
}

/// The flag through a Gaussian lens: each rectangle is a product of two edges in x and two in
/// y.
fn coverage(u: f32, v: f32, blur: f32) -> f32 {
    let edge = |d: f32| 0.5 * erf(f64::from(d / blur) / 2f64.sqrt());
    let within = |c: f32, from: f32, to: f32| edge(c - from) - edge(c - to);
    FLAG.iter()
        .map(|&[left, top, right, bottom]| within(u, left, right) * within(v, top, bottom))
        .sum::<f64>() as f32
}

fn samples() -> Vec<f32> {
    let at = |i: usize| (i as f32 - (SIDE / 2) as f32) / PER_PLATE;
    let layer = |layer: usize| {
        let blur = FIRST_BLUR * 2f32.powf(layer as f32 / 2.0);
        (0..SIDE * SIDE).map(move |i| coverage(at(i % SIDE), at(i / SIDE), blur))
    };
    (0..LAYERS).flat_map(layer).collect()
}

fn layers(samples: &[f32]) -> Layers<'_> {
    Layers {
        samples,
        side: SIDE,
        per_plate: PER_PLATE,
        first_blur: FIRST_BLUR,
        blur_ratio: 2f32.sqrt(),
    }
}

/// A plate in light that increases to the right, on a background of another grey level.
fn picture(size: Size, pose: &Pose, noise: impl FnMut() -> f32) -> Vec<u8> {
    picture_with(&ToneCurve::new(1.0), size, pose, noise)
}

/// The same as a camera with a tone curve shows it.
fn picture_with(
    tone: &ToneCurve,
    size: Size,
    pose: &Pose,
    mut noise: impl FnMut() -> f32,
) -> Vec<u8> {
    let (sin, cos) = pose.turn_rad.sin_cos();
    let spread = (pose.blur_px * pose.blur_px + PIXEL_VARIANCE).sqrt() / pose.plate_px;
    (0..size.area())
        .map(|i| {
            let [dx, dy] = [
                (i % size.width) as f32 - pose.centre[0],
                (i / size.width) as f32 - pose.centre[1],
            ];
            let u = (cos * dx + sin * dy) / pose.plate_px;
            let v = (cos * dy - sin * dx) / pose.plate_px;
            let light = if u.abs().max(v.abs()) > 0.5 {
                90.0
            } else {
                (200.0 + 0.3 * dx) * (1.0 - 0.8 * coverage(u, v, spread))
            };
            (tone.grey(light) + noise()).round().clamp(0.0, 255.0) as u8
        })
        .collect()
}

const SIZE: Size = Size {
    width: 180,
    height: 170,
};

const PRIOR: Prior = Prior {
    noise: 0.3,
    blur_ln_sigma: 0.35,
    plate_ln_sigma: 0.1,
    tone: 1.0,
    tone_sigma: 0.05,
    sharpening: 0.0,
    sharpening_sigma: 0.05,
    residual_ratio_max: 0.04,
    may_be_covered: false,
};

/// The pose of the plate with this number.
fn some_pose(i: usize, plate_px: f32) -> Pose {
    Pose {
        centre: [88.3 + 0.11 * i as f32, 84.8],
        turn_rad: 0.9 * i as f32 - 2.0,
        plate_px,
        blur_px: 0.8,
    }
}

/// Distance of two centres, pixels.
fn off(pose: &Pose, truth: &Pose) -> f32 {
    (pose.centre[0] - truth.centre[0]).hypot(pose.centre[1] - truth.centre[1])
}

fn near(pose: &Pose) -> Pose {
    Pose {
        centre: [pose.centre[0] + 0.7, pose.centre[1] - 0.6],
        turn_rad: pose.turn_rad + 0.052,
        plate_px: pose.plate_px * 1.05,
        blur_px: 0.65,
    }
}

#[test]
fn the_pose_is_found_from_a_start_nearby() {
    let samples = samples();
    for (i, plate_px) in [12.0, 16.0, 24.0, 48.0, 79.0, 81.0, 130.0]
        .into_iter()
        .enumerate()
    {
        let truth = some_pose(i, plate_px);
        let plane = picture(SIZE, &truth, || 0.0);
        let fit = fit_shape(&plane, SIZE, None, layers(&samples), near(&truth), &PRIOR)
            .unwrap_or_else(|| panic!("{plate_px}: a plate that is there"));
        let off = off(&fit.pose, &truth);
        let turned = (fit.pose.turn_rad - truth.turn_rad).abs();
        assert!(off < 0.01, "{plate_px}: {off} px");
        assert!(turned < 0.03 / plate_px, "{plate_px}: {turned} rad");
        assert!((fit.pose.plate_px / plate_px - 1.0).abs() < 0.01);
        // Block means say little about a blur smaller than a block.
        let shows_blur = fit.block_px == 1;
        assert!(
            !shows_blur || (fit.pose.blur_px - 0.8).abs() < 0.2,
            "{plate_px}: {}",
            fit.pose.blur_px
        );
        assert!(fit.r_squared > 0.99, "{plate_px}: {}", fit.r_squared);
        assert!((fit.light - 200.0).abs() < 2.0 && (fit.contrast - 160.0).abs() < 3.0);
        assert!(
            fit.residual < 4.0 * fit.block_px as f32,
            "{plate_px}: {}",
            fit.residual
        );
    }
}

#[test]
fn a_tone_curve_is_found_with_the_pose() {
    let samples = samples();
    for (i, (exponent, plate_px)) in [(0.42, 20.0), (0.6, 30.0), (0.45, 60.0), (0.45, 100.0)]
        .into_iter()
        .enumerate()
    {
        let truth = some_pose(i, plate_px);
        let plane = picture_with(&ToneCurve::new(exponent), SIZE, &truth, || 0.0);
        let unknown = Prior {
            tone: 0.75,
            tone_sigma: 0.3,
            ..PRIOR
        };
        let fit = fit_shape(&plane, SIZE, None, layers(&samples), near(&truth), &unknown)
            .unwrap_or_else(|| panic!("{exponent}: a plate that is there"));
        let off = off(&fit.pose, &truth);
        // Blocks of a large plate are averaged with the expected curve.
        assert!((fit.tone - exponent).abs() < 0.05, "{}", fit.tone);
        assert!(off < 0.02, "{exponent}: {off} px");
        // A linear camera would have another picture.
        let linear = Prior {
            tone: 1.0,
            tone_sigma: 1e-3,
            ..PRIOR
        };
        let other = fit_shape(&plane, SIZE, None, layers(&samples), near(&truth), &linear);
        let is_worse = other.is_none_or(|other| other.residual > 1.5 * fit.residual);
        assert!(is_worse || fit.block_px > 1, "{exponent}");
    }
}

/// For a camera that may sharpen.
const SHARPENED: Prior = Prior {
    noise: 1.0,
    sharpening: 0.3,
    sharpening_sigma: 0.5,
    ..PRIOR
};

/// A plate through a camera that sharpens. With less contrast than in the other pictures, so that no
/// overshoot is cut off.
fn sharpened(truth: &Pose, sharpening: f32) -> Vec<u8> {
    let softer = Pose {
        blur_px: (truth.blur_px * truth.blur_px + 1.0).sqrt(),
        ..*truth
    };
    let seen = |pose: &Pose| {
        let plane = picture(SIZE, pose, || 0.0).into_iter();
        plane.map(|grey| 60.0 + 0.5 * f32::from(grey))
    };
    seen(truth)
        .zip(seen(&softer))
        .map(|(own, soft)| (own + sharpening * (own - soft)).round() as u8)
        .collect()
}

#[test]
fn sharpening_is_found_with_the_pose() {
    let samples = samples();
    for (i, (sharpening, plate_px)) in [(0.5, 20.0), (1.5, 30.0), (2.0, 60.0)]
        .into_iter()
        .enumerate()
    {
        let truth = some_pose(i, plate_px);
        let plane = sharpened(&truth, sharpening);
        let start = near(&truth);
        let fit = fit_shape(&plane, SIZE, None, layers(&samples), start, &SHARPENED)
            .unwrap_or_else(|| panic!("{sharpening}: a plate that is there"));
        let off = off(&fit.pose, &truth);
        assert!(off < 0.02, "{sharpening}: {off} px");
        let blurred = (fit.pose.blur_px / truth.blur_px - 1.0).abs();
        assert!(blurred < 0.15, "{sharpening}: {}", fit.pose.blur_px);
        let found = fit.sharpening / sharpening;
        assert!(
            (0.8..1.25).contains(&found),
            "{sharpening}: {}",
            fit.sharpening
        );
        assert!(fit.residual < 2.0, "{sharpening}: {}", fit.residual);
    }
}

/// A picture that is mixed with a softer one has more blur, not negative sharpening.
#[test]
fn a_softened_picture_is_a_blurred_one() {
    let samples = samples();
    let truth = some_pose(1, 24.0);
    let plane = sharpened(&truth, -0.2);
    let start = near(&truth);
    let fit = fit_shape(&plane, SIZE, None, layers(&samples), start, &SHARPENED)
        .expect("a plate that is there");
    assert!(off(&fit.pose, &truth) < 0.02);
    assert!((0.0..0.05).contains(&fit.sharpening), "{}", fit.sharpening);
    assert!(fit.pose.blur_px > truth.blur_px, "{}", fit.pose.blur_px);
}

#[test]
fn a_covered_plate_is_found_and_so_is_what_is_hidden() {
    let samples = samples();
    let truth = Pose {
        centre: [88.3, 84.8],
        turn_rad: 0.4,
        plate_px: 30.0,
        blur_px: 0.8,
    };
    let expected = Prior {
        noise: 1.0,
        plate_ln_sigma: 0.01,
        may_be_covered: true,
        ..PRIOR
    };
    let near = Pose {
        centre: [truth.centre[0] + 0.4, truth.centre[1] - 0.3],
        ..truth
    };
    let fit =
        |plane: &[u8], prior: &Prior| fit_shape(plane, SIZE, None, layers(&samples), near, prior);
    let off = |fit: &Fit| off(&fit.pose, &truth);
    let bare = picture(SIZE, &truth, || 0.0);
    let whole = fit(&bare, &expected).expect("a plate that is there");
    assert!(off(&whole) < 0.01, "{}", off(&whole));
    assert_eq!(whole.hidden, [0.0; 2]);
    // From a side of the plate, and in its middle.
    for (from_x, to_x, inside, rim) in [
        (96.0, 110.0, 0.1..0.3, 0.15..0.5),
        (84.0, 92.0, 0.1..0.3, 0.0..0.02),
    ] {
        let is_middle = from_x < 90.0;
        let mut plane = bare.clone();
        for (i, pixel) in plane.iter_mut().enumerate() {
            let [x, y] = [i % SIZE.width, i / SIZE.width].map(|c| c as f32);
            let in_height = !is_middle || (y - truth.centre[1]).abs() < 9.0;
            if (from_x..to_x).contains(&x) && in_height {
                *pixel = 120;
            }
        }
        let covered = fit(&plane, &expected).expect("enough of it is seen");
        assert!(off(&covered) < 0.05, "{}", off(&covered));
        assert!(inside.contains(&covered.hidden[0]), "{:?}", covered.hidden);
        assert!(rim.contains(&covered.hidden[1]), "{:?}", covered.hidden);
        let plain = Prior {
            may_be_covered: false,
            ..expected
        };
        assert!(fit(&plane, &plain).is_none_or(|fit| fit.residual > 2.0 * covered.residual));
    }
}

/// A plate that is seen at an angle: compressed along its own u axis. The blur is round in the
/// picture.
fn compressed(size: Size, pose: &Pose, share: f32, mut noise: impl FnMut() -> f32) -> Vec<u8> {
    let (sin, cos) = pose.turn_rad.sin_cos();
    let [width, height] = [share.sqrt(), 1.0 / share.sqrt()].map(|s| s * pose.plate_px);
    let spread = (pose.blur_px * pose.blur_px + PIXEL_VARIANCE).sqrt();
    (0..size.area())
        .map(|i| {
            let [dx, dy] = [
                (i % size.width) as f32 - pose.centre[0],
                (i / size.width) as f32 - pose.centre[1],
            ];
            let (u, v) = (
                (cos * dx + sin * dy) / width,
                (cos * dy - sin * dx) / height,
            );
            let edge = |d: f32| 0.5 * erf(f64::from(d / spread) / 2f64.sqrt());
            let within = |c: f32, from: f32, to: f32, side: f32| {
                edge((c - from) * side) - edge((c - to) * side)
            };
            let coverage: f64 = FLAG
                .iter()
                .map(|&[left, top, right, bottom]| {
                    within(u, left, right, width) * within(v, top, bottom, height)
                })
                .sum();
            let grey = if u.abs().max(v.abs()) > 0.5 {
                90.0
            } else {
                (200.0 + 0.3 * dx) * (1.0 - 0.8 * coverage as f32)
            };
            (grey + noise()).round().clamp(0.0, 255.0) as u8
        })
        .collect()
}

/// Nothing is known of the camera.
const ANY_ANGLE: StretchPrior = StretchPrior {
    blur_px: 0.65,
    stretch: [0.0; 2],
    sigma: 0.15,
    curvature: [[0.0; 3]; 2],
    curvature_sigma: 0.005,
};

#[test]
fn a_plate_at_an_angle_is_found_from_a_start_nearby() {
    let samples = samples();
    for (i, (plate_px, share)) in [(16.0, 0.9), (24.0, 0.7), (48.0, 0.6), (90.0, 0.8)]
        .into_iter()
        .enumerate()
    {
        let truth = Pose {
            turn_rad: 0.9 * i as f32 - 1.0,
            blur_px: 0.7,
            ..some_pose(i, plate_px)
        };
        let plane = compressed(SIZE, &truth, share, || 0.0);
        let (sin, cos) = (truth.turn_rad + 0.04).sin_cos();
        let [width, height] = [share.sqrt(), 1.0 / share.sqrt()].map(|s| 1.03 * s * plate_px);
        let columns = [[width * cos, width * sin], [-height * sin, height * cos]];
        let centre = [truth.centre[0] + 0.6, truth.centre[1] - 0.5];
        let start = PlateMap::affine(centre, columns).expect("not mirrored");
        let layers = layers(&samples);
        let found = fit_curved_shape(&plane, SIZE, None, layers, start, &PRIOR, &ANY_ANGLE);
        let CurvedFit { fit, stretch, .. } = found.expect("a plate that is there");
        let off = off(&fit.pose, &truth);
        let turned = (fit.pose.turn_rad - truth.turn_rad).abs();
        assert!(off < 0.02, "{plate_px}: {off} px");
        assert!(turned < 0.05 / plate_px, "{plate_px}: {turned} rad");
        let (sin, cos) = (2.0 * truth.turn_rad).sin_cos();
        for (found, axis) in stretch.into_iter().zip([cos, sin]) {
            let expected = 0.5 * share.ln() * axis;
            assert!(
                (found - expected).abs() < 0.005,
                "{plate_px}: {found}, not {expected}"
            );
        }
        assert!(fit.r_squared > 0.99, "{plate_px}: {}", fit.r_squared);
    }
}

#[test]
fn an_upright_fit_is_refined_to_the_angle() {
    let samples = samples();
    let truth = Pose {
        centre: [60.2, 55.7],
        turn_rad: 0.5,
        plate_px: 30.0,
        blur_px: 0.7,
    };
    let plane = compressed(SIZE, &truth, 0.96, || 0.0);
    let upright = fit_shape(&plane, SIZE, None, layers(&samples), near(&truth), &PRIOR)
        .expect("nearly a square");
    let layers = layers(&samples);
    let refined = refine_shape(
        &plane,
        SIZE,
        None,
        layers,
        &upright.pose,
        &PRIOR,
        &ANY_ANGLE,
    );
    let refined = refined.expect("it continues").fit;
    let off = |pose: &Pose| off(pose, &truth);
    assert!(off(&refined.pose) < 0.01 && off(&refined.pose) < off(&upright.pose));
    assert!(refined.residual < upright.residual);
}

#[test]
fn errors_at_an_angle_match_the_covariance() {
    let samples = samples();
    // None of these plates is curved: an uncertain curvature would be part of the covariance.
    let expected_angle = StretchPrior {
        curvature_sigma: 3e-4,
        ..ANY_ANGLE
    };
    let mut random = SplitMix64(3);
    let (mut squares, n) = ([0.0; 3], 400);
    for i in 0..n {
        let truth = Pose {
            centre: [30.0 + random.unit_f32(), 31.0 + random.unit_f32()],
            turn_rad: i as f32,
            plate_px: 24.0,
            blur_px: 0.7,
        };
        let size = Size {
            width: 60,
            height: 60,
        };
        let plane = compressed(size, &truth, 0.8, || 6.0 * random.normal() as f32);
        let prior = Prior {
            noise: 6.0,
            ..PRIOR
        };
        let (sin, cos) = truth.turn_rad.sin_cos();
        let [width, height] = [0.8f32.sqrt(), 1.0 / 0.8f32.sqrt()].map(|s| s * 24.0);
        let columns = [[width * cos, width * sin], [-height * sin, height * cos]];
        let start = PlateMap::affine(truth.centre, columns).expect("not mirrored");
        let layers = layers(&samples);
        let fit = fit_curved_shape(&plane, size, None, layers, start, &prior, &expected_angle)
            .expect("a plate that is there")
            .fit;
        let turn = f64::from(fit.pose.turn_rad - truth.turn_rad);
        let error = [
            fit.pose.centre[0] - truth.centre[0],
            fit.pose.centre[1] - truth.centre[1],
            libm::remainder(turn, core::f64::consts::TAU) as f32,
        ];
        for (i, sum) in squares.iter_mut().enumerate() {
            *sum += error[i] * error[i] / fit.covariance[i][i] / n as f32;
        }
    }
    // The mean square of 400 errors is accurate to 7 %: allow five times that.
    for square in squares {
        assert!((0.65..1.35).contains(&square), "{squares:?}");
    }
}

#[test]
fn errors_match_the_covariance() {
    let samples = samples();
    let mut random = SplitMix64(1);
    let mut normal = || random.normal() as f32;
    let (mut squares, n) = ([0.0; 3], 300);
    // Products of the errors of position and rotation, and their expected values, both
    // multiplied by the latter.
    let (mut products, mut expected) = (0.0, 0.0);
    for i in 0..n {
        let truth = Pose {
            centre: [30.0 + normal(), 31.0 + normal()],
            turn_rad: i as f32,
            plate_px: 20.0,
            blur_px: 0.7,
        };
        let size = Size {
            width: 60,
            height: 60,
        };
        let plane = picture(size, &truth, || 8.0 * normal());
        let prior = Prior {
            noise: 8.0,
            ..PRIOR
        };
        let fit = fit_shape(&plane, size, None, layers(&samples), near(&truth), &prior)
            .expect("a plate that is there");
        let error = [
            fit.pose.centre[0] - truth.centre[0],
            fit.pose.centre[1] - truth.centre[1],
            fit.pose.turn_rad - truth.turn_rad,
        ];
        for (i, sum) in squares.iter_mut().enumerate() {
            *sum += error[i] * error[i] / fit.covariance[i][i] / n as f32;
        }
        for (error_px, [.., with_turn]) in error.into_iter().zip(fit.covariance).take(2) {
            products += error_px * error[2] * with_turn;
            expected += with_turn * with_turn;
        }
    }
    // The mean square of 300 errors is accurate to 8 %: allow five times that.
    for square in squares {
        assert!((0.6..1.4).contains(&square), "{squares:?}");
    }
    let together = products / expected;
    assert!((0.5..1.5).contains(&together), "{together}");
}

#[test]
fn pixels_beside_a_smaller_plate_do_not_count() {
    let samples = samples();
    let truth = Pose {
        centre: [60.0, 55.0],
        turn_rad: 0.0,
        plate_px: 40.0,
        blur_px: 0.7,
    };
    let mut plane = picture(SIZE, &truth, || 0.0);
    // Only 34 x 34 pixels of the plate are visible, off its centre; the flag is whole.
    let bounds = Bounds {
        left: 43,
        top: 39,
        right: 76,
        bottom: 72,
    };
    let within = Within {
        mask: &vec![1; bounds.size().area()],
        bounds,
    };
    for (i, grey) in plane.iter_mut().enumerate() {
        let (x, y) = (i % SIZE.width, i / SIZE.width);
        if !within.holds(x, y, 0) {
            *grey = 30;
        }
    }
    let fit = |within| fit_shape(&plane, SIZE, within, layers(&samples), near(&truth), &PRIOR);
    assert_eq!(fit(None), None);
    let fit = fit(Some(within)).expect("a flag that is there");
    let off = (fit.pose.centre[0] - truth.centre[0]).hypot(fit.pose.centre[1] - truth.centre[1]);
    assert!(off < 0.01, "{off} px");
}

#[test]
fn nothing_is_found_where_nothing_is() {
    let samples = samples();
    let pose = Pose {
        centre: [20.0, 20.0],
        turn_rad: 0.0,
        plate_px: 24.0,
        blur_px: 0.6,
    };
    let size = Size {
        width: 40,
        height: 40,
    };
    let flat = vec![100; size.area()];
    assert_eq!(
        fit_shape(&flat, size, None, layers(&samples), pose, &PRIOR),
        None
    );
    let outside = Pose {
        centre: [-30.0, 500.0],
        ..pose
    };
    assert_eq!(
        fit_shape(&flat, size, None, layers(&samples), outside, &PRIOR),
        None
    );
    // A shape lighter than its plate is no marker.
    let light: Vec<u8> = picture(size, &pose, || 0.0)
        .iter()
        .map(|g| 255 - g)
        .collect();
    assert_eq!(
        fit_shape(&light, size, None, layers(&samples), pose, &PRIOR),
        None
    );
}
