//! Each step alone, on a frame of the demo: `cargo bench --bench stages`.
//!
//! `stage/copy` is the unit: a plain copy of the frame's bytes. Answers are checked before anything is timed.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use fourier::contour::resample;
use fourier::descriptor::describe;
use fourier::fft::{fft, inverse_fft};
use fourier::matching::compare;
use fourier::{Complex32, N};
use imgproc::background::median_of_frames;
use imgproc::contour::{Span, follow_contour, next_shape, remove_shape, span_capacity};
use imgproc::difference::{
    Colour, DifferenceSettings, HueSaturationLightness, HueSaturationLightnessMut, difference,
    hue_saturation_lightness,
};
use imgproc::median::median_3x3;
use imgproc::morphology::{close_3x3, open_3x3};
use imgproc::threshold::window_threshold;
use imgproc::{Point, Size};
use overcam::frame::{Picture, decode};
use overcam::slot::Slot;
use overcam::source::demo::{Floor, NATURAL_SIZE};
use predict::{Observation, Settings, Tracker};
use rustfft::FftPlanner;

const SIZE: Size = NATURAL_SIZE;

fn colour(picture: &Picture) -> Colour<'_> {
    Colour {
        red: &picture.red,
        green: &picture.green,
        blue: &picture.blue,
    }
}

/// What each step makes of a frame of the demo: the inputs of the next one.
struct Steps {
    slot: Slot,
    picture: Picture,
    denoised: Picture,
    towards_red: Vec<i16>,
    towards_green: Vec<i16>,
    lightness: Vec<u8>,
    differences: Vec<u8>,
    threshold: Vec<u8>,
    mask: Vec<u8>,
}

const DIFFERENCE: DifferenceSettings = DifferenceSettings {
    shadow: 0.4,
    glare: 0.1,
    noise: 6,
};
const THRESHOLD: u16 = 220;

impl Steps {
    fn new() -> Self {
        let plane = || vec![0; SIZE.area()];
        let mut steps = Self {
            slot: Slot::empty(),
            picture: Picture::new(SIZE),
            denoised: Picture::new(SIZE),
            towards_red: vec![0; SIZE.area()],
            towards_green: vec![0; SIZE.area()],
            lightness: plane(),
            differences: plane(),
            threshold: plane(),
            mask: plane(),
        };
        let mut floor = Floor::new(SIZE, 1);
        floor.render(0, &mut steps.slot.frame);
        decode(&steps.slot.frame, &mut steps.picture).expect("a whole frame");
        denoise(&steps.picture, &mut steps.denoised);
        let planes = HueSaturationLightnessMut {
            towards_red: &mut steps.towards_red,
            towards_green: &mut steps.towards_green,
            lightness: &mut steps.lightness,
        };
        hue_saturation_lightness(colour(&floor.background().picture), SIZE, planes);
        let mut differences = plane();
        difference(
            colour(&steps.denoised),
            steps.floor(),
            SIZE,
            &mut differences,
            &DIFFERENCE,
        );
        steps.differences = differences;
        window_threshold(&steps.differences, SIZE, &mut steps.threshold, THRESHOLD);
        steps.mask.copy_from_slice(&steps.threshold);
        open_3x3(&mut steps.mask, SIZE, &mut plane());
        close_3x3(&mut steps.mask, SIZE, &mut plane());
        steps
    }

    fn floor(&self) -> HueSaturationLightness<'_> {
        HueSaturationLightness {
            towards_red: &self.towards_red,
            towards_green: &self.towards_green,
            lightness: &self.lightness,
        }
    }
}

fn denoise(picture: &Picture, out: &mut Picture) {
    median_3x3(&picture.red, SIZE, &mut out.red);
    median_3x3(&picture.green, SIZE, &mut out.green);
    median_3x3(&picture.blue, SIZE, &mut out.blue);
}

fn pixels(criterion: &mut Criterion) {
    let name = |step: &str| format!("stage/{step}/{}x{}", SIZE.width, SIZE.height);
    let steps = Steps::new();
    let mut picture = Picture::new(SIZE);
    let (mut plane, mut scratch) = (vec![0; SIZE.area()], vec![0; SIZE.area()]);

    let mut copy = vec![0; steps.slot.frame.bytes.len()];
    criterion.bench_function(&name("copy"), |b| {
        b.iter(|| copy.copy_from_slice(black_box(&steps.slot.frame.bytes)))
    });
    criterion.bench_function(&name("decode-rgb"), |b| {
        b.iter(|| decode(&steps.slot.frame, &mut picture).expect("a whole frame"));
    });
    criterion.bench_function(&name("median-of-three-planes"), |b| {
        b.iter(|| denoise(&steps.picture, &mut picture))
    });
    criterion.bench_function(&name("difference"), |b| {
        b.iter(|| {
            difference(
                colour(&steps.denoised),
                steps.floor(),
                SIZE,
                &mut plane,
                &DIFFERENCE,
            )
        });
    });
    criterion.bench_function(&name("threshold"), |b| {
        b.iter(|| window_threshold(&steps.differences, SIZE, &mut plane, THRESHOLD));
    });
    criterion.bench_function(&name("opening-and-closing"), |b| {
        b.iter(|| {
            plane.copy_from_slice(&steps.threshold);
            open_3x3(&mut plane, SIZE, &mut scratch);
            close_3x3(&mut plane, SIZE, &mut scratch);
        });
    });

    let mut points = vec![Point::default(); 20_000];
    let mut spans = vec![Span::default(); span_capacity(SIZE)];
    let mut shapes = |mask: &mut [u8]| {
        let (mut from, mut n) = (0, 0);
        while let Some(start) = next_shape(mask, SIZE, from) {
            n += usize::from(follow_contour(mask, SIZE, start, &mut points).is_ok());
            remove_shape(mask, SIZE, start, &mut spans);
            from = usize::from(start.y) * SIZE.width;
        }
        n
    };
    assert_eq!(
        shapes(&mut steps.mask.clone()),
        11,
        "six robots and five obstacles"
    );
    criterion.bench_function(&name("contours"), |b| {
        b.iter(|| {
            plane.copy_from_slice(&steps.mask);
            shapes(&mut plane)
        });
    });

    let frames = [&steps.picture.red[..], &steps.denoised.red]
        .concat()
        .repeat(15);
    criterion.bench_function(&name("background-of-30-frames"), |b| {
        b.iter(|| median_of_frames(&frames, &mut plane))
    });
}

fn descriptors(criterion: &mut Criterion) {
    let arrow = [[0.0, -10.0], [7.0, 8.0], [0.0, 4.0], [-7.0, 8.0]];
    let samples = resample(&arrow);
    let descriptor = describe(&samples, 0.05).expect("an arrow");
    assert!(compare(&descriptor, &descriptor).distance < 1e-6);

    let mut there_and_back = samples;
    fft(&mut there_and_back);
    inverse_fft(&mut there_and_back);
    assert!(
        there_and_back
            .iter()
            .zip(&samples)
            .all(|(a, b)| (a / N as f32 - b).norm() < 1e-4)
    );
    criterion.bench_function("stage/fft-32/ours", |b| {
        b.iter(|| {
            let mut spectrum = black_box(samples);
            fft(&mut spectrum);
            spectrum
        });
    });
    let planned = FftPlanner::new().plan_fft_forward(N);
    let mut scratch = vec![Complex32::default(); planned.get_inplace_scratch_len()];
    criterion.bench_function("stage/fft-32/rustfft", |b| {
        b.iter(|| {
            let mut spectrum = black_box(samples);
            planned.process_with_scratch(&mut spectrum, &mut scratch);
            spectrum
        });
    });
    criterion.bench_function("stage/resample", |b| b.iter(|| resample(black_box(&arrow))));
    criterion.bench_function("stage/describe", |b| {
        b.iter(|| describe(black_box(&samples), 0.05))
    });
    criterion.bench_function("stage/compare", |b| {
        b.iter(|| compare(black_box(&descriptor), black_box(&descriptor)));
    });
}

fn tracks(criterion: &mut Criterion) {
    const OBJECTS: usize = 32;
    let settings = Settings::default();
    let mut tracker = Box::new(Tracker::new());
    let mut stamp_ns = 0;
    let mut step = move || {
        stamp_ns += 66_666_667;
        let t = stamp_ns as f64 * 1e-9;
        let observations: [Observation; OBJECTS] = std::array::from_fn(|i| Observation {
            x: 100.0 * i as f64 + 20.0 * (t + i as f64).cos(),
            y: 20.0 * (t + i as f64).sin(),
            covariance: [[0.01, 0.0], [0.0, 0.01]],
            heading: None,
            marker: None,
            reach: 0.0,
            area: 0.0,
        });
        tracker.update(stamp_ns, &observations, &settings);
        tracker.tracks().count()
    };
    assert_eq!(
        (0..40).map(|_| step()).last(),
        Some(OBJECTS),
        "one track an object"
    );
    criterion.bench_function("stage/track-and-forecast/32-objects", |b| b.iter(&mut step));
}

criterion_group! {
    name = stages;
    config = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    targets = pixels, descriptors, tracks
}
criterion_main!(stages);
