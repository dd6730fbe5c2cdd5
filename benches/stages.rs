//! Each step by itself, on a frame of the demo: `cargo bench --bench stages`.
//!
//! `stage/copy` is the unit: a plain copy of the frame's bytes. Answers are checked before anything
//! is timed.

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
    Colour, DifferenceMut, Gains, NoiseSettings, Reference, ReferenceMut, difference, prepare,
};
use imgproc::labels::{Difference, LabelSettings, STRONG, WindowsMut, label_pixels};
use imgproc::median::median_3x3;
use imgproc::morphology::{close_3x3, open_3x3};
use imgproc::{Point, Size};
use overcam::image::frame::{Picture, decode};
use overcam::run::slot::Slot;
use overcam::source::demo::{Floor, NATURAL_SIZE};
use predict::{MAX_TRACKS, Observation, Settings, Track, Tracker};
use rustfft::FftPlanner;

const SIZE: Size = NATURAL_SIZE;

fn colour(picture: &Picture) -> Colour<'_> {
    Colour {
        red: &picture.red,
        green: &picture.green,
        blue: &picture.blue,
    }
}

/// The result of each step on a frame of the demo: the inputs of the next step.
struct Steps {
    slot: Slot,
    picture: Picture,
    denoised: Picture,
    floor: FloorPlanes,
    difference: DifferencePlanes,
    labels: Vec<u8>,
    object: Vec<u8>,
    mask: Vec<u8>,
}

/// The floor, prepared for comparison with frames.
struct FloorPlanes {
    level: Vec<u16>,
    red_share: Vec<u16>,
    blue_share: Vec<u16>,
    light_scale: Vec<i16>,
    colour_scale: Vec<i16>,
}

/// Difference of a frame from the floor.
#[derive(Clone)]
struct DifferencePlanes {
    light: Vec<i16>,
    red: Vec<i16>,
    blue: Vec<i16>,
    level: Vec<u16>,
}

const NOISE: NoiseSettings = NoiseSettings {
    min: 1.5,
    light: 0.01,
    colour: 0.015,
    displacement_px: 0.5,
};
const LABELS: LabelSettings = LabelSettings {
    weak: 2.5,
    strong: 5.0,
    shadow_min: 0.4,
    shadow_tint: 0.1,
};

impl FloorPlanes {
    fn new(floor: &Picture) -> Self {
        let mut planes = Self {
            level: vec![0; SIZE.area()],
            red_share: vec![0; SIZE.area()],
            blue_share: vec![0; SIZE.area()],
            light_scale: vec![0; SIZE.area()],
            colour_scale: vec![0; SIZE.area()],
        };
        let fine =
            |plane: &[u8]| -> Vec<u16> { plane.iter().map(|&p| u16::from(p) << 8).collect() };
        let (red, green, blue) = (fine(&floor.red), fine(&floor.green), fine(&floor.blue));
        prepare(
            Colour {
                red: &red,
                green: &green,
                blue: &blue,
            },
            &vec![8; SIZE.area()],
            SIZE,
            0..SIZE.height,
            &mut ReferenceMut {
                level: &mut planes.level,
                red_share: &mut planes.red_share,
                blue_share: &mut planes.blue_share,
                light_scale: &mut planes.light_scale,
                colour_scale: &mut planes.colour_scale,
            },
            &NOISE,
        );
        planes
    }

    fn reference(&self) -> Reference<'_> {
        Reference {
            level: &self.level,
            red_share: &self.red_share,
            blue_share: &self.blue_share,
            light_scale: &self.light_scale,
            colour_scale: &self.colour_scale,
        }
    }
}

impl DifferencePlanes {
    fn new() -> Self {
        Self {
            light: vec![0; SIZE.area()],
            red: vec![0; SIZE.area()],
            blue: vec![0; SIZE.area()],
            level: vec![0; SIZE.area()],
        }
    }

    fn compare(&mut self, picture: &Picture, floor: &FloorPlanes) {
        let out = DifferenceMut {
            light: &mut self.light,
            red: &mut self.red,
            blue: &mut self.blue,
            level: &mut self.level,
        };
        difference(colour(picture), Gains::NONE, floor.reference(), SIZE, out);
    }

    fn label(
        &self,
        floor: &FloorPlanes,
        labels: &mut [u8],
        own: &mut [u8],
        windows: &mut DifferencePlanes,
    ) {
        let difference = Difference {
            light: &self.light,
            red: &self.red,
            blue: &self.blue,
            level: &self.level,
        };
        let windows = WindowsMut {
            light: &mut windows.light,
            red: &mut windows.red,
            blue: &mut windows.blue,
        };
        label_pixels(
            difference,
            &floor.level,
            SIZE,
            labels,
            own,
            windows,
            &LABELS,
        );
    }
}

impl Steps {
    fn new() -> Self {
        let plane = || vec![0; SIZE.area()];
        let mut floor = Floor::new(SIZE, 1);
        let mut steps = Self {
            slot: Slot::empty(),
            picture: Picture::new(SIZE),
            denoised: Picture::new(SIZE),
            floor: FloorPlanes::new(&floor.background().picture),
            difference: DifferencePlanes::new(),
            labels: plane(),
            object: plane(),
            mask: plane(),
        };
        floor.render(0, &mut steps.slot.frame);
        decode(&steps.slot.frame, &mut steps.picture).expect("a whole frame");
        denoise(&steps.picture, &mut steps.denoised);
        steps.difference.compare(&steps.denoised, &steps.floor);
        let mut windows = DifferencePlanes::new();
        steps
            .difference
            .label(&steps.floor, &mut steps.labels, &mut plane(), &mut windows);
        for (object, label) in steps.object.iter_mut().zip(&steps.labels) {
            *object = u8::from(label & STRONG != 0);
        }
        steps.mask.copy_from_slice(&steps.object);
        open_3x3(&mut steps.mask, SIZE, &mut plane());
        close_3x3(&mut steps.mask, SIZE, &mut plane());
        steps
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
    let mut planes = DifferencePlanes::new();
    criterion.bench_function(&name("difference"), |b| {
        b.iter(|| planes.compare(&steps.denoised, &steps.floor));
    });
    criterion.bench_function(&name("labels"), |b| {
        b.iter(|| {
            steps
                .difference
                .label(&steps.floor, &mut plane, &mut scratch, &mut planes);
        });
    });
    criterion.bench_function(&name("opening-and-closing"), |b| {
        b.iter(|| {
            plane.copy_from_slice(&steps.object);
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
    let mut tracker = Tracker::new(vec![Track::EMPTY; MAX_TRACKS]);
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
