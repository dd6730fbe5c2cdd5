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

fn pixels(criterion: &mut Criterion) {
    let name = |step: &str| format!("stage/{step}/{}x{}", SIZE.width, SIZE.height);
    let mut floor = Floor::new(SIZE, 1);
    let mut slot = Slot::empty();
    floor.render(0, &mut slot.frame);
    let mut copy = vec![0; slot.frame.bytes.len()];
    criterion.bench_function(&name("copy"), |b| {
        b.iter(|| copy.copy_from_slice(black_box(&slot.frame.bytes)))
    });

    let mut picture = Picture::new(SIZE);
    criterion.bench_function(&name("decode-rgb"), |b| {
        b.iter(|| decode(&slot.frame, &mut picture).expect("whole"))
    });
    let mut denoised = Picture::new(SIZE);
    criterion.bench_function(&name("median-of-three-planes"), |b| {
        b.iter(|| {
            median_3x3(&picture.red, SIZE, &mut denoised.red);
            median_3x3(&picture.green, SIZE, &mut denoised.green);
            median_3x3(&picture.blue, SIZE, &mut denoised.blue);
        });
    });

    let background = floor.background();
    let (mut red, mut green, mut light) = (
        vec![0; SIZE.area()],
        vec![0; SIZE.area()],
        vec![0; SIZE.area()],
    );
    let planes = HueSaturationLightnessMut {
        towards_red: &mut red,
        towards_green: &mut green,
        lightness: &mut light,
    };
    hue_saturation_lightness(colour(&background), SIZE, planes);
    let empty = HueSaturationLightness {
        towards_red: &red,
        towards_green: &green,
        lightness: &light,
    };
    let settings = DifferenceSettings {
        shadow: 0.4,
        glare: 0.1,
        noise: 6,
    };
    let mut differences = vec![0; SIZE.area()];
    criterion.bench_function(&name("difference"), |b| {
        b.iter(|| difference(colour(&denoised), empty, SIZE, &mut differences, &settings));
    });
    let mut mask = vec![0; SIZE.area()];
    criterion.bench_function(&name("threshold"), |b| {
        b.iter(|| window_threshold(&differences, SIZE, &mut mask, 220))
    });
    let mut scratch = vec![0; SIZE.area()];
    criterion.bench_function(&name("opening-and-closing"), |b| {
        b.iter(|| {
            open_3x3(&mut mask, SIZE, &mut scratch);
            close_3x3(&mut mask, SIZE, &mut scratch);
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
        shapes(&mut mask.clone()),
        11,
        "six robots and five obstacles"
    );
    criterion.bench_function(&name("contours"), |b| {
        b.iter(|| {
            scratch.copy_from_slice(&mask);
            shapes(&mut scratch)
        });
    });

    let frames = [&picture.red[..], &denoised.red, &background.red].concat();
    let mut median = vec![0; SIZE.area()];
    criterion.bench_function(&name("background-of-3-frames"), |b| {
        b.iter(|| median_of_frames(&frames, &mut median))
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
