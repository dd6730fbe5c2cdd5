//! The life cycle of tracks: association, substitution by the forecast, retirement, start (section
//! 3.1.1 of the paper).

mod assign;
mod association;
mod blob;
mod frame_context;
mod hypotheses;
mod merge;
pub(crate) mod track;

use crate::bounds::{Bounds, NO_BOUNDS, expanded};
use crate::limits::{MAX_OBSERVATIONS, MAX_TRACKS};
use crate::observation::{Observation, Settings};
use crate::time::NS_PER_S;
use crate::tracker::association::{Association, associate};
use crate::tracker::frame_context::FrameContext;
use crate::tracker::merge::is_isolated;
use crate::tracker::track::Track;

/// Tracks all objects on the floor from frame to frame.
///
/// The caller provides the memory for the tracks, because a track takes about 51 kB and this crate
/// has no heap. `S` may be a vector, a boxed slice or an array.
///
/// ```
/// use predict::{MAX_TRACKS, Track, Tracker};
///
/// let tracker = Tracker::new(vec![Track::EMPTY; MAX_TRACKS]);
/// assert_eq!(tracker.tracks().count(), 0);
/// ```
#[derive(Debug, Clone)]
pub struct Tracker<S> {
    /// The first `n_tracks` are alive, in order of their ids.
    storage: S,
    n_tracks: usize,
    next_id: u64,
    /// The tracker's own time: the sum of all forward steps of the time stamps, each limited to the
    /// longest gap.
    clock_ns: u64,
    last_stamp_ns: Option<u64>,
    settings: Settings,
    bounds: Bounds,
    /// Markers and ids of robots whose tracks are retired, oldest first.
    retired_robots: [(u32, u64); MAX_TRACKS],
    n_retired_robots: usize,
}

/// What [`Tracker::update`] did with the observations and tracks of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Update {
    /// Observations ignored because a number was not finite, a variance negative, or a coordinate
    /// beyond 1e9.
    pub rejected: usize,
    /// Observations ignored for lack of capacity: beyond [`MAX_OBSERVATIONS`], or new when all
    /// tracks were in use.
    pub overflow: usize,
    /// Tracks started in this frame.
    pub started: usize,
    /// Tracks retired in this frame.
    pub retired: usize,
}

impl<S: AsRef<[Track]> + AsMut<[Track]>> Tracker<S> {
    /// A tracker without tracks. The length of `storage`, up to [`MAX_TRACKS`], is the maximum
    /// number of tracks alive at once. Its contents do not matter.
    #[must_use]
    pub fn new(storage: S) -> Self {
        Self {
            storage,
            n_tracks: 0,
            next_id: 1,
            clock_ns: 0,
            last_stamp_ns: None,
            settings: Settings::default(),
            bounds: NO_BOUNDS,
            retired_robots: [(0, 0); MAX_TRACKS],
            n_retired_robots: 0,
        }
    }

    /// The reported tracks in order of their ids.
    pub fn tracks(&self) -> impl Iterator<Item = &Track> {
        self.alive()
            .iter()
            .filter(|track| track.is_confirmed(&self.settings))
    }

    /// Forgets the bounds of the floor and the robots that were on it. Call this when the camera
    /// looks at another floor. Tracks that are alive continue.
    pub fn forget_floor(&mut self) {
        self.bounds = NO_BOUNDS;
        self.n_retired_robots = 0;
    }

    /// Processes the observations of one frame that was exposed at `stamp_ns`.
    ///
    /// The frame rate may vary. A time stamp that is not later than the previous one counts as the
    /// same time. A step of more than two seconds, or of four frame periods if that is longer,
    /// counts as that long. Observations and settings may hold any values: invalid observations are
    /// ignored and counted, invalid settings become the default.
    ///
    /// Cost: about 18 µs per observed track, on one thread.
    pub fn update(
        &mut self,
        stamp_ns: u64,
        observations: &[Observation],
        settings: &Settings,
    ) -> Update {
        let settings = &settings.checked();
        self.settings = *settings;
        let since_last_s = self.advance_clock(stamp_ns);
        let mut update = Update::default();

        let n_used = observations.len().min(MAX_OBSERVATIONS);
        update.overflow = observations.len() - n_used;
        let mut checked = [None; MAX_OBSERVATIONS];
        let mut taken = [false; MAX_OBSERVATIONS];
        for (i, observation) in observations[..n_used].iter().enumerate() {
            checked[i] = observation.checked();
            taken[i] = checked[i].is_none();
        }
        let (checked, taken) = (&checked[..n_used], &mut taken[..n_used]);
        update.rejected = taken.iter().filter(|taken| **taken).count();

        for observation in checked.iter().flatten() {
            self.bounds = expanded(&self.bounds, [observation.x, observation.y]);
        }
        let frame = FrameContext {
            time_ns: self.clock_ns,
            since_last_s,
            bounds: self.bounds,
            settings,
        };
        let associations = associate(self.alive(), checked, taken, frame);
        let alive = &mut self.storage.as_mut()[..self.n_tracks];
        let mut named = [None; MAX_TRACKS];
        for ((track, association), named) in alive.iter_mut().zip(associations).zip(&mut named) {
            let was_nameless = track.last_marker().is_none();
            match association {
                Association::Missed => track.miss(frame),
                Association::Own {
                    index,
                    observation,
                    isolated,
                    carried,
                } => {
                    if carried {
                        track.forget_motion();
                    }
                    track.observe(index, observation, isolated, frame);
                }
                Association::Merged(blob) => track.observe_merged(&blob, frame),
            }
            *named = track.last_marker().filter(|_| was_nameless);
        }
        self.restore_ids(&named);
        update.retired = self.retire();
        self.start_tracks(checked, taken, frame, &mut update);
        update
    }

    fn alive(&self) -> &[Track] {
        &self.storage.as_ref()[..self.n_tracks]
    }

    /// Maximum number of tracks alive at once.
    fn capacity(&self) -> usize {
        self.storage.as_ref().len().min(MAX_TRACKS)
    }

    /// Advances the clock to the frame. Returns the step in seconds.
    fn advance_clock(&mut self, stamp_ns: u64) -> f64 {
        let max_step_ns = (self.settings.max_gap_s() * NS_PER_S) as u64;
        let step_ns = self
            .last_stamp_ns
            .map_or(0, |last_ns| stamp_ns.saturating_sub(last_ns))
            .min(max_step_ns);
        self.last_stamp_ns = Some(stamp_ns);
        self.clock_ns = self.clock_ns.saturating_add(step_ns);
        step_ns as f64 / NS_PER_S
    }

    /// Drops lost tracks, keeps the order of the others, and remembers the ids of lost robots.
    fn retire(&mut self) -> usize {
        let tracks = self.storage.as_mut();
        let mut kept = 0;
        for i in 0..self.n_tracks {
            let is_lost = tracks[i].is_lost(&self.settings);
            if let (true, Some(marker)) = (is_lost, tracks[i].last_marker()) {
                if self.n_retired_robots == MAX_TRACKS {
                    self.retired_robots.copy_within(1.., 0);
                    self.n_retired_robots -= 1;
                }
                self.retired_robots[self.n_retired_robots] = (marker, tracks[i].id());
                self.n_retired_robots += 1;
            }
            if !is_lost {
                if kept < i {
                    tracks.swap(kept, i);
                }
                kept += 1;
            }
        }
        let retired = self.n_tracks - kept;
        self.n_tracks = kept;
        retired
    }

    /// Starts a track for every observation that is not taken.
    fn start_tracks(
        &mut self,
        observations: &[Option<Observation>],
        taken: &[bool],
        frame: FrameContext<'_>,
        update: &mut Update,
    ) {
        for (i, observation) in observations.iter().enumerate() {
            let Some(observation) = observation.as_ref().filter(|_| !taken[i]) else {
                continue;
            };
            if self.n_tracks == self.capacity() {
                update.overflow += 1;
                continue;
            }
            let isolated = is_isolated(i, observations);
            let id = self.id_for(observation.marker);
            let tracks = &mut self.storage.as_mut()[..=self.n_tracks];
            tracks[self.n_tracks] = Track::start(id, i, observation, isolated, frame);
            // A robot that returns has an old id.
            let position = tracks[..self.n_tracks].partition_point(|track| track.id() < id);
            tracks[position..].rotate_right(1);
            self.n_tracks += 1;
            update.started += 1;
        }
    }

    /// Gives tracks whose marker was read for the first time the ids that these robots had before:
    /// a robot that comes into the picture is an object without a marker until its plate is
    /// visible. A track of the robot that waits for it elsewhere ends.
    fn restore_ids(&mut self, named: &[Option<u32>; MAX_TRACKS]) {
        for (i, marker) in named.iter().enumerate() {
            let Some(marker) = *marker else { continue };
            let id = self.retired_id(marker).or_else(|| {
                let mut others = self.storage.as_mut()[..self.n_tracks].iter_mut();
                let waits =
                    |track: &&mut Track| track.misses() > 0 && track.last_marker() == Some(marker);
                others.find(waits).map(|track| {
                    track.end();
                    track.id()
                })
            });
            if let Some(id) = id {
                self.storage.as_mut()[i].rename(id);
            }
        }
        let tracks = &mut self.storage.as_mut()[..self.n_tracks];
        for i in 1..tracks.len() {
            let id = tracks[i].id();
            let position = tracks[..i].partition_point(|track| track.id() <= id);
            tracks[position..=i].rotate_right(1);
        }
    }

    /// The id of a new track: the one that the robot with this marker had before, or the next one.
    fn id_for(&mut self, marker: Option<u32>) -> u64 {
        marker
            .and_then(|marker| self.retired_id(marker))
            .unwrap_or_else(|| {
                self.next_id += 1;
                self.next_id - 1
            })
    }

    /// The id that a retired robot with this marker had. It is no longer one of the retired.
    fn retired_id(&mut self, marker: u32) -> Option<u64> {
        let robots = &mut self.retired_robots[..self.n_retired_robots];
        let i = robots.iter().position(|robot| robot.0 == marker)?;
        let (_, id) = robots[i];
        robots.copy_within(i + 1.., i);
        self.n_retired_robots -= 1;
        Some(id)
    }
}
