//! Where nothing stands, nothing is found.

use imgproc::Size;

use crate::camera::{Camera, Encoding};
use crate::canvas::Canvas;
use crate::floor::Floor;
use crate::judge::{Demands, Judged};
use crate::light::Light;
use crate::play::Play;
use crate::random::at_point;

const SIZE: Size = Size {
    width: 320,
    height: 240,
};

/// Frames per floor, where the environment does not say.
const FRAMES: usize = 200;

fn frames() -> usize {
    std::env::var("FLOORS_FRAMES").map_or(FRAMES, |frames| {
        frames.parse().expect("FLOORS_FRAMES is a number of frames")
    })
}

/// Counts objects on floors without any.
fn watch(name: &str, noise: f32, encoding: Encoding, light: impl Fn(usize) -> Light) {
    let frames = frames();
    println!("{name}: floor, noise, false objects in {frames} frames");
    let mut demands = Demands::default();
    for floor in Floor::ALL {
        let empty = Canvas::new(floor, SIZE);
        let mut play = Play::learned(Camera::new(noise, encoding), &empty);
        let n_false: usize = (0..frames)
            .map(|frame| {
                let scene = play.show(&empty, &light(frame));
                Judged::new(scene, &empty).false_objects().count()
            })
            .sum();
        println!("  {:10} {noise:4} {n_false}", format!("{floor:?}"));
        demands.demand(1000 * n_false <= frames, || {
            format!("{name}: {n_false} false objects in {frames} frames on {floor:?}")
        });
    }
    demands.check();
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn noise_is_no_object() {
    watch("noise", 6.0, Encoding::Rgb, |_| Light::EVEN);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn noise_of_a_grey_camera_is_no_object() {
    watch("grey noise", 6.0, Encoding::Grey, |_| Light::EVEN);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn noise_with_half_the_chroma_is_no_object() {
    watch("4:2:0 noise", 6.0, Encoding::I420, |_| Light::EVEN);
}

#[test]
#[ignore = "slow, and not every goal is reached: cargo test --test floors -- --ignored"]
fn flicker_of_the_mains_is_no_object() {
    watch("flicker of 2 %", 3.0, Encoding::Rgb, |frame| {
        Light::exposure(1.0 + 0.02 * at_point(50, frame as i64, 0))
    });
}
