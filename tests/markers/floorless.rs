//! Markers that the difference from the floor does not show: parked while the floor is learned or
//! relearned, touching, on a white floor, in dim light, in faint ink, and covered in part.

use imgproc::Size;
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::Pipeline;
use overcam::run::slot::Slot;
use overcam::settings::Settings;
use scene::{Object, Scene};

use crate::accuracy::drawings;
use crate::random::Random;
use crate::scene::{Conditions, Disturbance, GREY, Palette, Plate, Robot, picture};
use crate::viewpoint::Viewpoint;

const SIZE: Size = Size {
    width: 320,
    height: 240,
};
const RATE_HZ: u64 = 30;
const LEARN: u32 = 12;
const PLATE_PX: f32 = 24.0;

/// A pipeline and the frames that it is shown.
struct Play {
    pipeline: Pipeline,
    slot: Slot,
    random: Random,
    conditions: Conditions,
    palette: Palette,
    sequence: u64,
}

impl Play {
    fn new(palette: Palette) -> Self {
        let settings = Settings {
            learn: LEARN,
            ..Settings::default()
        };
        let family = Family::from_files(&built_in_files()).expect("a usable family");
        Self {
            pipeline: Pipeline::new(SIZE, Some(RATE_HZ as f64), settings, family, None),
            slot: Slot::empty(),
            random: Random::new(11),
            conditions: Conditions {
                plate_px: PLATE_PX,
                blur_px: 0.6,
                noise: 1.5,
                slope: 0.02,
                disturbance: Disturbance::None,
                viewpoint: Viewpoint::ABOVE,
                gamma: 1.0,
                sharpening: 0.0,
            },
            palette,
            sequence: 0,
        }
    }

    fn show(&mut self, plates: &[Plate<'_>]) -> &Scene {
        picture(
            SIZE,
            plates,
            &self.palette,
            &self.conditions,
            &mut self.random,
            &mut self.slot.frame,
        );
        self.slot.frame.sequence = self.sequence;
        self.slot.frame.stamp_ns = self.sequence * 1_000_000_000 / RATE_HZ;
        self.sequence += 1;
        let processed = self.pipeline.process(&mut self.slot);
        processed.expect("a drawn frame decodes");
        self.slot.background = None;
        &self.slot.scene
    }

    fn learn(&mut self, plates: &[Plate<'_>]) {
        for _ in 0..LEARN {
            self.show(plates);
        }
    }
}

/// What was seen of some plates.
#[derive(Debug, Default)]
struct Tally {
    shown: u32,
    read: u32,
    /// Markers that do not exist, have a wrong name, or appear twice.
    wrong: u32,
    obstacles: u32,
    worst_px: f64,
}

impl Tally {
    fn add(&mut self, scene: &Scene, plates: &[Plate<'_>], names: &[&str]) {
        let seen = || scene.objects().iter().filter(|o| o.observed());
        let is_at = |object: &Object, plate: &Plate<'_>| {
            let [x, y] = plate.centre.map(f64::from);
            (object.x - x).hypot(object.y - y)
        };
        let mut matched = 0;
        for (plate, name) in plates.iter().zip(names) {
            self.shown += 1;
            let hit = seen()
                .filter(|o| o.marker_name() == Some(*name))
                .map(|o| is_at(o, plate))
                .find(|&off| off < 2.0);
            if let Some(off) = hit {
                self.read += 1;
                matched += 1;
                self.worst_px = self.worst_px.max(off);
            }
        }
        let markers = seen().filter(|o| o.marker_name().is_some()).count() as u32;
        self.wrong += markers - matched;
        self.obstacles += seen().count() as u32 - markers;
    }

    fn recall(&self) -> f64 {
        f64::from(self.read) / f64::from(self.shown)
    }
}

/// Plates with the family's first markers at these centres, each with another turn.
fn plates<'a>(
    outlines: &'a [Vec<[f32; 2]>],
    centres: &[[f32; 2]],
    turn_rad: f32,
) -> Vec<Plate<'a>> {
    let plate = |(i, &centre): (usize, &[f32; 2])| Plate {
        figure: &outlines[i % outlines.len()],
        centre,
        turn_rad: turn_rad + 0.77 * i as f32,
        robot: Robot::None,
        light: [0.0, 0.0],
    };
    centres.iter().enumerate().map(plate).collect()
}

/// Outlines and names of the built-in markers.
fn family() -> (Vec<Vec<[f32; 2]>>, Vec<String>) {
    let drawings = drawings(&built_in_files());
    let outlines = drawings.iter().map(|d| d.outline.to_vec()).collect();
    (outlines, drawings.into_iter().map(|d| d.name).collect())
}

fn grid(columns: usize, rows: usize, pitch: f32) -> Vec<[f32; 2]> {
    let at = |i: usize| {
        [
            60.3 + (i % columns) as f32 * pitch,
            50.6 + (i / columns) as f32 * pitch,
        ]
    };
    (0..columns * rows).map(at).collect()
}

#[test]
fn robots_that_are_parked_while_the_floor_is_learned_are_read() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let centres = grid(4, 3, 60.0);
    let mut play = Play::new(GREY);
    let parked = plates(&outlines, &centres, 0.3);
    play.learn(&parked);
    // The first reading has to be confirmed.
    play.show(&parked);
    let mut tally = Tally::default();
    for _ in 0..10 {
        tally.add(play.show(&parked), &parked, &names);
    }
    // They drive off to the right.
    for step in 1..=30_u32 {
        let moved: Vec<[f32; 2]> = centres
            .iter()
            .map(|&[x, y]| [x + (1.1 * step as f32).min(27.0), y])
            .collect();
        let moved = plates(&outlines, &moved, 0.3);
        tally.add(play.show(&moved), &moved, &names);
    }
    println!("parked and leaving: {tally:?}");
    assert!(tally.recall() >= 0.99, "{tally:?}");
    assert_eq!(tally.wrong, 0);
    let moved: Vec<[f32; 2]> = centres.iter().map(|&[x, y]| [x + 27.0, y]).collect();
    let moved = plates(&outlines, &moved, 0.3);
    let mut after = Tally::default();
    for frame in 0..60 {
        let scene = play.show(&moved);
        if frame >= 30 {
            after.add(scene, &moved, &names);
        }
    }
    println!("afterwards: {after:?}");
    assert!(after.recall() >= 0.99 && after.wrong == 0, "{after:?}");
    assert_eq!(after.obstacles, 0, "nothing is left where they were");
}

#[test]
fn relearning_the_floor_keeps_what_stands_on_it() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut play = Play::new(GREY);
    play.learn(&[]);
    // Six robots and two things without a marker, all at rest.
    let mut standing = plates(&outlines, &grid(4, 2, 60.0), 0.4);
    let blank = [[0.0; 2]; 3];
    for plate in &mut standing[6..] {
        plate.figure = &blank;
        plate.robot = Robot::Dark;
    }
    for _ in 0..10 {
        play.show(&standing);
    }
    play.pipeline.relearn();
    let mut tally = Tally::default();
    for frame in 0..LEARN + 50 {
        let scene = play.show(&standing);
        if frame > LEARN {
            tally.add(scene, &standing[..6], &names);
        }
    }
    println!("relearned: {tally:?}");
    assert!(tally.recall() >= 0.99 && tally.wrong == 0, "{tally:?}");
    assert_eq!(tally.obstacles, 2 * 49);
}

/// Shows plates for some frames after an empty floor was learned.
fn shown_after_learning(
    mut play: Play,
    plates: &[Plate<'_>],
    names: &[&str],
    frames: u32,
) -> Tally {
    play.learn(&[]);
    let mut tally = Tally::default();
    for frame in 0..frames {
        let scene = play.show(plates);
        // By then the whole picture has been searched once.
        if frame >= 40 {
            tally.add(scene, plates, names);
        }
    }
    tally
}

#[test]
fn plates_that_touch_are_read() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut all = Tally::default();
    for (columns, rows) in [(2, 1), (3, 1), (3, 2)] {
        let touching: Vec<Plate<'_>> = plates(&outlines, &grid(columns, rows, PLATE_PX), 0.0)
            .into_iter()
            .map(|plate| Plate {
                turn_rad: std::f32::consts::FRAC_PI_2 * (plate.centre[0] as i32 % 4) as f32,
                ..plate
            })
            .collect();
        let tally = shown_after_learning(Play::new(GREY), &touching, &names, 50);
        println!("{columns} x {rows} touching: {tally:?}");
        all.shown += tally.shown;
        all.read += tally.read;
        all.wrong += tally.wrong;
    }
    assert!(all.recall() >= 0.99 && all.wrong == 0, "{all:?}");
}

#[test]
fn a_floor_as_white_as_the_plates_hides_none() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let white = Palette {
        floor: [228.0; 3],
        ..GREY
    };
    let shown = plates(&outlines, &grid(4, 3, 60.0), 0.4);
    let tally = shown_after_learning(Play::new(white), &shown, &names, 60);
    println!("white floor: {tally:?}");
    assert!(tally.recall() >= 0.99 && tally.wrong == 0, "{tally:?}");
}

#[test]
fn faint_ink_is_measured_in_noise() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for (apart, noise) in [(48.0, 1.5), (29.0, 1.0)] {
        let faint = Palette {
            paper: [150.0; 3],
            ink: [150.0 - apart; 3],
            floor: [110.0; 3],
        };
        let shown = plates(&outlines, &grid(4, 3, 60.0), 0.4);
        let mut play = Play::new(faint);
        play.conditions.noise = noise;
        let tally = shown_after_learning(play, &shown, &names, 60);
        println!("{apart} grey levels: {tally:?}");
        assert!(tally.recall() >= 0.99 && tally.wrong == 0, "{tally:?}");
    }
}

#[test]
fn dim_light_hides_none() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let shown = plates(&outlines, &grid(4, 3, 60.0), 0.4);
    let mut play = Play::new(GREY);
    play.learn(&[]);
    let dim = |colour: [f32; 3]| colour.map(|c| 0.15 * c);
    play.palette = Palette {
        floor: dim(GREY.floor),
        paper: dim(GREY.paper),
        ink: dim(GREY.ink),
    };
    play.conditions.noise = 0.6;
    let mut tally = Tally::default();
    for frame in 0..60 {
        let scene = play.show(&shown);
        if frame >= 40 {
            tally.add(scene, &shown, &names);
        }
    }
    println!("dim: {tally:?}");
    assert!(tally.recall() >= 0.99 && tally.wrong == 0, "{tally:?}");
}

/// A cable or a hand lies across the plates of robots that drive and turn.
#[test]
fn a_cover_hides_no_known_robot() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let centres = grid(4, 3, 60.0);
    for (share, recall) in [(0.1, 0.99), (0.2, 0.94)] {
        let mut play = Play::new(GREY);
        play.learn(&[]);
        let mut tally = Tally::default();
        for step in 0..40_u16 {
            let step = f32::from(step);
            let moved: Vec<[f32; 2]> = centres.iter().map(|&[x, y]| [x + 0.6 * step, y]).collect();
            let mut moved = plates(&outlines, &moved, 0.02 * step);
            if step >= 10.0 {
                play.conditions.disturbance = Disturbance::Covered(share);
                for (i, plate) in moved.iter_mut().enumerate() {
                    plate.light = [1.3 * i as f32, (i % 7) as f32 / 6.0];
                }
            }
            let scene = play.show(&moved);
            if step >= 10.0 {
                tally.add(scene, &moved, &names);
            }
        }
        println!("covered by {share}: {:.3} {tally:?}", tally.recall());
        assert!(tally.recall() >= recall, "{share}: {tally:?}");
        assert_eq!(tally.wrong, 0, "{share}: {tally:?}");
        assert!(tally.worst_px < 0.4, "{share}: {tally:?}");
    }
}

/// Markers are expected where they were, but not believed to be there.
#[test]
fn what_replaces_a_known_robot_is_not_taken_for_it() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let centres = grid(4, 3, 60.0);
    let mut play = Play::new(GREY);
    play.learn(&[]);
    let robots = plates(&outlines, &centres, 0.3);
    for _ in 0..10 {
        play.show(&robots);
    }
    // Every other plate in the same place: with another marker, bare, half of it, and none.
    let square = vec![[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]];
    for replaced in 0..4 * centres.len() {
        let mut others = robots.clone();
        for (i, plate) in others.iter_mut().enumerate() {
            match replaced / centres.len() {
                0 => plate.figure = &outlines[(i + 1 + replaced) % centres.len()],
                1 => plate.figure = &square,
                2 => plate.turn_rad += std::f32::consts::PI,
                _ => plate.turn_rad += 0.6,
            }
        }
        let shown: Vec<&str> = (0..others.len())
            .map(|i| match replaced / centres.len() {
                0 => names[(i + 1 + replaced) % centres.len()],
                1 => "",
                _ => names[i],
            })
            .collect();
        let mut tally = Tally::default();
        tally.add(play.show(&others), &others, &shown);
        assert_eq!(tally.wrong, 0, "{replaced}: {tally:?}");
        play.show(&robots);
        let scene = play.show(&[]);
        let seen = scene.objects().iter().filter(|o| o.observed());
        assert_eq!(seen.count(), 0, "they are gone");
        play.show(&robots);
        play.show(&robots);
    }
}

/// A shape is not searched while all in it is known; a shape with something new is.
#[test]
fn what_is_put_beside_a_known_robot_is_read_in_its_first_frame() {
    let (outlines, names) = family();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let known = grid(3, 2, 80.0);
    // Their bodies touch.
    let beside = known.iter().map(|&[x, y]| [x + 1.4 * PLATE_PX, y]);
    let all: Vec<[f32; 2]> = known.iter().copied().chain(beside).collect();
    let mut plates = plates(&outlines, &all, 0.0);
    for plate in &mut plates {
        plate.robot = Robot::Dark;
    }
    let mut play = Play::new(GREY);
    play.learn(&[]);
    let mut tally = Tally::default();
    // In every eighth frame known robots are searched, too: one of these is not such a frame.
    for frames in [20, 5] {
        for _ in 0..frames {
            play.show(&plates[..known.len()]);
        }
        tally.add(play.show(&plates), &plates, &names);
    }
    println!("beside known robots: {tally:?}");
    assert_eq!((tally.read, tally.wrong), (tally.shown, 0), "{tally:?}");
}
