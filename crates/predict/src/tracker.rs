//! The life of tracks: forecast, assignment, substitution, retirement, birth (section 3.1.1 of the paper).

mod assign;
mod blob;
mod frame_context;
mod hypotheses;
mod merge;
pub(crate) mod track;

use crate::bounds::{NO_WALLS, Walls, pushed_out};
use crate::limits::{MAX_OBSERVATIONS, MAX_TRACKS};
use crate::observation::{Observation, Settings};
use crate::time::NS_PER_S;
use crate::tracker::assign::assign;
use crate::tracker::blob::MergedBlob;
use crate::tracker::frame_context::Now;
use crate::tracker::hypotheses::Hypotheses;
use crate::tracker::merge::{find_merged, stands_alone};
use crate::tracker::track::Track;
use crate::vector::{norm, sub};

/// Gate of a track seen in the last frame, in ways at top speed since then. The forecast may be as wrong as twice
/// the top speed where an object turns back; narrower gates lose objects in measurements, wider ones gain nothing.
const GATE_SPEEDS: f64 = 3.0;
/// By how much unlikelier it is that a thing is not seen than that it is seen at the edge of its gate.
const UNSEEN: f64 = 3.0;
/// How much wider the gate is between an observation and the track of the same marker: no other track may claim
/// that, so a robot may have been carried a bit.
const SAME_MARKER_GATES: f64 = 3.0;

/// All objects on the floor, from frame to frame.
///
/// The tracks themselves are kept where the caller says, since one of them takes about 51 kB and there is no heap here: in
/// `S`, which may be a vector, a boxed slice or an array.
///
/// ```
/// use predict::{MAX_TRACKS, Track, Tracker};
///
/// let tracker = Tracker::new(vec![Track::EMPTY; MAX_TRACKS]);
/// assert_eq!(tracker.tracks().count(), 0);
/// ```
#[derive(Debug, Clone)]
pub struct Tracker<S> {
    /// The first `n_tracks` are alive, in the order of their numbers.
    storage: S,
    n_tracks: usize,
    next_id: u64,
    /// The tracker's own time: the sum of all forward steps of the time stamps, none longer than the longest gap.
    clock_ns: u64,
    last_stamp_ns: Option<u64>,
    settings: Settings,
    walls: Walls,
    /// Markers and numbers of robots that are gone, the longest gone first.
    remembered: [(u32, u64); MAX_TRACKS],
    n_remembered: usize,
}

/// What a frame shows of a track's object.
#[derive(Debug, Clone, Copy)]
enum Sighting<'a> {
    Missed,
    Own {
        index: usize,
        observation: &'a Observation,
        /// Of nothing else, and out of the extent of everything else.
        alone: bool,
        /// Its marker was read far from where it was expected: it was carried there.
        carried: bool,
    },
    Merged(MergedBlob<'a>),
}

/// What [`Tracker::update`] did to the frame's observations and the tracks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Update {
    /// Observations ignored because a number in them was not finite, a variance negative or a coordinate beyond 1e9.
    pub rejected: usize,
    /// Observations ignored for want of room: past [`MAX_OBSERVATIONS`], or new with as many tracks alive as there is room for.
    pub overflow: usize,
    /// Tracks begun in this frame.
    pub started: usize,
    /// Tracks dropped in this frame.
    pub retired: usize,
}

impl<S: AsRef<[Track]> + AsMut<[Track]>> Tracker<S> {
    /// A tracker that has seen nothing. `storage` has room for as many tracks as may be alive at once, at most
    /// [`MAX_TRACKS`]; what is in it does not matter.
    #[must_use]
    pub fn new(storage: S) -> Self {
        Self {
            storage,
            n_tracks: 0,
            next_id: 1,
            clock_ns: 0,
            last_stamp_ns: None,
            settings: Settings::default(),
            walls: NO_WALLS,
            remembered: [(0, 0); MAX_TRACKS],
            n_remembered: 0,
        }
    }

    /// The reported tracks, in the order of their numbers.
    pub fn tracks(&self) -> impl Iterator<Item = &Track> {
        self.alive()
            .iter()
            .filter(|track| track.confirmed(&self.settings))
    }

    /// Tells that the floor is another one, or another camera looks at it: forgets how far it reaches and which robots were on it.
    /// Tracks alive go on.
    pub fn forget_floor(&mut self) {
        self.walls = NO_WALLS;
        self.n_remembered = 0;
    }

    fn alive(&self) -> &[Track] {
        &self.storage.as_ref()[..self.n_tracks]
    }

    /// Most tracks alive at once.
    fn room(&self) -> usize {
        self.storage.as_ref().len().min(MAX_TRACKS)
    }

    /// Takes the observations of one frame, exposed at `stamp_ns`.
    ///
    /// Frames may come unevenly. A time stamp that does not lie after the one before counts as the same moment; a
    /// jump ahead of more than two seconds, or of four frames where these are slower, counts as that. Observations and settings may hold anything: what is
    /// no number is ignored and counted, or replaced by the default.
    ///
    /// Cost: about 18 µs for each track that is observed, on one thread.
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

        for observation in checked.iter().flatten() {
            self.walls = pushed_out(&self.walls, [observation.x, observation.y]);
        }
        let now = Now {
            ns: self.clock_ns,
            walls: self.walls,
            settings,
        };
        let sightings = self.sightings(checked, taken, frame_s, now);
        let alive = &mut self.storage.as_mut()[..self.n_tracks];
        for (track, sighting) in alive.iter_mut().zip(sightings) {
            match sighting {
                Sighting::Missed => track.miss(now),
                Sighting::Own {
                    index,
                    observation,
                    alone,
                    carried,
                } => {
                    if carried {
                        track.put_down();
                    }
                    track.sight(index, observation, alone, now);
                }
                Sighting::Merged(blob) => track.merge(&blob, now),
            }
        }
        update.retired = self.retire();
        for (i, observation) in checked.iter().enumerate() {
            if let Some(observation) = observation.as_ref().filter(|_| !taken[i]) {
                if self.n_tracks == self.room() {
                    update.overflow += 1;
                    continue;
                }
                let alone = stands_alone(i, checked);
                let id = self.number_for(observation.marker);
                let tracks = &mut self.storage.as_mut()[..=self.n_tracks];
                tracks[self.n_tracks] = Track::start(id, i, observation, alone, now);
                // A robot that comes back has an old number.
                let place = tracks[..self.n_tracks].partition_point(|track| track.id() < id);
                tracks[place..].rotate_right(1);
                self.n_tracks += 1;
                update.started += 1;
            }
        }
        update
    }

    /// Moves the clock to the frame and returns by how many seconds.
    fn advance(&mut self, stamp_ns: u64) -> f64 {
        let longest_ns = (self.settings.longest_gap_s() * NS_PER_S) as u64;
        let since_last_ns = self
            .last_stamp_ns
            .map_or(0, |last_ns| stamp_ns.saturating_sub(last_ns))
            .min(longest_ns);
        self.last_stamp_ns = Some(stamp_ns);
        self.clock_ns = self.clock_ns.saturating_add(since_last_ns);
        since_last_ns as f64 / NS_PER_S
    }

    /// What each track's object is seen as. Markers first: one that was read belongs to the track of that marker; then
    /// blobs of several objects, so that none of these is looked for elsewhere; then all that is left by how likely it is, but
    /// never an observation of one marker to the track of another.
    ///
    /// Two things may carry the same marker, hence the place decides among them too.
    fn sightings<'a>(
        &self,
        observations: &'a [Option<Observation>],
        taken: &mut [bool],
        frame_s: f64,
        now: Now<'_>,
    ) -> [Sighting<'a>; MAX_TRACKS] {
        let tracks = self.alive();
        let mut hypotheses = [Hypotheses::NONE; MAX_TRACKS];
        let (mut gates, mut reaches) = ([0.0; MAX_TRACKS], [0.0; MAX_TRACKS]);
        for (i, track) in tracks.iter().enumerate() {
            hypotheses[i] = track.hypotheses(now);
            gates[i] = self.gate(track, frame_s);
            reaches[i] = self.reach(track);
        }
        let within = |track: usize, observation: &Observation, gates_wide: f64| {
            let place = [observation.x, observation.y];
            let apart = norm(sub(place, hypotheses[track].forecast()));
            let way = hypotheses[track].way_to(place);
            (apart <= gates_wide * gates[track] && way <= gates_wide * reaches[track])
                .then(|| hypotheses[track].unlikelihood(place))
        };
        let mut observation_of = [None; MAX_TRACKS];
        let alive = &mut observation_of[..tracks.len()];
        let unseen = |track: usize| UNSEEN + hypotheses[track].unlikelihood_at(gates[track]);
        assign(
            alive,
            taken,
            |track, i| {
                let observation = observations[i].as_ref()?;
                let same =
                    observation.marker.is_some() && observation.marker == tracks[track].marker();
                same.then(|| within(track, observation, SAME_MARKER_GATES))?
            },
            unseen,
        );
        // A marker that was read on no track of its own: its robot's was given up, or it was carried elsewhere.
        let mut carried = [false; MAX_TRACKS];
        for (i, observation) in observations.iter().enumerate() {
            let read = observation.as_ref().and_then(|o| o.marker);
            if taken[i] || read.is_none() {
                continue;
            }
            let lost = |track: &usize| alive[*track].is_none() && tracks[*track].known_as() == read;
            if let Some(track) = (0..tracks.len()).find(lost) {
                alive[track] = Some(i);
                taken[i] = true;
                carried[track] = observation
                    .as_ref()
                    .is_some_and(|observation| within(track, observation, 1.0).is_none());
            }
        }
        let merged = find_merged(tracks, &hypotheses, observations, alive, |track| {
            track.may_merge(now.ns, now.settings)
        });
        for (assigned, blob) in alive.iter_mut().zip(&merged) {
            if let Some(blob) = blob {
                *assigned = Some(blob.index);
                taken[blob.index] = true;
            }
        }
        assign(
            alive,
            taken,
            |track, i| {
                let observation = observations[i].as_ref()?;
                let other = observation
                    .marker
                    .zip(tracks[track].marker())
                    .is_some_and(|(read, known)| read != known);
                (!other).then(|| within(track, observation, 1.0))?
            },
            unseen,
        );
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
                            carried: carried[track],
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

    /// Furthest from its last place that an object is looked for, in units. Whatever its forecast says, it cannot have gone farther,
    /// and a false blob out there would send the track away.
    fn reach(&self, track: &Track) -> f64 {
        let unmeasured_s = track.unmeasured_s(self.clock_ns);
        track.blob_reach() + self.settings.farthest(unmeasured_s)
    }

    /// The number of a new track: that which the robot of this marker had, or the next.
    fn number_for(&mut self, marker: Option<u32>) -> u64 {
        let remembered = &mut self.remembered[..self.n_remembered];
        if marker.is_some()
            && let Some(i) = remembered.iter().position(|robot| Some(robot.0) == marker)
        {
            let (_, id) = remembered[i];
            remembered.copy_within(i + 1.., i);
            self.n_remembered -= 1;
            return id;
        }
        self.next_id += 1;
        self.next_id - 1
    }

    /// Drops lost tracks, keeps the order of the others, and remembers which robots had which numbers.
    fn retire(&mut self) -> usize {
        let tracks = self.storage.as_mut();
        let mut kept = 0;
        for i in 0..self.n_tracks {
            let lost = tracks[i].lost(&self.settings);
            if let (true, Some(marker)) = (lost, tracks[i].known_as()) {
                if self.n_remembered == MAX_TRACKS {
                    self.remembered.copy_within(1.., 0);
                    self.n_remembered -= 1;
                }
                self.remembered[self.n_remembered] = (marker, tracks[i].id());
                self.n_remembered += 1;
            }
            if !lost {
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
}
