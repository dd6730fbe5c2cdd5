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

use libm::sqrt;

use crate::limits::MAX_TRACKS;
use crate::observation::Observation;
use crate::tracker::blob::MergedBlob;
use crate::tracker::hypotheses::Hypotheses;
use crate::tracker::track::Track;
use crate::vector::{norm_squared, sub};

/// Part of an object's area by which a blob must exceed the others in it for the object to be there too: closing fills gaps
/// and corners round off, but an absent object leaves nothing.
const LEAST_PART_OF_AREA: f64 = 0.5;

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
