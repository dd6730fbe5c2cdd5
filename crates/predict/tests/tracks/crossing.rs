//! Identity switches in crowds that cross, with merged blobs, missed and false detections.
//!
//! Counted as in CLEAR-MOT (Bernardin and Stiefelhagen): an object keeps its track while that is
//! within [`FAR`] of it. A different track there is a switch.

use predict::{Observation, Track};

use crate::fixture::{Floor, Random, STEP_S, distance};

const FLOOR: [f64; 2] = [320.0, 240.0];
/// Speeds in pixels per second.
const SPEEDS: [f64; 2] = [20.0, 110.0];
/// Blobs are discs of this diameter. They merge where two are nearer than this.
const FAR: f64 = 6.0;
const NOISE: f64 = 0.3;
const SEEN: f64 = 0.97;
const FRAMES: usize = 300;

struct Mover {
    at: [f64; 2],
    heading: f64,
    speed: f64,
    turn: f64,
}

impl Mover {
    fn new(random: &mut Random) -> Self {
        Self {
            at: FLOOR.map(|max| random.within(0.0, max)),
            heading: random.within(-3.1, 3.1),
            speed: random.within(SPEEDS[0], SPEEDS[1]),
            turn: if random.next() < 0.5 {
                0.6 * random.normal()
            } else {
                0.0
            },
        }
    }

    fn go(&mut self) {
        self.heading += self.turn * STEP_S;
        let (s, c) = self.heading.sin_cos();
        self.at[0] += self.speed * STEP_S * c;
        self.at[1] += self.speed * STEP_S * s;
        if !(0.0..=FLOOR[0]).contains(&self.at[0]) {
            self.heading = std::f64::consts::PI - self.heading;
        }
        if !(0.0..=FLOOR[1]).contains(&self.at[1]) {
            self.heading = -self.heading;
        }
        for (position, max) in self.at.iter_mut().zip(FLOOR) {
            *position = position.clamp(0.0, max);
        }
    }
}

/// The detections of a camera: objects nearer to each other than `merging` are one blob, and some
/// blobs are false.
fn look(
    positions: &[[f64; 2]],
    merging: f64,
    false_blobs: f64,
    random: &mut Random,
) -> Vec<Observation> {
    let radius = 4.0;
    let mut blob_of: Vec<usize> = (0..positions.len()).collect();
    for i in 0..positions.len() {
        for j in 0..i {
            if distance(positions[i], positions[j]) < merging {
                let (from, to) = (blob_of[i], blob_of[j]);
                for blob in blob_of.iter_mut().filter(|blob| **blob == from) {
                    *blob = to;
                }
            }
        }
    }
    let mut blobs = Vec::new();
    for blob in 0..positions.len() {
        let members: Vec<[f64; 2]> = (0..positions.len())
            .filter(|i| blob_of[*i] == blob)
            .map(|i| positions[i])
            .collect();
        if members.is_empty() || random.next() > SEEN {
            continue;
        }
        let n = members.len() as f64;
        let middle = [0, 1].map(|axis| members.iter().map(|m| m[axis]).sum::<f64>() / n);
        let sigma = if members.len() > 1 {
            3.0 * NOISE
        } else {
            NOISE
        };
        let at = middle.map(|c| c + sigma * random.normal());
        let reach = members
            .iter()
            .map(|m| distance(*m, at) + radius)
            .fold(0.0, f64::max);
        let area = std::f64::consts::PI * radius * radius * n;
        let area = area * random.within(0.9, 1.1);
        blobs.push(Observation {
            covariance: [[sigma * sigma, 0.0], [0.0, sigma * sigma]],
            ..observation(at, reach, area)
        });
    }
    let mut left = false_blobs;
    while random.next() < left {
        let at = FLOOR.map(|max| random.within(0.0, max));
        blobs.push(observation(
            at,
            radius,
            std::f64::consts::PI * radius * radius,
        ));
        left -= 1.0;
    }
    // In random order.
    for i in (1..blobs.len()).rev() {
        blobs.swap(i, (random.next() * (i + 1) as f64) as usize);
    }
    blobs
}

fn observation(at: [f64; 2], reach: f64, area: f64) -> Observation {
    Observation {
        x: at[0],
        y: at[1],
        covariance: [[NOISE * NOISE, 0.0], [0.0, NOISE * NOISE]],
        heading: None,
        marker: None,
        reach,
        area,
    }
}

#[derive(Debug, Default)]
struct Count {
    switches: usize,
    object_frames: usize,
    /// Number of track frames, and of those without an object near.
    track_frames: usize,
    ghosts: usize,
}

impl Count {
    fn switches_per_1000(&self) -> f64 {
        1000.0 * self.switches as f64 / self.object_frames as f64
    }
}

fn crowd(n: usize, merging: f64, false_blobs: f64, n_scenes: u64) -> Count {
    let mut count = Count::default();
    for seed in 0..n_scenes {
        let mut random = Random::new(1000 * n as u64 + seed);
        let mut movers: Vec<Mover> = (0..n).map(|_| Mover::new(&mut random)).collect();
        let mut floor = Floor::new();
        floor.settings.top_speed = SPEEDS[1];
        floor.settings.gate_base = 4.0;
        floor.settings.confirm = 3;
        let mut track_of: Vec<Option<u64>> = vec![None; n];
        for _ in 0..FRAMES {
            let positions: Vec<[f64; 2]> = movers.iter().map(|mover| mover.at).collect();
            floor.observe(&look(&positions, merging, false_blobs, &mut random));
            let tracks: Vec<&Track> = floor.tracker.tracks().collect();
            count.add(&positions, &tracks, &mut track_of);
            movers.iter_mut().for_each(Mover::go);
        }
    }
    count
}

impl Count {
    fn add(&mut self, positions: &[[f64; 2]], tracks: &[&Track], track_of: &mut [Option<u64>]) {
        self.object_frames += positions.len();
        self.track_frames += tracks.len();
        let mut free = vec![true; tracks.len()];
        let mut found = vec![false; positions.len()];
        for (i, position) in positions.iter().enumerate() {
            let kept = tracks
                .iter()
                .position(|track| Some(track.id()) == track_of[i]);
            if let Some(kept) = kept.filter(|k| distance(tracks[*k].position(), *position) < FAR) {
                free[kept] = false;
                found[i] = true;
            }
        }
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (i, position) in positions.iter().enumerate() {
            for (k, track) in tracks.iter().enumerate() {
                let error = distance(track.position(), *position);
                if error < FAR && free[k] && !found[i] {
                    pairs.push((error, i, k));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, i, k) in pairs {
            if free[k] && !found[i] {
                (free[k], found[i]) = (false, true);
                let before = track_of[i].replace(tracks[k].id());
                self.switches += usize::from(before.is_some_and(|id| id != tracks[k].id()));
            }
        }
        let near = |track: &Track| {
            positions
                .iter()
                .any(|position| distance(*position, track.position()) < 2.0 * FAR)
        };
        self.ghosts += tracks.iter().filter(|track| !near(track)).count();
    }
}

#[test]
fn twenty_crossing_objects_keep_their_ids() {
    let count = crowd(20, 0.0, 0.1, 60);
    let switches = count.switches_per_1000();
    println!("20 crossing: {switches:.2} switches in 1000 object frames");
    // Measured 0.03. The rest are pairs that move side by side, and tracks of two or three samples.
    assert!(switches <= 0.045, "{count:?}");
}

#[test]
fn fifty_merging_objects_rarely_switch_ids() {
    let count = crowd(50, 8.0, 0.1, 10);
    let switches = count.switches_per_1000();
    println!("50 merging: {switches:.2} switches in 1000 object frames");
    // Measured 1.6. Most switches happen on leaving a blob in which an object has turned.
    assert!(switches <= 2.2, "{count:?}");
}

#[test]
fn false_detections_make_no_ghosts() {
    let count = crowd(20, 0.0, 1.0, 6);
    let part = count.ghosts as f64 / count.track_frames as f64;
    println!("ghosts: {:.2} % of track frames", 100.0 * part);
    // Measured 0.3 %.
    assert!(part < 0.0045, "{count:?}");
}
