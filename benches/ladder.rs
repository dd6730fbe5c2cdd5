//! Each step from the pixels of a plate to its pose: `cargo bench --bench ladder`.
//!
//! Subpixel contour, its descriptor, comparison with a reference, and the fit of the shape, both
//! where the shape is present and where another one is. Answers are checked before anything is
//! timed.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use fourier::contour::{region, resample};
use fourier::descriptor::describe;
use fourier::matching::{compare_both_ways, min_distance};
use imgproc::fit::{Layers, Pose, Prior, fit_shape};
use imgproc::isoline::follow_isoline;
use imgproc::{Point, Size};

/// Samples of a layer per row, and per side of the plate.
const SIDE: usize = 109;
const PER_PLATE: f32 = 100.0;

const FIRST_BLUR: f32 = 0.0085;
const BLUR_RATIO: f32 = std::f32::consts::SQRT_2;
const LAYERS: i32 = 12;

/// A spade: blade and handle, as left, top, right, bottom in units of the plate's side.
const SPADE: [[f32; 4]; 2] = [[-0.22, -0.35, 0.22, 0.05], [-0.08, 0.05, 0.08, 0.35]];

/// Another shape: a horizontal bar.
const BAR: [[f32; 4]; 1] = [[-0.3, -0.12, 0.2, 0.12]];

const PLATES_PX: [f32; 4] = [12.0, 24.0, 48.0, 96.0];

const PRIOR: Prior = Prior {
    noise: 1.0,
    blur_ln_sigma: 0.2,
    plate_ln_sigma: 0.1,
    tone: 1.0,
    tone_sigma: 0.05,
    sharpening: 0.0,
    sharpening_sigma: 0.05,
    residual_ratio_max: 0.04,
    may_be_covered: false,
};

/// Coverage of a point by the shape through a lens. The edge profile is nearly that of a Gaussian.
fn coverage(shape: &[[f32; 4]], u: f32, v: f32, blur: f32) -> f32 {
    let edge = |d: f32| 0.5 + 0.5 * (0.8 * d / blur).tanh();
    let within = |c: f32, from: f32, to: f32| edge(c - from) - edge(c - to);
    shape
        .iter()
        .map(|&[left, top, right, bottom]| within(u, left, right) * within(v, top, bottom))
        .sum()
}

/// The spade at every blur.
fn layers() -> Vec<f32> {
    let at = |i: usize| (i as f32 - (SIDE / 2) as f32) / PER_PLATE;
    let layer = |layer: i32| {
        let blur = FIRST_BLUR * BLUR_RATIO.powi(layer);
        (0..SIDE * SIDE).map(move |i| coverage(&SPADE, at(i % SIDE), at(i / SIDE), blur))
    };
    (0..LAYERS).flat_map(layer).collect()
}

/// A plate in the middle of a picture that is 1.5 times as large.
struct Scene {
    size: Size,
    plane: Vec<u8>,
    truth: Pose,
}

impl Scene {
    fn new(shape: &[[f32; 4]], plate_px: f32) -> Self {
        let side = (1.5 * plate_px) as usize + 8;
        let size = Size {
            width: side,
            height: side,
        };
        let truth = Pose {
            centre: [side as f32 / 2.0 + 0.2, side as f32 / 2.0 - 0.3],
            turn_rad: 0.4,
            plate_px,
            blur_px: 0.7,
        };
        let (sin, cos) = truth.turn_rad.sin_cos();
        let spread = (truth.blur_px * truth.blur_px + 1.0 / 12.0).sqrt() / plate_px;
        let grey = |i: usize| {
            let dx = (i % side) as f32 - truth.centre[0];
            let dy = (i / side) as f32 - truth.centre[1];
            let (u, v) = (
                (cos * dx + sin * dy) / plate_px,
                (cos * dy - sin * dx) / plate_px,
            );
            (210.0 - 170.0 * coverage(shape, u, v, spread)).round() as u8
        };
        Self {
            size,
            plane: (0..size.area()).map(grey).collect(),
            truth,
        }
    }

    /// The first pixel in row-major order that is darker than half-way.
    fn start(&self) -> Point {
        let first = self.plane.iter().position(|&grey| grey < 125);
        let first = first.expect("a dark figure");
        Point {
            x: (first % self.size.width) as u16,
            y: (first / self.size.width) as u16,
        }
    }

    /// A pose as a contour's descriptor may give it.
    fn nearby(&self) -> Pose {
        Pose {
            centre: self.truth.centre.map(|c| c + 0.2),
            turn_rad: self.truth.turn_rad + 0.03,
            plate_px: 1.02 * self.truth.plate_px,
            blur_px: 0.6,
        }
    }
}

fn ladder(criterion: &mut Criterion) {
    let samples = layers();
    let layers = Layers {
        samples: &samples,
        side: SIDE,
        per_plate: PER_PLATE,
        first_blur: FIRST_BLUR,
        blur_ratio: BLUR_RATIO,
    };
    let mut points = vec![[0.0; 2]; 4000];
    for plate_px in PLATES_PX {
        let name = |rung: &str| format!("ladder/{rung}/{plate_px}");
        let scene = Scene::new(&SPADE, plate_px);
        let Scene { size, plane, truth } = &scene;

        let contour = follow_isoline(plane, *size, scene.start(), 125.0, &mut points)
            .expect("a closed line")
            .to_vec();
        // Blur removes about the square of its width at each of the six corners.
        let corners = 6.0 * (truth.blur_px * truth.blur_px + 1.0 / 12.0);
        let missing = 0.224 * plate_px * plate_px - region(&contour).area;
        assert!(
            missing.abs() <= corners,
            "{plate_px}: {missing} px² of the spade are missing"
        );
        criterion.bench_function(&name("contour"), |b| {
            b.iter(|| {
                follow_isoline(black_box(plane), *size, scene.start(), 125.0, &mut points).is_ok()
            });
        });

        let descriptor = describe(&resample(&contour), 0.05).expect("a spade is long");
        criterion.bench_function(&name("descriptor"), |b| {
            b.iter(|| describe(&resample(black_box(&contour)), 0.05));
        });
        let magnitudes = descriptor.magnitudes();
        let [same, turned] = compare_both_ways(&descriptor, &descriptor).map(|m| m.distance);
        assert!(same < 1e-6 && turned > 0.01 && min_distance(&magnitudes, &magnitudes) < 1e-9);
        criterion.bench_function(&name("min-distance"), |b| {
            b.iter(|| min_distance(black_box(&magnitudes), black_box(&magnitudes)));
        });
        criterion.bench_function(&name("compare"), |b| {
            b.iter(|| compare_both_ways(black_box(&descriptor), black_box(&descriptor)));
        });

        let nearby = scene.nearby();
        let fit =
            fit_shape(plane, *size, None, layers, nearby, &PRIOR).expect("the spade is there");
        let off_px =
            (fit.pose.centre[0] - truth.centre[0]).hypot(fit.pose.centre[1] - truth.centre[1]);
        assert!(off_px < 0.02, "{plate_px}: {off_px} px off");
        criterion.bench_function(&name("fit"), |b| {
            b.iter(|| fit_shape(black_box(plane), *size, None, layers, nearby, &PRIOR));
        });
        let other = Scene::new(&BAR, plate_px);
        assert_eq!(
            fit_shape(&other.plane, *size, None, layers, nearby, &PRIOR),
            None
        );
        criterion.bench_function(&name("fit-of-something-else"), |b| {
            b.iter(|| fit_shape(black_box(&other.plane), *size, None, layers, nearby, &PRIOR));
        });
    }
}

criterion_group! {
    name = rungs;
    config = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(500));
    targets = ladder
}
criterion_main!(rungs);
