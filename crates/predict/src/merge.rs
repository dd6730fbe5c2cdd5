//! Things that touch are one blob and stay as many tracks.
//!
//! Where two objects touch, the camera sees one shape. A tracker that does not know this takes it for one of them,
//! which seems to jump into the middle, and soon drops the other. Here a blob is recognised as merged, and every track
//! in it keeps its number, its marker and its place in the blob until the objects come apart.
//!
//! # When a blob is merged
//!
//! Two or more tracks are expected, or were just now, within its extent, none of them nearer to the middle of another
//! observation, and it is as large as all of them together. Area is what tells a merged blob from a neighbour's: it adds up for things that stand
//! side by side, which is the only way they can stand on a floor seen from above. So an object that is carried away beside
//! another is missed like any other, although it was last seen within the other's extent.
//!
//! # Against ghosts
//!
//! A robot that falls into two blobs for some frames starts a track with its fragment, and area adds up for fragments
//! too. So only a track is kept in a blob that was seen by itself, out of the extent of everything else, in
//! [`FRAMES_ALONE`] frames, and none for longer than [`LONGEST_MERGE_S`].
//!
//! # The place in the blob
//!
//! Most things that touch in a picture pass each other closely. So each is at first where its own forecast leads, as long as it lies
//! as far from the edge of the blob as when it went in, for at most [`LONGEST_PASSING_S`]. Once that fails they must have stopped or
//! turned: then each keeps the offset from the blob's centre at which it went in, and moves with the blob. That two turn round
//! each other does not show; their markers, or failing these their places, decide when they come apart. Where what is measured
//! becomes another point of the blob, because one more joined it or a marker was read in it, the offset is taken anew, so that
//! nothing jumps.
//!
//! The extent is a circle: within a ring, or beside a long wall, it is too large, nothing stands alone there, and a touch is
//! treated like any other loss of sight.

use libm::{fabs, sqrt};

use crate::covariance::{Covariance, trace};
use crate::hypotheses::Hypotheses;
use crate::observation::{Observation, Settings};
use crate::track::Track;
use crate::vector::{add, norm, norm_squared, scale, sub};
use crate::{MAX_TRACKS, NS_PER_S};

/// Frames in which a thing must have been seen by itself to be kept in a blob.
const FRAMES_ALONE: u32 = 10;
/// Longest time for which a track is kept in a blob without having been seen by itself.
const LONGEST_MERGE_S: f64 = 30.0;
/// Part of an object's area by which a blob must exceed the others in it for the object to be there too: closing fills gaps
/// and corners round off, but an absent object leaves nothing.
const LEAST_PART_OF_AREA: f64 = 0.5;
/// By how much an object that passes another may seem nearer to or farther from the edge of their blob, in radii of its own, in
/// [`Settings::gate_base`], and in standard deviations of the blob's position.
const SLACK_RADII: f64 = 0.4;
const SLACK_GATES: f64 = 0.2;
const SLACK_DEVIATIONS: f64 = 2.0;
/// Longest time for which two are thought to pass each other.
const LONGEST_PASSING_S: f64 = 1.0;
/// Time after which it is as uncertain as half of complete ignorance where in its blob an object is.
const HALF_IGNORANCE_S: f64 = 2.0;
/// Weight of a frame in the area of an object. Slow, so that a bad outline does not count; fast enough for the change
/// across a picture that is not calibrated.
const AREA_GAIN: f64 = 0.125;

/// What a frame shows of a track's object.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Sighting<'a> {
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

/// An observation of several objects, one of which a track is of.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MergedBlob<'a> {
    pub(crate) index: usize,
    pub(crate) observation: &'a Observation,
    pub(crate) n_tracks: usize,
    /// Whether this is the track to report it with: that of the marker, or else of the largest object.
    pub(crate) leads: bool,
}

/// What a track knows of itself as seen by itself.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Alone {
    n_frames: u32,
    area: f64,
}

impl Alone {
    pub(crate) const NEVER: Self = Self {
        n_frames: 0,
        area: 0.0,
    };

    pub(crate) fn see(&mut self, observation: &Observation) {
        let gain = if self.n_frames == 0 { 1.0 } else { AREA_GAIN };
        self.n_frames = self.n_frames.saturating_add(1);
        self.area += gain * (observation.area - self.area);
    }

    /// Whether this is an object of its own and no fragment of another.
    pub(crate) fn proven(&self) -> bool {
        self.n_frames >= FRAMES_ALONE
    }
}

/// A track's place in a merged blob.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    /// When the object was last seen by itself.
    since_ns: u64,
    /// What the blob's position is: that of a marker or the centre of area, and of how many objects.
    measured: (Option<u32>, usize),
    /// From the blob's position to the object.
    offset: [f64; 2],
    /// Extent of the blob.
    reach: f64,
    /// Distance from the edge at which it went in.
    from_edge: Option<f64>,
    /// Whether it must have stopped or turned in the blob, since its forecast no longer fits.
    stays: bool,
}

impl Place {
    /// The place in this frame's blob of an object that was in one `before`, or else went in at `expected`, last seen by
    /// itself at `last_alone_ns`.
    pub(crate) fn take(
        before: Option<Self>,
        blob: &MergedBlob,
        expected: [f64; 2],
        last_alone_ns: u64,
    ) -> Self {
        let MergedBlob {
            observation: Observation { x, y, reach, .. },
            n_tracks,
            ..
        } = *blob;
        let measured = (blob.observation.marker, n_tracks);
        let mut offset = match before {
            Some(before) if before.measured == measured => before.offset,
            _ => sub(expected, [*x, *y]),
        };
        let length = sqrt(norm_squared(offset));
        if length > *reach {
            // The blob has become smaller.
            offset = scale(offset, reach / length);
        }
        Self {
            since_ns: before.map_or(last_alone_ns, |before| before.since_ns),
            measured,
            offset,
            reach: *reach,
            from_edge: before.and_then(|before| before.from_edge),
            stays: before.is_some_and(|before| before.stays),
        }
    }

    /// Whether the object can be where its own forecast has it: passing by, as far out in the blob as when it went in,
    /// measured from the edge. Once it cannot, it must have stopped or turned, and the forecast is no longer asked.
    pub(crate) fn passes(
        &mut self,
        blob: &Observation,
        forecast: [f64; 2],
        alone: &Alone,
        now_ns: u64,
        settings: &Settings,
    ) -> bool {
        let from_edge = blob.reach - norm(sub(forecast, [blob.x, blob.y]));
        let entered = *self.from_edge.get_or_insert(from_edge);
        let radius = sqrt(alone.area / core::f64::consts::PI);
        let noise = sqrt(0.5 * trace(&blob.covariance));
        let slack =
            SLACK_RADII * radius + SLACK_GATES * settings.gate_base + SLACK_DEVIATIONS * noise;
        self.stays |=
            fabs(from_edge - entered) > slack || self.merged_s(now_ns) > LONGEST_PASSING_S;
        !self.stays
    }

    pub(crate) fn position(&self, blob: &Observation) -> [f64; 2] {
        add([blob.x, blob.y], self.offset)
    }

    /// Covariance of the position: grows to that of a thing that may be anywhere in the blob, which is a quarter of the radius
    /// squared along each axis.
    pub(crate) fn covariance(&self, blob: &Observation, now_ns: u64) -> Covariance {
        let merged_s = self.merged_s(now_ns);
        let variance = 0.25 * self.reach * self.reach * merged_s / (merged_s + HALF_IGNORANCE_S);
        let mut covariance = blob.covariance;
        covariance[0][0] += variance;
        covariance[1][1] += variance;
        covariance
    }

    /// How far from its expected place the object may be found when it leaves the blob.
    pub(crate) fn reach(&self) -> f64 {
        self.reach
    }

    /// Whether it goes with the blob.
    pub(crate) fn stays(&self) -> bool {
        self.stays
    }

    /// Whether the object has not been seen by itself for too long.
    pub(crate) fn overdue(&self, now_ns: u64) -> bool {
        self.merged_s(now_ns) > LONGEST_MERGE_S
    }

    fn merged_s(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.since_ns) as f64 / NS_PER_S
    }
}

/// The merged blob of each track that is in one. `read` has the observations that are assigned already because their
/// marker was read; an observation with a marker that is not among them has no track yet and is not merged.
///
/// # Panics
///
/// If there are more than [`MAX_TRACKS`] tracks.
pub(crate) fn find_merged<'a>(
    tracks: &[Track],
    hypotheses: &[Hypotheses],
    observations: &'a [Option<Observation>],
    read: &[Option<usize>],
    may_merge: impl Fn(&Track) -> bool,
) -> [Option<MergedBlob<'a>>; MAX_TRACKS] {
    let mut around = [None; MAX_TRACKS];
    for (i, track) in tracks.iter().enumerate() {
        around[i] = match read[i] {
            None if may_merge(track) => {
                // What runs into another may stop at once.
                observation_around([hypotheses[i].forecast(), track.position()], observations)
            }
            read => read,
        };
    }
    let mut merged = [None; MAX_TRACKS];
    for (index, observation) in observations.iter().enumerate() {
        let Some(observation) = observation else {
            continue;
        };
        let mut members = [0; MAX_TRACKS];
        let mut n_members = 0;
        for track in (0..tracks.len()).filter(|track| around[*track] == Some(index)) {
            members[n_members] = track;
            n_members += 1;
        }
        let members = &mut members[..n_members];
        let is_read = |track: usize| read[track] == Some(index);
        if observation.marker.is_some() && !members.iter().any(|track| is_read(*track)) {
            continue;
        }
        let area = |track: usize| tracks[track].alone().area;
        let members = those_with_room(members, observation.area, area, is_read);
        if members.len() >= 2 {
            for (i, track) in members.iter().enumerate() {
                merged[*track] = Some(MergedBlob {
                    index,
                    observation,
                    n_tracks: members.len(),
                    leads: i == 0,
                });
            }
        }
    }
    merged
}

/// Of the tracks that are expected in a blob those for which its area has room: first one whose marker was read, which is
/// there for certain, then the largest.
fn those_with_room(
    tracks: &mut [usize],
    blob_area: f64,
    area: impl Fn(usize) -> f64,
    is_read: impl Fn(usize) -> bool,
) -> &[usize] {
    tracks.sort_unstable_by(|a, b| {
        is_read(*b)
            .cmp(&is_read(*a))
            .then(area(*b).total_cmp(&area(*a)))
            .then(a.cmp(b))
    });
    let mut area_left = blob_area;
    let mut n_kept = 0;
    for i in 0..tracks.len() {
        let track = tracks[i];
        if is_read(track) || area_left > LEAST_PART_OF_AREA * area(track) {
            area_left -= area(track);
            tracks[n_kept] = track;
            n_kept += 1;
        }
    }
    &tracks[..n_kept]
}

/// The observation within whose extent one of the places lies; of several the one whose middle is nearest, in parts of its
/// extent.
fn observation_around(
    places: [[f64; 2]; 2],
    observations: &[Option<Observation>],
) -> Option<usize> {
    let mut nearest: Option<(f64, usize)> = None;
    for (i, observation) in observations.iter().enumerate() {
        let Some(observation) = observation.filter(|observation| observation.reach > 0.0) else {
            continue;
        };
        let [a, b] = places.map(|place| norm_squared(sub(place, [observation.x, observation.y])));
        let part = sqrt(a.min(b)) / observation.reach;
        if part <= 1.0 && nearest.is_none_or(|(least, _)| part < least) {
            nearest = Some((part, i));
        }
    }
    nearest.map(|(_, i)| i)
}

/// Whether an observation has an extent in which no other one's middle lies, nor its own in that of another.
pub(crate) fn stands_alone(index: usize, observations: &[Option<Observation>]) -> bool {
    let Some(Some(observation)) = observations.get(index) else {
        return false;
    };
    let far = |other: &Observation| {
        let apart = sub([other.x, other.y], [observation.x, observation.y]);
        let reach = observation.reach.max(other.reach);
        norm_squared(apart) > reach * reach
    };
    observation.area > 0.0
        && observations
            .iter()
            .enumerate()
            .all(|(i, other)| i == index || other.as_ref().is_none_or(far))
}
