//! Detects blobs that contain several touching objects, and keeps a track for each of them.
//!
//! Where two objects touch, the camera sees one shape. A tracker that does not know this takes it
//! for one of them, which seems to jump to the middle, and soon drops the other. Here every track
//! in a merged blob keeps its id, its marker and its position in the blob until the objects
//! separate.
//!
//! # When a blob is merged
//!
//! Two or more tracks are expected within its extent, or were just there. None of them is nearer to
//! the centre of another observation. The area of the blob is that of all of them together. Area
//! tells a merged blob from a neighbour's: the areas of objects that stand side by side add up, and
//! seen from above, objects on a floor can only stand side by side. An object that is carried away
//! from beside another is therefore missed like any other, although it was last observed within the
//! extent of its neighbour.
//!
//! # Against ghosts
//!
//! A robot that is split into two blobs for some frames starts a track with the fragment, and the
//! areas of fragments add up, too. Therefore a track is kept in a blob only if its object was
//! isolated, outside the extent of everything else, in several frames, and not longer than a limit
//! (`blob`).
//!
//! # The position in the blob
//!
//! Most objects whose images touch pass each other closely. At first, each object is assumed to
//! follow its own forecast, for a short time and as long as it stays as far from the edge of the
//! blob as when it entered. Once that fails, it must have stopped or turned. From then on it keeps
//! its offset from the centre of the blob and moves with the blob. A rotation of two objects about
//! each other is not visible. Markers, or otherwise positions, decide when they separate. Where the
//! reference point of the blob changes, because another object joins or a marker is read in it, the
//! offset is recomputed, so that nothing jumps.
//!
//! The extent is a circle. Within a ring, or beside a long wall, it is too large: no object is
//! isolated there, and a touch is treated like any other occlusion.

use libm::sqrt;

use crate::limits::MAX_TRACKS;
use crate::observation::Observation;
use crate::tracker::blob::MergedBlob;
use crate::tracker::hypotheses::Hypotheses;
use crate::tracker::track::Track;
use crate::vector::{norm_squared, sub};

/// Minimum excess of a blob's area over the other objects in it, as a fraction of an object's area,
/// for that object to be in it. Closing fills gaps and corners are rounded, but an absent object
/// adds no area.
const MIN_AREA_RATIO: f64 = 0.5;

/// The merged blob of each track that is in one. `read` holds the observations already assigned by
/// their markers. An observation with a marker that is not among them has no track yet and is not
/// merged.
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
    let mut containing = [None; MAX_TRACKS];
    for (i, track) in tracks.iter().enumerate() {
        containing[i] = match read[i] {
            None if may_merge(track) => {
                // An object that hits another may stop at once.
                containing_observation([hypotheses[i].forecast(), track.position()], observations)
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
        for track in (0..tracks.len()).filter(|track| containing[*track] == Some(index)) {
            members[n_members] = track;
            n_members += 1;
        }
        let members = &mut members[..n_members];
        let is_read = |track: usize| read[track] == Some(index);
        if observation.marker.is_some() && !members.iter().any(|track| is_read(*track)) {
            continue;
        }
        let area = |track: usize| tracks[track].isolated().area;
        let members = members_that_fit(members, observation.area, area, is_read);
        if members.len() >= 2 {
            for (i, track) in members.iter().enumerate() {
                merged[*track] = Some(MergedBlob {
                    index,
                    observation,
                    n_tracks: members.len(),
                    is_primary: i == 0,
                });
            }
        }
    }
    merged
}

/// Of the tracks expected in a blob, those that fit into its area: first one whose marker was read,
/// which is certainly there, then by size.
fn members_that_fit(
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
        if is_read(track) || area_left > MIN_AREA_RATIO * area(track) {
            area_left -= area(track);
            tracks[n_kept] = track;
            n_kept += 1;
        }
    }
    &tracks[..n_kept]
}

/// The observation whose extent contains one of the positions. If there are several, the one whose
/// centre is nearest relative to its extent.
fn containing_observation(
    positions: [[f64; 2]; 2],
    observations: &[Option<Observation>],
) -> Option<usize> {
    let mut nearest: Option<(f64, usize)> = None;
    for (i, observation) in observations.iter().enumerate() {
        let Some(observation) = observation.filter(|observation| observation.reach > 0.0) else {
            continue;
        };
        let [a, b] =
            positions.map(|position| norm_squared(sub(position, [observation.x, observation.y])));
        let ratio = sqrt(a.min(b)) / observation.reach;
        if ratio <= 1.0 && nearest.is_none_or(|(min, _)| ratio < min) {
            nearest = Some((ratio, i));
        }
    }
    nearest.map(|(_, i)| i)
}

/// Whether an observation has an extent, no other observation's centre lies within it, and its own
/// centre lies in no other extent.
pub(crate) fn is_isolated(index: usize, observations: &[Option<Observation>]) -> bool {
    let Some(Some(observation)) = observations.get(index) else {
        return false;
    };
    let far = |other: &Observation| {
        let offset = sub([other.x, other.y], [observation.x, observation.y]);
        let reach = observation.reach.max(other.reach);
        norm_squared(offset) > reach * reach
    };
    observation.area > 0.0
        && observations
            .iter()
            .enumerate()
            .all(|(i, other)| i == index || other.as_ref().is_none_or(far))
}
