//! The pipeline allocates nothing for a frame, and its results do not depend on the frames that its
//! memory held before.
//!
//! Allocations are counted by an allocator. It and `src/camera/v4l2.rs` are the only places with
//! `unsafe`.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use overcam::background::model;
use overcam::image::frame::{Frame, PixelFormat};
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::{Outcome, Pipeline};
use overcam::run::slot::Slot;
use overcam::settings::Settings;
use overcam::source::demo::{Floor, NATURAL_SIZE, RATE_HZ};
use random::SplitMix64;
use scene::Scene;

thread_local! {
    /// Allocations of this thread, since other tests run at the same time.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// The system allocator, with a counter.
struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

fn count() {
    // A thread that is ending no longer has a counter and does not need one.
    let _ = ALLOCATIONS.try_with(|allocations| allocations.set(allocations.get() + 1));
}

// SAFETY: every call is forwarded unchanged to the system allocator, so it meets the requirements
// of `GlobalAlloc`. Counting allocates nothing: the counter is initialised at compile time and has
// no destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller guarantees that the layout has a non-zero size.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller guarantees that the layout has a non-zero size.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller guarantees that the block has this layout and is from this allocator,
        // so from the system's.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller guarantees that the block has this layout and is from this allocator,
        // so from the system's.
        unsafe { System.dealloc(block, layout) }
    }
}

/// Number of allocations while `work` runs, and its result.
fn counted<T>(work: impl FnOnce() -> T) -> (u64, T) {
    let before = ALLOCATIONS.get();
    let result = work();
    (ALLOCATIONS.get() - before, result)
}

#[test]
fn the_counter_counts() {
    assert_eq!(counted(|| ()).0, 0);
    assert_eq!(counted(|| Box::new(1)).0, 1);
    assert_eq!(counted(|| vec![0; 100]).0, 1);
    let mut grown = Vec::with_capacity(1);
    assert_eq!(counted(|| grown.extend([1, 2, 3])).0, 1);
}

fn pipeline(settings: Settings) -> Pipeline {
    let family = Family::from_files(&built_in_files()).expect("the built-in markers are good");
    Pipeline::new(NATURAL_SIZE, Some(RATE_HZ), settings, family, None)
}

/// Tested layouts: what the demo draws, and what most cameras send.
const FORMATS: [PixelFormat; 2] = [PixelFormat::Rgb, PixelFormat::Yuyv];

fn draw(floor: &mut Floor, sequence: u64, format: PixelFormat, slot: &mut Slot) {
    floor.render(sequence, &mut slot.frame);
    if format == PixelFormat::Yuyv {
        to_yuyv(&mut slot.frame);
    }
}

/// Luma and chroma by BT.601 in the full range. A pair of pixels has the chroma of its left one.
fn to_yuyv(frame: &mut Frame) {
    let pairs = frame.bytes.as_chunks::<6>().0;
    let yuyv = pairs.iter().flat_map(|pair| {
        let [r, g, b, r2, g2, b2] = pair.map(f32::from);
        let luma = |r, g, b| 0.299 * r + 0.587 * g + 0.114 * b;
        let y = luma(r, g, b);
        let (u, v) = (128.0 + 0.564 * (b - y), 128.0 + 0.713 * (r - y));
        [y, u, luma(r2, g2, b2), v].map(|value| value.round() as u8)
    });
    frame.bytes = yuyv.collect();
    frame.format = PixelFormat::Yuyv;
}

#[test]
fn a_frame_is_processed_without_an_allocation() {
    for format in FORMATS {
        let mut pipeline = pipeline(Settings::default());
        let mut floor = Floor::new(NATURAL_SIZE, 1);
        let mut slot = Slot::empty();
        let mut n_marked = 0;
        for sequence in 0..60 {
            draw(&mut floor, sequence, format, &mut slot);
            // It is given again later, as from a recording with several.
            slot.background = (sequence % 40 == 0).then(|| floor.background());
            let (allocations, outcome) = counted(|| pipeline.process(&mut slot));
            assert_eq!(outcome.expect("it is a picture"), Outcome::Scene);
            // The first picture of the floor allocates the memory.
            assert_eq!(
                allocations == 0,
                sequence > 0,
                "{format:?}, frame {sequence}"
            );
            let objects = slot.scene.objects();
            n_marked += objects.iter().filter(|o| o.marker_name().is_some()).count();
        }
        assert!(n_marked > 60 * 5, "robots were seen: {n_marked}");
    }
}

#[test]
fn learning_allocates_only_at_its_end() {
    const LEARN: u32 = 12;
    for format in FORMATS {
        let mut pipeline = pipeline(Settings {
            learn: LEARN,
            ..Settings::default()
        });
        let mut floor = Floor::new(NATURAL_SIZE, 1);
        let mut slot = Slot::empty();
        let mut allocating = Vec::new();
        for sequence in 0..3 * u64::from(LEARN) {
            draw(&mut floor, sequence, format, &mut slot);
            slot.background = None;
            let (allocations, outcome) = counted(|| pipeline.process(&mut slot));
            let expected = if sequence < u64::from(LEARN) {
                Outcome::Learning
            } else {
                Outcome::Scene
            };
            assert_eq!(outcome.expect("it is a picture"), expected);
            if allocations > 0 {
                allocating.push(sequence);
            }
        }
        // The first frame with the new floor allocates the memory to compare with it.
        assert_eq!(allocating, [u64::from(LEARN)], "{format:?}");
    }
}

#[test]
fn relearning_allocates_only_on_request() {
    const LEARN: u32 = 12;
    let mut pipeline = pipeline(Settings {
        learn: LEARN,
        ..Settings::default()
    });
    let mut floor = Floor::new(NATURAL_SIZE, 1);
    let mut slot = Slot::empty();
    let mut changed_at = Vec::new();
    for sequence in 0..40 {
        draw(&mut floor, sequence, PixelFormat::Rgb, &mut slot);
        slot.background = (sequence == 0).then(|| floor.background());
        if sequence == 10 || sequence == 15 {
            // The second request changes nothing.
            pipeline.relearn();
        }
        assert_eq!(
            pipeline.is_learning(),
            sequence == 0 || (10..=22).contains(&sequence)
        );
        let (allocations, outcome) = counted(|| pipeline.process(&mut slot));
        assert_eq!(outcome.expect("it is a picture"), Outcome::Scene);
        assert_eq!(allocations == 0, sequence > 0, "frame {sequence}");
        if slot.background.is_some() {
            changed_at.push(sequence);
        }
    }
    assert_eq!(changed_at, [0, 10 + u64::from(LEARN)]);
}

/// Frames full of shapes, then the empty floor until all are forgotten, so that all memory is dirty
/// and no track is left.
fn make_dirty(pipeline: &mut Pipeline, background: &model::BackgroundModel) {
    let mut slot = Slot::empty();
    slot.frame.format = PixelFormat::Rgb;
    slot.frame.full_range = true;
    slot.frame.size = NATURAL_SIZE;
    let n_bytes = 3 * NATURAL_SIZE.area();
    let mut random = SplitMix64(1);
    let speckled: Vec<u8> = (0..n_bytes).map(|_| random.byte()).collect();
    let blocks = |i: usize| {
        let (x, y) = (i / 3 % NATURAL_SIZE.width, i / 3 / NATURAL_SIZE.width);
        if (x / 20 + y / 20).is_multiple_of(2) {
            250
        } else {
            20
        }
    };
    let blocks: Vec<u8> = (0..n_bytes).map(blocks).collect();
    let picture = &background.picture;
    let planes = picture.red.iter().zip(&picture.green).zip(&picture.blue);
    let empty: Vec<u8> = planes.flat_map(|((r, g), b)| [*r, *g, *b]).collect();

    let mut most_objects = 0;
    let white = vec![255; n_bytes];
    let dirty = [&speckled, &blocks, &white].into_iter();
    let frames = dirty.cycle().take(6).chain([&empty; 30]);
    for (sequence, bytes) in frames.enumerate() {
        slot.frame.bytes.clone_from(bytes);
        slot.frame.sequence = sequence as u64;
        slot.frame.stamp_ns = sequence as u64 * 33_333_333;
        pipeline.process(&mut slot).expect("it is a picture");
        most_objects = most_objects.max(slot.scene.n_objects);
    }
    assert!(most_objects > 10, "the frames were full: {most_objects}");
    assert_eq!(slot.scene.n_objects, 0, "all are forgotten");
}

#[test]
fn results_do_not_depend_on_what_the_memory_held() {
    let mut floor = Floor::new(NATURAL_SIZE, 1);
    let background = floor.background();
    let mut fresh = pipeline(Settings::default());
    let mut dirty = pipeline(Settings::default());
    let mut slots = [Slot::empty(), Slot::empty()];
    slots[1].background = Some(background.clone());
    draw(&mut floor, 0, PixelFormat::Rgb, &mut slots[1]);
    dirty.process(&mut slots[1]).expect("it is a picture");
    make_dirty(&mut dirty, &background);

    // A new floor means a new camera, so what was learned about the lens is forgotten too.
    for slot in &mut slots {
        slot.background = Some(background.clone());
    }
    for sequence in 0..40 {
        for (pipeline, slot) in [&mut fresh, &mut dirty].into_iter().zip(&mut slots) {
            draw(&mut floor, sequence, PixelFormat::Rgb, slot);
            // After the frames that made it dirty.
            slot.frame.stamp_ns += 10_000_000_000;
            pipeline.process(slot).expect("it is a picture");
            slot.background = None;
        }
        let [expected, found] = slots.each_ref().map(|slot| numbered_from_one(&slot.scene));
        assert!(expected == found, "frame {sequence}");
    }
}

/// The scene as JSON with its tracks renumbered: ids are never reused, so the forgotten tracks have
/// taken some.
fn numbered_from_one(scene: &Scene) -> String {
    let mut scene = *scene;
    let mut tracks: Vec<u64> = scene.objects().iter().map(|object| object.track).collect();
    tracks.sort_unstable();
    let n_objects = scene.n_objects as usize;
    for object in &mut scene.objects[..n_objects] {
        let order = tracks
            .binary_search(&object.track)
            .expect("it is in the scene");
        object.track = order as u64 + 1;
    }
    let mut line = Vec::new();
    overcam::output::json::write_line(&scene, &mut line).expect("a vector takes it");
    String::from_utf8(line).expect("JSON is text")
}
