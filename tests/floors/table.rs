//! Every scene on every floor: the figures equal those of the stored table.
//!
//! The table holds what segmentation is worth now, not what it should be: what is bad is stored as
//! it is, and must not get worse. What gets better fails too, until it is stored by
//! `FLOORS_RENEW=1 cargo test --test floors`. The difference in `table.txt` belongs to the commit.
//! `FLOORS_FIRST=1` ends with the first row that differs.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use imgproc::Size;

use crate::floor::Floor;
use crate::{day, empty_floors, ghosts, light_changes, masks, shadows, whole_shapes};

/// Size of the pictures, but for those of [`day`].
pub(crate) const SIZE: Size = Size {
    width: 320,
    height: 240,
};

/// A scene's name and what plays it on a floor.
pub(crate) type DrawnScene = (&'static str, fn(Floor) -> Figures);

const SCENES: [&[DrawnScene]; 7] = [
    masks::SCENES,
    shadows::SCENES,
    whole_shapes::SCENES,
    empty_floors::SCENES,
    ghosts::SCENES,
    light_changes::SCENES,
    day::SCENES,
];

/// What a scene came to on a floor; `None` where it has nothing of the kind.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Figures {
    /// F-measure of all outlines over all frames, 0 to 1.
    pub(crate) f: Option<f64>,
    /// Share of the frames and bodies in which a body is seen whole, as one object.
    pub(crate) whole: Option<f64>,
    /// Share of black bodies that is in an object.
    pub(crate) black: Option<f64>,
    /// Share of shadow that is in an object.
    pub(crate) shadow: Option<f64>,
    /// Objects a frame where nothing stands.
    pub(crate) n_false: Option<f64>,
    /// Frames until all is as it should be after something changed.
    pub(crate) frames: Option<usize>,
}

/// Heading of each column, and by how much its figure may differ: the sine and the root of another
/// machine round otherwise.
const COLUMNS: [(&str, f64); 6] = [
    ("F", 0.01),
    ("whole", 0.02),
    ("black", 0.02),
    ("shadow", 0.02),
    ("false", 0.05),
    ("frames", 2.0),
];

/// Columns in which less is better.
const LESS_IS_BETTER: [&str; 3] = ["shadow", "false", "frames"];

/// A count, shared out among the frames or what else was looked at.
pub(crate) fn per_frame(n: usize, frames: usize) -> Option<f64> {
    Some(n as f64 / frames as f64)
}

/// The figures of a row as they are written.
type Row = [String; COLUMNS.len()];

impl Figures {
    fn written(&self) -> Row {
        let share = |value: Option<f64>| value.map(|value| format!("{value:.3}"));
        let frames = self.frames.map(|frames| frames.to_string());
        [
            share(self.f),
            share(self.whole),
            share(self.black),
            share(self.shadow),
            share(self.n_false),
            frames,
        ]
        .map(|figure| figure.unwrap_or("-".to_owned()))
    }
}

/// Plays all scenes on all floors, on all processors, until a row is the last one wanted.
fn rows(is_last: impl Fn(&str, &Row) -> bool + Sync) -> Vec<(String, Row)> {
    let plays: Vec<_> = SCENES
        .into_iter()
        .flatten()
        .flat_map(|scene| Floor::ALL.map(|floor| (scene, floor)))
        .collect();
    let next = AtomicUsize::new(0);
    let rows = Mutex::new(vec![None; plays.len()]);
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(((name, play), floor)) = plays.get(index) else {
                break;
            };
            let (name, figures) = (format!("{name} {floor:?}"), play(*floor).written());
            if is_last(&name, &figures) {
                next.store(plays.len(), Ordering::Relaxed);
            }
            rows.lock().expect("no thread has panicked")[index] = Some((name, figures));
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(work);
        }
    });
    let rows = rows.into_inner().expect("no thread has panicked");
    rows.into_iter().flatten().collect()
}

fn text(rows: &[(String, Row)]) -> String {
    let mut text = String::from(
        "# What segmentation is worth on drawn floors, stored by\n\
         # FLOORS_RENEW=1 cargo test --test floors\n\
         #\n\
         # F       F-measure of the outlines\n\
         # whole   share of bodies that are seen as one object\n\
         # black   share of black bodies that is in objects\n\
         # shadow  share of shadows that is in objects\n\
         # false   objects a frame where nothing stands\n\
         # frames  until all is as it should be after a change\n",
    );
    let mut line = |name: &str, figures: [&str; COLUMNS.len()]| {
        let (scene, floor) = name.split_once(' ').expect("scene and floor");
        let _ = write!(text, "{scene:24} {floor:10}");
        for figure in figures {
            let _ = write!(text, " {figure:>7}");
        }
        text.push('\n');
    };
    line("scene floor", COLUMNS.map(|(heading, _)| heading));
    for (name, figures) in rows {
        line(name, figures.each_ref().map(String::as_str));
    }
    text
}

fn parsed(text: &str) -> BTreeMap<String, Vec<String>> {
    let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    lines
        .map(|line| {
            let mut words = line.split_whitespace().map(str::to_owned);
            let name: Vec<_> = words.by_ref().take(2).collect();
            (name.join(" "), words.collect())
        })
        .collect()
}

/// One line for each figure that moved, and for each row that is new or gone.
fn moved(
    stored: &BTreeMap<String, Vec<String>>,
    now: &BTreeMap<String, Vec<String>>,
) -> Vec<String> {
    let rows = now.iter();
    let mut moved: Vec<_> = rows
        .flat_map(|(name, figures)| moved_in_row(stored, name, figures))
        .collect();
    let gone = stored.keys().filter(|name| !now.contains_key(*name));
    moved.extend(gone.map(|name| format!("{name}: is gone")));
    moved
}

fn moved_in_row(
    stored: &BTreeMap<String, Vec<String>>,
    name: &str,
    figures: &[String],
) -> Vec<String> {
    let Some(before) = stored.get(name) else {
        return vec![format!("{name}: is new")];
    };
    let mut moved = Vec::new();
    for (i, (heading, tolerance)) in COLUMNS.into_iter().enumerate() {
        let (from, to) = (
            before.get(i).map_or("?", String::as_str),
            figures[i].as_str(),
        );
        let step = match (from.parse::<f64>(), to.parse::<f64>()) {
            (Ok(from), Ok(to)) => to - from,
            _ if from == to => 0.0,
            _ => f64::INFINITY,
        };
        // Figures are written with three digits.
        if step.abs() > tolerance + 1e-9 {
            let better = (step > 0.0) != LESS_IS_BETTER.contains(&heading);
            let what = if better { "better" } else { "worse" };
            moved.push(format!("{name}: {heading} from {from} to {to}, {what}"));
        }
    }
    moved
}

#[test]
fn every_scene_on_every_floor() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/floors/table.txt");
    let stored = std::fs::read_to_string(&file).expect("a stored table");
    let mut stored = parsed(&stored);
    let first_only = std::env::var_os("FLOORS_FIRST").is_some();
    let is_last =
        |name: &str, row: &Row| first_only && !moved_in_row(&stored, name, row).is_empty();
    let now = text(&rows(is_last));
    if std::env::var_os("FLOORS_RENEW").is_some() {
        std::fs::write(&file, &now).expect("the table is stored");
        stored = parsed(&now);
    }
    let moved = moved(&stored, &parsed(&now));
    assert!(
        moved.is_empty(),
        "{} figures moved:\n{}\nIf that is intended: FLOORS_RENEW=1 cargo test --test floors",
        moved.len(),
        moved.join("\n")
    );
}

#[test]
fn what_moved_is_named() {
    let row = |figures: [&str; COLUMNS.len()]| figures.map(str::to_owned);
    let table = |rows: &[(&str, [&str; COLUMNS.len()])]| {
        let rows: Vec<_> = rows
            .iter()
            .map(|(name, f)| (name.to_string(), row(*f)))
            .collect();
        parsed(&text(&rows))
    };
    let stored = table(&[
        ("masks Wood", ["0.950", "-", "-", "0.300", "0.000", "12"]),
        ("rings Wood", ["0.950", "-", "-", "-", "-", "-"]),
    ]);
    assert_eq!(moved(&stored, &stored), [""; 0]);
    let within = table(&[
        ("masks Wood", ["0.960", "-", "-", "0.280", "0.050", "14"]),
        ("rings Wood", ["0.940", "-", "-", "-", "-", "-"]),
    ]);
    assert_eq!(moved(&stored, &within), [""; 0]);
    let other = table(&[
        ("masks Wood", ["0.939", "-", "-", "0.200", "-", "15"]),
        ("stripes Wood", ["0.950", "-", "-", "-", "-", "-"]),
    ]);
    assert_eq!(
        moved(&stored, &other),
        [
            "masks Wood: F from 0.950 to 0.939, worse",
            "masks Wood: shadow from 0.300 to 0.200, better",
            "masks Wood: false from 0.000 to -, worse",
            "masks Wood: frames from 12 to 15, worse",
            "stripes Wood: is new",
            "rings Wood: is gone",
        ]
    );
}
