//! Associates the observations of a frame with the tracks.
//!
//! Associations are made in this order:
//!
//! 1. An observation with a marker goes to the track of that marker. Two objects may carry the same
//!    marker, so position decides between them.
//! 2. A marker read far from its track means that the robot was carried there.
//! 3. Blobs that contain several objects go to all of their tracks (`merge`), so that none of these
//!    is looked for elsewhere.
//! 4. The rest is assigned by likelihood, but an observation with a marker never goes to the track
//!    of another marker.

use crate::limits::MAX_TRACKS;
use crate::observation::Observation;
use crate::tracker::assign::assign;
use crate::tracker::blob::MergedBlob;
use crate::tracker::frame_context::FrameContext;
use crate::tracker::hypotheses::Hypotheses;
use crate::tracker::merge::{find_merged, is_isolated};
use crate::tracker::track::Track;
use crate::vector::{norm, sub};

/// Gate of a track that was observed in the previous frame, in distances covered at top speed since
/// then. Where an object turns back, the forecast may be wrong by twice the top speed. Measured:
/// narrower gates lose objects, wider ones gain nothing.
const GATE_SPEEDS: f64 = 3.0;
/// Cost of a missing observation, added to the cost of one at the edge of the gate.
const MISS_COST: f64 = 3.0;
/// Factor of the gate for an observation with the marker of the track. No other track may claim it,
/// so the robot may have been carried a little.
const SAME_MARKER_GATES: f64 = 3.0;

/// What a frame shows of a track's object.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Association<'a> {
    Missed,
    /// An observation of this object.
    Own {
        index: usize,
        observation: &'a Observation,
        /// It contains no other object and is outside the extent of all others.
        isolated: bool,
        /// Its marker was read far from the expected position: it was carried there.
        carried: bool,
    },
    /// An observation of this object together with others.
    Merged(MergedBlob<'a>),
}

/// The association of each track with the observations that are not `taken`. Marks the observations
/// that it uses as taken.
///
/// # Panics
///
/// If there are more than [`MAX_TRACKS`] tracks, or more than
/// [`MAX_OBSERVATIONS`](crate::MAX_OBSERVATIONS) observations.
pub(crate) fn associate<'a>(
    tracks: &[Track],
    observations: &'a [Option<Observation>],
    taken: &mut [bool],
    frame: FrameContext<'_>,
) -> [Association<'a>; MAX_TRACKS] {
    let candidates = Candidates::new(tracks, frame);
    let mut observation_of = [None; MAX_TRACKS];
    let assigned = &mut observation_of[..tracks.len()];
    let miss_cost = |track: usize| candidates.miss_cost(track);
    assign(
        assigned,
        taken,
        |track, i| {
            let observation = observations[i].as_ref()?;
            let same = observation.marker.is_some() && observation.marker == tracks[track].marker();
            same.then(|| candidates.cost(track, observation, SAME_MARKER_GATES))?
        },
        miss_cost,
    );
    let carried = candidates.assign_carried(observations, assigned, taken);
    let merged = find_merged(
        tracks,
        &candidates.hypotheses,
        observations,
        assigned,
        |track| track.may_merge(frame.time_ns, frame.settings),
    );
    for (assigned, blob) in assigned.iter_mut().zip(&merged) {
        if let Some(blob) = blob {
            *assigned = Some(blob.index);
            taken[blob.index] = true;
        }
    }
    assign(
        assigned,
        taken,
        |track, i| {
            let observation = observations[i].as_ref()?;
            let other = observation
                .marker
                .zip(tracks[track].marker())
                .is_some_and(|(read, expected)| read != expected);
            (!other).then(|| candidates.cost(track, observation, 1.0))?
        },
        miss_cost,
    );
    let mut associations = [Association::Missed; MAX_TRACKS];
    for (track, association) in associations.iter_mut().enumerate().take(tracks.len()) {
        *association = match (merged[track], observation_of[track]) {
            // If the marker was read, the blob's position is this object's own.
            (Some(blob), _) if !(blob.is_primary && blob.observation.marker.is_some()) => {
                Association::Merged(blob)
            }
            (shared, Some(index)) => {
                observations[index]
                    .as_ref()
                    .map_or(Association::Missed, |observation| Association::Own {
                        index,
                        observation,
                        isolated: shared.is_none() && is_isolated(index, observations),
                        carried: carried[track],
                    })
            }
            (_, None) => Association::Missed,
        };
    }
    associations
}

/// Where the tracks are looked for in this frame.
struct Candidates<'a> {
    tracks: &'a [Track],
    hypotheses: [Hypotheses; MAX_TRACKS],
    /// Maximum distance from the forecast.
    gates: [f64; MAX_TRACKS],
    /// Maximum distance from the newest position.
    reaches: [f64; MAX_TRACKS],
}

impl<'a> Candidates<'a> {
    fn new(tracks: &'a [Track], frame: FrameContext<'_>) -> Self {
        let mut candidates = Self {
            tracks,
            hypotheses: [Hypotheses::NONE; MAX_TRACKS],
            gates: [0.0; MAX_TRACKS],
            reaches: [0.0; MAX_TRACKS],
        };
        for (i, track) in tracks.iter().enumerate() {
            candidates.hypotheses[i] = track.hypotheses(frame);
            candidates.gates[i] = gate(track, frame);
            candidates.reaches[i] = reach(track, frame);
        }
        candidates
    }

    /// Cost of assigning an observation to a track, or `None` if it is outside `n_gates` gates.
    fn cost(&self, track: usize, observation: &Observation, n_gates: f64) -> Option<f64> {
        let hypotheses = &self.hypotheses[track];
        let position = [observation.x, observation.y];
        let error = norm(sub(position, hypotheses.forecast()));
        let distance = hypotheses.distance_from_last(position);
        (error <= n_gates * self.gates[track] && distance <= n_gates * self.reaches[track])
            .then(|| hypotheses.neg_log_likelihood(position))
    }

    /// Cost of leaving a track without an observation.
    fn miss_cost(&self, track: usize) -> f64 {
        MISS_COST + self.hypotheses[track].neg_log_likelihood_at(self.gates[track])
    }

    /// Assigns markers that have no track of their own but belong to a robot that had one: its
    /// marker was given up, or it was carried elsewhere. Returns which of the tracks were carried.
    fn assign_carried(
        &self,
        observations: &[Option<Observation>],
        assigned: &mut [Option<usize>],
        taken: &mut [bool],
    ) -> [bool; MAX_TRACKS] {
        let mut carried = [false; MAX_TRACKS];
        for (i, observation) in observations.iter().enumerate() {
            let read = observation.as_ref().and_then(|o| o.marker);
            if taken[i] || read.is_none() {
                continue;
            }
            let is_lost = |track: &usize| {
                assigned[*track].is_none() && self.tracks[*track].last_marker() == read
            };
            if let Some(track) = (0..self.tracks.len()).find(is_lost) {
                assigned[track] = Some(i);
                taken[i] = true;
                carried[track] = observation
                    .as_ref()
                    .is_some_and(|observation| self.cost(track, observation, 1.0).is_none());
            }
        }
        carried
    }
}

/// Maximum distance from the forecast at which a track is looked for, in units. Time before the
/// previous frame without a sample adds the distance at top speed. An object that was in a blob
/// with others may leave it anywhere.
fn gate(track: &Track, frame: FrameContext<'_>) -> f64 {
    let settings = frame.settings;
    let unobserved_s = (track.since_sample_s(frame.time_ns) - frame.since_last_s).max(0.0);
    let distance = settings.top_speed * (GATE_SPEEDS * frame.since_last_s + unobserved_s);
    settings.gate_base + track.blob_reach() + distance
}

/// Maximum distance from the newest position at which a track is looked for, in units. Whatever its
/// forecast says, the object cannot have gone farther, and a false detection there would mislead
/// the track.
fn reach(track: &Track, frame: FrameContext<'_>) -> f64 {
    let since_sample_s = track.since_sample_s(frame.time_ns);
    track.blob_reach() + frame.settings.max_distance(since_sample_s)
}
