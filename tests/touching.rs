//! Two boxes that are pushed together are one shape in the picture but remain two objects.

use imgproc::Size;
use overcam::background::model::BackgroundModel;
use overcam::image::frame::{Picture, PixelFormat};
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::{Outcome, Pipeline};
use overcam::run::slot::Slot;
use overcam::settings::Settings;

const SIZE: Size = Size {
    width: 320,
    height: 240,
};
const FLOOR: [u8; 3] = [150, 140, 120];
const BOX: [u8; 3] = [40, 60, 160];
const SIDE: usize = 24;

/// Left edges of the boxes: 2 px per frame until they touch in frame 40, three seconds together,
/// and back.
fn left_edges(frame: usize) -> [usize; 2] {
    let gap = 2 * (40_usize.saturating_sub(frame) + frame.saturating_sub(130));
    [160 - SIDE - gap, 160 + gap]
}

fn draw(frame: usize, slot: &mut Slot) {
    let picture = &mut slot.frame;
    picture.sequence = frame as u64;
    picture.stamp_ns = frame as u64 * 33_333_333;
    picture.format = PixelFormat::Rgb;
    picture.size = SIZE;
    picture.bytes.clear();
    let lefts = left_edges(frame);
    for i in 0..SIZE.area() {
        let (x, y) = (i % SIZE.width, i / SIZE.width);
        let on_box = (100..100 + SIDE).contains(&y)
            && lefts.iter().any(|left| (*left..left + SIDE).contains(&x));
        picture.bytes.extend(if on_box { BOX } else { FLOOR });
    }
}

#[test]
fn two_boxes_touch_and_separate_with_their_ids() {
    let family = Family::from_files(&built_in_files()).expect("the built-in markers are good");
    let mut pipeline = Pipeline::new(SIZE, Some(30.0), Settings::default(), family, None);
    let mut slot = Slot::empty();
    slot.background = Some(BackgroundModel::from_picture(&Picture {
        size: SIZE,
        red: vec![FLOOR[0]; SIZE.area()],
        green: vec![FLOOR[1]; SIZE.area()],
        blue: vec![FLOOR[2]; SIZE.area()],
    }));
    let mut n_together = 0;
    for frame in 0..170 {
        draw(frame, &mut slot);
        let outcome = pipeline.process(&mut slot).expect("it is a picture");
        assert_eq!(outcome, Outcome::Scene);
        slot.background = None;
        let objects = slot.scene.objects();
        let ids: Vec<u64> = objects.iter().map(|object| object.track).collect();
        assert_eq!(ids.len(), 2, "frame {frame}: {ids:?}");
        // Closing joins shapes that are a pixel or two apart.
        let apart = !(38..=132).contains(&frame);
        for (left, object) in left_edges(frame).into_iter().zip([1, 2].map(|id| {
            objects
                .iter()
                .find(|object| object.track == id)
                .expect("the numbers of the first frame")
        })) {
            let centre = left as f64 + (SIDE as f64 - 1.0) / 2.0;
            assert!(
                // Touching objects are assumed to pass each other for a moment.
                (object.x - centre).abs() < if apart { 1.0 } else { 8.0 },
                "frame {frame}: track {} at {}, not {centre}",
                object.track,
                object.x
            );
            if apart {
                assert!(object.observed(), "frame {frame}");
            }
        }
        // One of them is observed, with the outline of both.
        let mut observed = objects.iter().filter(|object| object.observed());
        if let (Some(one), None) = (observed.next(), observed.next()) {
            let columns = one.outline().iter().map(|corner| corner[0]);
            let width = columns.clone().fold(f64::MIN, f64::max) - columns.fold(f64::MAX, f64::min);
            n_together += usize::from(width > 1.9 * SIDE as f64);
        }
    }
    assert!(n_together >= 90, "seen as one for {n_together} frames");
}
