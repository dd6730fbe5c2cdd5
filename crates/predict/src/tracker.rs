//! The life of tracks: forecast, assignment, substitution, retirement, birth (section 3.1.1 of the paper).

use libm::sqrt;

use crate::assign::assign_nearest;
use crate::covariance::Covariance;
use crate::merge::{Sighting, find_merged, stands_alone};
use crate::motion::{norm_squared, sub};
use crate::observation::{Observation, Settings};
use crate::track::Track;
use crate::{MAX_GAP_STEPS, MAX_OBSERVATIONS, MAX_TRACKS, NS_PER_S};

/// Gate of a track seen in the last frame, in ways at top speed since then. The forecast may be as wrong as twice
/// the top speed where an object turns back; narrower gates lose objects in measurements, wider ones gain nothing.
const GATE_SPEEDS: f64 = 3.0;
/// How much wider the gate is between an observation and the track of the same marker: no other track may claim
/// that, so a robot may have been carried a bit.
const SAME_MARKER_GATES: f64 = 3.0;

/// All objects on the floor, from frame to frame.
///
/// A plain value of about 800 kB without a heap: box it once, `Box::new(Tracker::new())`, which takes it over the stack,
/// and do not move it after that.
#[derive(Debug, Clone)]
pub struct Tracker {
    /// The first `n_tracks` are alive, in the order of their numbers.
    tracks: [Track; MAX_TRACKS],
    n_tracks: usize,
    next_id: u64,
    /// The tracker's own time: the sum of all forward steps of the time stamps, none longer than the longest gap.
    clock_ns: u64,
    last_stamp_ns: Option<u64>,
    settings: Settings,
}

/// What [`Tracker::update`] did to the frame's observations and the tracks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Update {
    /// Observations ignored because a number in them was not finite, a variance negative or a coordinate beyond 1e9.
    pub rejected: usize,
    /// Observations ignored for want of room: past [`MAX_OBSERVATIONS`], or new with [`MAX_TRACKS`] tracks alive.
    pub overflow: usize,
    /// Tracks begun in this frame.
    pub started: usize,
    /// Tracks dropped in this frame.
    pub retired: usize,
}

impl Tracker {
    /// A tracker that has seen nothing.
    #[must_use]
    pub fn new() -> Self {
        Self {
            tracks: [const { Track::EMPTY }; MAX_TRACKS],
            n_tracks: 0,
            next_id: 1,
            clock_ns: 0,
            last_stamp_ns: None,
            settings: Settings::default(),
        }
    }

    /// The reported tracks, in the order of their numbers.
    pub fn tracks(&self) -> impl Iterator<Item = &Track> {
        self.tracks[..self.n_tracks]
            .iter()
            .filter(|track| track.confirmed(&self.settings))
    }

    /// Takes the observations of one frame, exposed at `stamp_ns`.
    ///
    /// Frames may come unevenly. A time stamp that does not lie after the one before counts as the same moment; a
    /// jump ahead of more than 30 forecast steps counts as 30. Observations and settings may hold anything: what is
    /// no number is ignored and counted, or replaced by the default.
    ///
    /// Cost: about 25 µs for each track that is observed, on one thread.
    pub fn update(
        &mut self,
        stamp_ns: u64,
        observations: &[Observation],
        settings: &Settings,
    ) -> Update {
        let settings = &settings.checked();
        self.settings = *settings;
        let frame_s = self.advance(stamp_ns);
        let mut update = Update::default();

        let n_seen = observations.len().min(MAX_OBSERVATIONS);
        update.overflow = observations.len() - n_seen;
        let mut checked = [None; MAX_OBSERVATIONS];
        let mut taken = [false; MAX_OBSERVATIONS];
        for (i, observation) in observations[..n_seen].iter().enumerate() {
            checked[i] = observation.checked();
            taken[i] = checked[i].is_none();
        }
        let (checked, taken) = (&checked[..n_seen], &mut taken[..n_seen]);
        update.rejected = taken.iter().filter(|taken| **taken).count();

        let sightings = self.assign(checked, taken, frame_s);
        let now_ns = self.clock_ns;
        for (track, sighting) in self.tracks[..self.n_tracks].iter_mut().zip(sightings) {
            match sighting {
                Sighting::Missed => track.miss(now_ns, settings),
                Sighting::Own {
                    index,
                    observation,
                    alone,
                } => track.sight(index, observation, alone, now_ns, settings),
                Sighting::Merged(blob) => track.merge(&blob, now_ns, settings),
            }
        }
        update.retired = self.retire();
        for (i, observation) in checked.iter().enumerate() {
            if let Some(observation) = observation.as_ref().filter(|_| !taken[i]) {
                if self.n_tracks == MAX_TRACKS {
                    update.overflow += 1;
                    continue;
                }
                let alone = stands_alone(i, checked);
                self.tracks[self.n_tracks] =
                    Track::start(self.next_id, i, observation, alone, now_ns, settings);
                self.n_tracks += 1;
                self.next_id += 1;
                update.started += 1;
            }
        }
        update
    }

    /// Moves the clock to the frame and returns by how many seconds.
    fn advance(&mut self, stamp_ns: u64) -> f64 {
        let longest_ns = (MAX_GAP_STEPS * self.settings.forecast_step_s * NS_PER_S) as u64;
        let since_last_ns = self
            .last_stamp_ns
            .map_or(0, |last_ns| stamp_ns.saturating_sub(last_ns))
            .min(longest_ns);
        self.last_stamp_ns = Some(stamp_ns);
        self.clock_ns = self.clock_ns.saturating_add(since_last_ns);
        since_last_ns as f64 / NS_PER_S
    }

    /// What each track's object is seen as. Markers first: one that was read belongs to the track of that marker; then
    /// blobs of several objects, so that none of these is looked for elsewhere; then all that is left by distance, but
    /// never an observation of one marker to the track of another.
    ///
    /// Two things may carry the same marker, hence distance decides among them too.
    fn assign<'a>(
        &self,
        observations: &'a [Option<Observation>],
        taken: &mut [bool],
        frame_s: f64,
    ) -> [Sighting<'a>; MAX_TRACKS] {
        let tracks = &self.tracks[..self.n_tracks];
        let mut expected: [([f64; 2], Covariance); MAX_TRACKS] = [Default::default(); MAX_TRACKS];
        let mut gates = [0.0; MAX_TRACKS];
        for (i, track) in tracks.iter().enumerate() {
            expected[i] = track.expected(self.clock_ns);
            gates[i] = self.gate(track, frame_s);
        }
        let within = |track: usize, observation: &Observation, gates_wide: f64| {
            let apart = sub([observation.x, observation.y], expected[track].0);
            let distance = sqrt(norm_squared(apart));
            (distance <= gates_wide * gates[track]).then_some(distance)
        };
        let mut observation_of = [None; MAX_TRACKS];
        let alive = &mut observation_of[..tracks.len()];
        assign_nearest(alive, taken, |track, i| {
            let observation = observations[i].as_ref()?;
            let same = observation.marker.is_some() && observation.marker == tracks[track].marker();
            same.then(|| within(track, observation, SAME_MARKER_GATES))?
        });
        let merged = find_merged(tracks, &expected, observations, alive, |track| {
            track.may_merge(self.clock_ns, &self.settings)
        });
        for (assigned, blob) in alive.iter_mut().zip(&merged) {
            if let Some(blob) = blob {
                *assigned = Some(blob.index);
                taken[blob.index] = true;
            }
        }
        assign_nearest(alive, taken, |track, i| {
            let observation = observations[i].as_ref()?;
            let other = observation
                .marker
                .zip(tracks[track].marker())
                .is_some_and(|(read, known)| read != known);
            (!other).then(|| within(track, observation, 1.0))?
        });
        let mut sightings = [Sighting::Missed; MAX_TRACKS];
        for (track, sighting) in sightings.iter_mut().enumerate().take(tracks.len()) {
            *sighting = match (merged[track], observation_of[track]) {
                // With its marker read, the blob's position is this object's own.
                (Some(blob), _) if !(blob.leads && blob.observation.marker.is_some()) => {
                    Sighting::Merged(blob)
                }
                (shared, Some(index)) => {
                    observations[index]
                        .as_ref()
                        .map_or(Sighting::Missed, |observation| Sighting::Own {
                            index,
                            observation,
                            alone: shared.is_none() && stands_alone(index, observations),
                        })
                }
                (_, None) => Sighting::Missed,
            };
        }
        sightings
    }

    /// Furthest from its forecast that an object is looked for, in units. The time before the last frame in which it
    /// was not measured adds the way at top speed; what was in a blob with others may leave it anywhere.
    fn gate(&self, track: &Track, frame_s: f64) -> f64 {
        let settings = &self.settings;
        let unseen_s = (track.unmeasured_s(self.clock_ns) - frame_s).max(0.0);
        let way = settings.top_speed * (GATE_SPEEDS * frame_s + unseen_s);
        settings.gate_base + track.blob_reach() + way
    }

    /// Drops lost tracks, keeps the order of the others.
    fn retire(&mut self) -> usize {
        let mut kept = 0;
        for i in 0..self.n_tracks {
            if !self.tracks[i].lost(&self.settings) {
                if kept < i {
                    self.tracks.swap(kept, i);
                }
                kept += 1;
            }
        }
        let retired = self.n_tracks - kept;
        self.n_tracks = kept;
        retired
    }
}

impl Default for Tracker {
    fn default() -> Self {
        Self::new()
    }
}
