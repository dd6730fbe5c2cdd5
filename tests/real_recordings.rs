//! What is found in recordings of real floors, compared with truth from people or a plain
//! threshold.
//!
//! The recordings belong to others and are not part of the project. `RECORDINGS` names a folder
//! that holds them: `traco` with videos of small robots and the positions of their heads, and
//! `grey` with a video of two flies. ffmpeg decodes them.

use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use overcam::image::frame::Frame;
use overcam::marker::{Family, built_in_files};
use overcam::pipeline::{Outcome, Pipeline};
use overcam::run::slot::{Next, Slot, SourceInfo};
use overcam::settings::Settings;
use overcam::source::y4m::Y4m;
use scene::{Object, Scene};

/// Distance from an outline within which a position still belongs to the object, in pixels of the
/// scaled picture: people do not click more precisely.
const NEAR_PX: f64 = 4.0;

fn recordings(folder: &str) -> PathBuf {
    let all = std::env::var_os("RECORDINGS").expect("RECORDINGS names the folder of recordings");
    Path::new(&all).join(folder)
}

/// A video, decoded by ffmpeg.
struct Video {
    ffmpeg: Child,
    frames: Y4m<BufReader<ChildStdout>>,
}

impl Video {
    fn open(path: &Path, filter: &str, pixels: &str) -> Self {
        let mut ffmpeg = Command::new("ffmpeg")
            .args(["-v", "error", "-i"])
            .arg(path)
            .args(["-fps_mode", "passthrough", "-vf", filter])
            .args([
                "-f",
                "yuv4mpegpipe",
                "-strict",
                "-1",
                "-pix_fmt",
                pixels,
                "-",
            ])
            .stdout(Stdio::piped())
            .spawn()
            .expect("ffmpeg is installed");
        let output = ffmpeg.stdout.take().expect("it is piped");
        let name = path.display().to_string();
        let frames = Y4m::new(name, BufReader::new(output)).expect("ffmpeg decodes the video");
        Self { ffmpeg, frames }
    }

    fn info(&self) -> SourceInfo {
        self.frames.info()
    }

    /// Fills the frame. False at the end.
    fn next(&mut self, frame: &mut Frame) -> bool {
        let next = self.frames.next(frame).expect("ffmpeg's frames are whole");
        if next == Next::End {
            let status = self.ffmpeg.wait().expect("ffmpeg was started");
            assert!(status.success(), "ffmpeg broke off: {status}");
        }
        next == Next::Frame
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        // It may have ended already; it only must not keep running.
        _ = self.ffmpeg.kill();
        _ = self.ffmpeg.wait();
    }
}

/// A pipeline with the default settings except for the number of frames it learns from.
struct Play {
    pipeline: Pipeline,
    slot: Slot,
    n_frames: u64,
    period_ns: u64,
}

impl Play {
    fn new(info: &SourceInfo, learn: u32) -> Self {
        let settings = Settings {
            learn,
            ..Settings::default()
        };
        let family = Family::from_files(&built_in_files()).expect("the built-in family is usable");
        let rate_hz = info.rate_hz.expect("Y4M states the rate");
        Self {
            pipeline: Pipeline::new(info.size, Some(rate_hz), settings, family, None),
            slot: Slot::empty(),
            n_frames: 0,
            period_ns: (1e9 / rate_hz) as u64,
        }
    }

    /// Processes the frame that `fill` puts into the slot. Time continues even if a video starts
    /// again.
    fn frame(&mut self, fill: impl FnOnce(&mut Frame) -> bool) -> Option<Outcome> {
        self.slot.background = None;
        if !fill(&mut self.slot.frame) {
            return None;
        }
        self.slot.frame.sequence = self.n_frames;
        self.slot.frame.stamp_ns = self.n_frames * self.period_ns;
        self.n_frames += 1;
        let outcome = self.pipeline.process(&mut self.slot);
        Some(outcome.expect("ffmpeg's frames are pictures"))
    }
}

/// The objects that were observed.
fn observed(scene: &Scene) -> impl Iterator<Item = &Object> {
    scene.objects().iter().filter(|object| object.observed())
}

/// Whether a position is inside an outline or near it.
fn holds(object: &Object, [x, y]: [f64; 2]) -> bool {
    let corners = object.outline();
    let mut inside = false;
    let mut near = false;
    for (i, &[x0, y0]) in corners.iter().enumerate() {
        let [x1, y1] = corners[(i + 1) % corners.len()];
        if (y0 <= y) != (y1 <= y) && x0 + (y - y0) / (y1 - y0) * (x1 - x0) < x {
            inside = !inside;
        }
        let (dx, dy) = (x1 - x0, y1 - y0);
        let along = ((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy).max(1e-12);
        let along = along.clamp(0.0, 1.0);
        near |= (x - x0 - along * dx).hypot(y - y0 - along * dy) <= NEAR_PX;
    }
    inside || near
}

/// Number of positions that lie in objects, and number of objects that contain none of them.
fn compare(scene: &Scene, places: &[[f64; 2]]) -> (usize, usize) {
    let hit = |place: &&[f64; 2]| observed(scene).any(|object| holds(object, **place));
    let is_false = |object: &&Object| !places.iter().any(|&place| holds(object, place));
    (
        places.iter().filter(hit).count(),
        observed(scene).filter(is_false).count(),
    )
}

/// Width and height of a video as stored.
fn stored_size(path: &Path) -> [f64; 2] {
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-select_streams", "v:0"])
        .args(["-show_entries", "stream=width,height", "-of", "csv=p=0"])
        .arg(path)
        .output()
        .expect("ffprobe is installed with ffmpeg");
    let text = String::from_utf8(output.stdout).expect("numbers");
    let mut sides = text.trim().trim_end_matches(',').split(',');
    let mut side = || {
        let side = sides.next().expect("two sides");
        side.parse().expect("a side is a number")
    };
    [side(), side()]
}

/// Heads in each frame, in stored pixels: a table with the columns row number, frame, robot, x, y.
fn heads(path: &Path) -> Vec<Vec<[f64; 2]>> {
    let text = std::fs::read_to_string(path).expect("the table of heads");
    let mut heads = Vec::new();
    for line in text.lines().skip(1) {
        let columns: Vec<f64> = line
            .split(',')
            .map(|column| column.parse().expect("a number"))
            .collect();
        let [_, frame, _, x, y] = columns[..] else {
            panic!("{}: a row has other columns: {line}", path.display());
        };
        // A robot that nobody saw has no position.
        if x.is_nan() || y.is_nan() {
            continue;
        }
        let frame = frame as usize;
        if heads.len() <= frame {
            heads.resize(frame + 1, Vec::new());
        }
        heads[frame].push([x, y]);
    }
    heads
}

#[test]
#[ignore = "RECORDINGS=DIR with the folders traco and grey; needs ffmpeg: RECORDINGS=... cargo test --test real_recordings -- --ignored --nocapture"]
fn robots_on_real_floors_are_found_and_nothing_else() {
    let folder = recordings("traco");
    let entries = std::fs::read_dir(&folder).expect("the folder traco");
    let mut videos: Vec<_> = entries
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "mp4"))
        .collect();
    videos.sort();
    assert!(!videos.is_empty(), "{}: no videos", folder.display());
    println!("video          frames  heads hit  false objects a frame");
    let mut missed = Vec::new();
    let mut false_rates = 0.0;
    for path in &videos {
        let (share, false_rate, n_frames) = judge_robots(path);
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        println!("{name:14} {n_frames:6} {share:10.3} {false_rate:10.3}");
        false_rates += false_rate;
        if share < 0.98 {
            missed.push(format!("{name}: {share:.3} of the heads"));
        }
    }
    let false_rate = false_rates / videos.len() as f64;
    println!("false objects a frame, mean over the videos: {false_rate:.3}");
    assert!(missed.is_empty(), "{}", missed.join("\n"));
    assert!(false_rate <= 0.10, "{false_rate:.3} false objects a frame");
}

/// Learns the floor from a whole video and evaluates the same video: share of heads that were hit,
/// false objects per frame, number of frames.
fn judge_robots(path: &Path) -> (f64, f64, usize) {
    let mut video = Video::open(path, "scale=640:-2", "yuv422p");
    let info = video.info();
    let mut frames = Vec::new();
    let mut frame = Frame::empty();
    while video.next(&mut frame) {
        frames.push(frame.clone());
    }
    let stored = stored_size(path);
    let scale = [
        info.size.width as f64 / stored[0],
        info.size.height as f64 / stored[1],
    ];
    let heads = heads(&path.with_extension("csv"));
    let mut play = Play::new(&info, frames.len() as u32);
    for frame in &frames {
        let outcome = play.frame(|slot| {
            slot.clone_from(frame);
            true
        });
        assert_eq!(outcome, Some(Outcome::Learning));
    }
    let (mut n_heads, mut n_hit, mut n_false) = (0, 0, 0);
    for (i, frame) in frames.iter().enumerate() {
        let outcome = play.frame(|slot| {
            slot.clone_from(frame);
            true
        });
        assert_eq!(outcome, Some(Outcome::Scene));
        let scaled = |[x, y]: [f64; 2]| [(x + 0.5) * scale[0] - 0.5, (y + 0.5) * scale[1] - 0.5];
        let here = heads.get(i).map_or(&[][..], Vec::as_slice);
        let here: Vec<_> = here.iter().copied().map(scaled).collect();
        let (hit, is_false) = compare(&play.slot.scene, &here);
        n_heads += here.len();
        n_hit += hit;
        n_false += is_false;
    }
    assert!(n_heads > 0, "{}: no heads", path.display());
    (
        n_hit as f64 / n_heads as f64,
        n_false as f64 / frames.len() as f64,
        frames.len(),
    )
}

/// A fly's body is brighter than this. Its wings and the floor are darker, except for specks.
const BODY_LEVEL: u8 = 140;

/// A body has about 300 pixels at a width of 640, a speck fewer than 20.
const BODY_AREA_MIN: usize = 100;

/// Centres of the bodies in a grey frame: connected bright pixels (8-connectivity).
fn bodies(frame: &Frame) -> Vec<[f64; 2]> {
    let (width, height) = (frame.size.width, frame.size.height);
    let mut bright: Vec<bool> = frame.bytes.iter().map(|&b| b > BODY_LEVEL).collect();
    let (mut found, mut open) = (Vec::new(), Vec::new());
    for start in 0..bright.len() {
        if !std::mem::take(&mut bright[start]) {
            continue;
        }
        open.push(start);
        let (mut area, mut sum) = (0, [0, 0]);
        while let Some(at) = open.pop() {
            let (x, y) = (at % width, at / width);
            area += 1;
            sum = [sum[0] + x, sum[1] + y];
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    if std::mem::take(&mut bright[y * width + x]) {
                        open.push(y * width + x);
                    }
                }
            }
        }
        if area >= BODY_AREA_MIN {
            found.push(sum.map(|sum| sum as f64 / area as f64));
        }
    }
    found
}

#[test]
#[ignore = "RECORDINGS=DIR with the folders traco and grey; needs ffmpeg: RECORDINGS=... cargo test --test real_recordings -- --ignored --nocapture"]
fn two_flies_in_a_grey_video_are_found_and_nothing_else() {
    let path = recordings("grey").join("flies.mp4");
    // The floor is learned from every tenth frame of the whole run, since a fly may sit still for
    // long.
    let mut run = Video::open(&path, "select='not(mod(n,10))',scale=640:-2", "gray");
    let mut play = Play::new(&run.info(), 300);
    for _ in 0..300 {
        assert_eq!(play.frame(|frame| run.next(frame)), Some(Outcome::Learning));
    }
    let mut video = Video::open(&path, "scale=640:-2", "gray");
    let (mut n_frames, mut n_good, mut n_missed, mut n_false, mut n_strange) = (0, 0, 0, 0, 0);
    while let Some(outcome) = play.frame(|frame| video.next(frame)) {
        assert_eq!(outcome, Outcome::Scene);
        let bodies = bodies(&play.slot.frame);
        // Touching bodies are one; more than two would be a mistake of this test.
        n_strange += usize::from(!(1..=2).contains(&bodies.len()));
        let (hit, is_false) = compare(&play.slot.scene, &bodies);
        n_frames += 1;
        n_missed += bodies.len() - hit;
        n_false += is_false;
        n_good += usize::from(hit == bodies.len() && is_false == 0);
    }
    let share = n_good as f64 / f64::from(n_frames);
    println!(
        "flies: {n_frames} frames, good {share:.3}, flies missed {n_missed}, false objects {n_false}"
    );
    assert_eq!(
        n_strange, 0,
        "the truth of {n_strange} frames is not one or two flies"
    );
    assert!(
        share >= 0.95,
        "both flies and nothing else in {share:.3} of the frames"
    );
}
