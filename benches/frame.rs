//! Whole frames, from bytes to scene: `cargo bench --bench frame`.
//!
//! * `frame/copy-<format>/<size>`: a plain copy of the frame's bytes, the unit of all other
//!   figures;
//! * `frame/demo-<format>/<size>`: the pipeline on the demo floor;
//! * `frame/recorded/<size>`: the pipeline on a recording named by the environment variable
//!   `OVERCAM_RECORDING`.
//!
//! After its times each bench prints the ratio to the copy, measured alternately in the same run.
//! On a machine whose speed drifts, only the ratio is reliable. The scenes are checked before
//! anything is timed.

use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use imgproc::Size;
use overcam::geometry::calibration::Calibration;
use overcam::image::frame::{Frame, PixelFormat};
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::{Outcome, Pipeline};
use overcam::run::slot::{Next, Slot};
use overcam::settings::Settings;
use overcam::source::demo::{Floor, NATURAL_SIZE, RATE_HZ};
use overcam::source::replay::Recording;

/// Number of frames kept in memory and processed in a loop.
const FRAMES: usize = 24;

/// Slots with frames of the demo, the first with its background.
fn demo_slots(size: Size, format: PixelFormat) -> Vec<Slot> {
    let mut floor = Floor::new(size, 1);
    let slot = |sequence| {
        let mut slot = Slot::empty();
        floor.render(sequence, &mut slot.frame);
        if format == PixelFormat::Yuyv {
            to_yuyv(&mut slot.frame);
        }
        slot.background = (sequence == 0).then(|| floor.background());
        slot
    };
    (0..FRAMES as u64).map(slot).collect()
}

/// BT.601, limited range, with the chroma of two pixels averaged.
fn to_yuyv(frame: &mut Frame) {
    let yuv = |p: &[u8]| {
        let (r, g, b) = (f32::from(p[0]), f32::from(p[1]), f32::from(p[2]));
        let y = 16.0 + 0.257 * r + 0.504 * g + 0.098 * b;
        [
            y,
            128.0 - 0.148 * r - 0.291 * g + 0.439 * b,
            128.0 + 0.439 * r - 0.368 * g - 0.071 * b,
        ]
    };
    let pair = |pair: &[u8]| {
        let (a, b) = (yuv(&pair[..3]), yuv(&pair[3..]));
        [a[0], (a[1] + b[1]) / 2.0, b[0], (a[2] + b[2]) / 2.0].map(|v| v.round() as u8)
    };
    frame.bytes = frame.bytes.chunks_exact(6).flat_map(pair).collect();
    frame.format = PixelFormat::Yuyv;
    frame.full_range = false;
}

/// Processes all slots once and returns the total number of objects. The next round goes back, so
/// that nothing jumps, and time continues.
fn process_all(pipeline: &mut Pipeline, slots: &mut [Slot]) -> u32 {
    let last_ns = slots.iter().map(|slot| slot.frame.stamp_ns).max();
    let frame_ns = (1e9 / RATE_HZ) as u64;
    let mut stamp_ns = last_ns.expect("there are slots");
    let mut objects = 0;
    for slot in slots.iter_mut() {
        stamp_ns += frame_ns;
        slot.frame.stamp_ns = stamp_ns;
        if pipeline.process(slot).expect("a whole frame") == Outcome::Scene {
            objects += slot.scene.n_objects;
        }
        slot.background = None;
    }
    slots.reverse();
    objects
}

fn copy_all(slots: &[Slot], to: &mut Vec<u8>) {
    for slot in slots {
        to.clear();
        to.extend_from_slice(black_box(&slot.frame.bytes));
        black_box(&to);
    }
}

fn time(work: impl FnOnce()) -> Duration {
    let started = Instant::now();
    work();
    started.elapsed()
}

/// Times the slots, and prints the ratio of a frame to its copy: the median of several alternating
/// measurements.
fn bench_slots(criterion: &mut Criterion, name: &str, pipeline: &mut Pipeline, slots: &mut [Slot]) {
    let n = slots.len() as u32;
    criterion.bench_function(name, |bencher| {
        bencher.iter_custom(|rounds| {
            time(|| (0..rounds).for_each(|_| _ = black_box(process_all(pipeline, slots)))) / n
        });
    });
    // The same argument tells criterion whether anything is timed, or only run once to see its
    // answers.
    if !std::env::args().any(|arg| arg == "--bench") {
        return;
    }
    let mut copy = Vec::with_capacity(slots[0].frame.bytes.len());
    let mut turn = || {
        let frames = time(|| _ = black_box(process_all(pipeline, slots)));
        let copies = time(|| (0..50).for_each(|_| copy_all(slots, &mut copy))) / 50;
        frames.as_secs_f64() / copies.as_secs_f64()
    };
    let mut ratios: Vec<f64> = (0..15).map(|_| turn()).collect();
    ratios.sort_by(f64::total_cmp);
    println!(
        "{name}: {:.0} copies of the frame\n",
        ratios[ratios.len() / 2]
    );
}

fn demo(criterion: &mut Criterion) {
    let family = Family::from_files(&built_in_files()).expect("the built-in family is usable");
    for size in [
        Size {
            width: 320,
            height: 240,
        },
        NATURAL_SIZE,
        Size {
            width: 1280,
            height: 960,
        },
    ] {
        for format in [PixelFormat::Rgb, PixelFormat::Yuyv] {
            let mut slots = demo_slots(size, format);
            let mut pipeline = Pipeline::new(
                size,
                Some(RATE_HZ),
                Settings::default(),
                family.clone(),
                None,
            );
            let seen = process_all(&mut pipeline, &mut slots);
            if size.width >= NATURAL_SIZE.width {
                assert_eq!(
                    seen as usize,
                    11 * FRAMES,
                    "six robots and five obstacles a frame"
                );
            }
            let name = format!("{format:?}/{}x{}", size.width, size.height).to_lowercase();
            let mut copy = Vec::with_capacity(slots[0].frame.bytes.len());
            criterion.bench_function(&format!("frame/copy-{name}"), |bencher| {
                bencher.iter_custom(|rounds| {
                    time(|| (0..rounds).for_each(|_| copy_all(&slots, &mut copy))) / FRAMES as u32
                });
            });
            bench_slots(
                criterion,
                &format!("frame/demo-{name}"),
                &mut pipeline,
                &mut slots,
            );
        }
    }
}

fn recorded(criterion: &mut Criterion) {
    let Ok(path) = std::env::var("OVERCAM_RECORDING") else {
        println!("frame/recorded: set OVERCAM_RECORDING to a recording to time the pipeline on it");
        return;
    };
    let mut recording =
        Recording::open(Path::new(&path)).expect("OVERCAM_RECORDING names a recording");
    let info = recording.info();
    let provenance = recording.provenance();
    let settings: Settings = toml::from_str(&provenance.settings).expect("readable settings");
    let family = Family::from_files(&provenance.markers).expect("a usable family");
    let calibration = provenance
        .calibration
        .as_deref()
        .map(|text| Calibration::from_toml(text).expect("a calibration"));
    let mut pipeline = Pipeline::new(info.size, info.rate_hz, settings, family, calibration);
    // The first frames that have results.
    let mut slots: Vec<Slot> = Vec::new();
    let mut background = None;
    while slots.len() < FRAMES {
        let mut slot = Slot::empty();
        if recording.next(&mut slot).expect("a whole recording") == Next::End {
            break;
        }
        background = slot.background.take().or(background);
        if background.is_some() && !slot.skipped {
            slots.push(slot);
        }
    }
    assert!(!slots.is_empty(), "{path} holds no frame with a background");
    slots[0].background = background;
    let objects = process_all(&mut pipeline, &mut slots);
    println!(
        "frame/recorded: {:.1} objects a frame",
        f64::from(objects) / slots.len() as f64
    );
    let name = format!("frame/recorded/{}x{}", info.size.width, info.size.height);
    bench_slots(criterion, &name, &mut pipeline, &mut slots);
}

criterion_group! {
    name = frames;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    targets = demo, recorded
}
criterion_main!(frames);
