//! What a track knows of its object when isolated, and of a blob that it shares with others.
//! `merge` describes how merged blobs are treated.

use libm::{fabs, sqrt};

use crate::covariance::{Covariance, trace};
use crate::observation::{Observation, Settings};
use crate::time::seconds_between;
use crate::vector::{add, norm, norm_squared, scale, sub};

/// Number of frames in which an object must have been observed in isolation to be kept in a blob.
const MIN_ISOLATED_FRAMES: u32 = 10;
/// Longest time that a track is kept in a blob without an isolated observation.
const MAX_MERGE_S: f64 = 30.0;
/// Tolerance of the distance from the edge of the blob while an object passes another: in its own
/// radii, in [`Settings::gate_base`], and in standard deviations of the blob's position.
const SLACK_RADII: f64 = 0.4;
const SLACK_GATES: f64 = 0.2;
const SLACK_DEVIATIONS: f64 = 2.0;
/// Longest time that two objects are assumed to pass each other.
const MAX_PASSING_S: f64 = 1.0;
/// Time after which the variance of a position in the blob is half of its maximum.
const HALF_UNCERTAINTY_S: f64 = 2.0;
/// Weight of a frame in the mean area. Low enough that a bad contour does not count, high enough to
/// follow changes across an uncalibrated picture.
const AREA_GAIN: f64 = 0.125;

/// An observation of several objects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MergedBlob<'a> {
    pub(crate) index: usize,
    pub(crate) observation: &'a Observation,
    pub(crate) n_tracks: usize,
    /// Whether this track reports the observation: the one whose marker was read, otherwise that of
    /// the largest object.
    pub(crate) is_primary: bool,
}

/// The object as observed in isolation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IsolatedView {
    n_frames: u32,
    pub(crate) area: f64,
}

impl IsolatedView {
    pub(crate) const NONE: Self = Self {
        n_frames: 0,
        area: 0.0,
    };

    pub(crate) fn update(&mut self, observation: &Observation) {
        let gain = if self.n_frames == 0 { 1.0 } else { AREA_GAIN };
        self.n_frames = self.n_frames.saturating_add(1);
        self.area += gain * (observation.area - self.area);
    }

    /// Whether this is an object of its own, not a fragment of another.
    pub(crate) fn is_established(&self) -> bool {
        self.n_frames >= MIN_ISOLATED_FRAMES
    }
}

/// A track's membership of a merged blob.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BlobMember {
    /// Time of the last isolated observation.
    since_ns: u64,
    /// What the position of the blob refers to: a marker or the centroid, and of how many objects.
    measured: (Option<u32>, usize),
    /// From the position of the blob to the object.
    offset: [f64; 2],
    /// Extent of the blob.
    reach: f64,
    /// Distance from the edge of the blob when the object entered it.
    edge_distance: Option<f64>,
    /// Whether the object must have stopped or turned in the blob, because its forecast no longer
    /// fits.
    stopped: bool,
}

impl BlobMember {
    /// The membership in this frame's blob of an object that was in a blob `before`, or enters one
    /// at `expected` and was last isolated at `last_isolated_ns`.
    pub(crate) fn enter(
        before: Option<Self>,
        blob: &MergedBlob,
        expected: [f64; 2],
        last_isolated_ns: u64,
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
            // The blob has shrunk.
            offset = scale(offset, reach / length);
        }
        Self {
            since_ns: before.map_or(last_isolated_ns, |before| before.since_ns),
            measured,
            offset,
            reach: *reach,
            edge_distance: before.and_then(|before| before.edge_distance),
            stopped: before.is_some_and(|before| before.stopped),
        }
    }

    /// Whether the object may be where its own forecast says: passing by, at the distance from the
    /// edge at which it entered. Once that fails, the object must have stopped or turned, and the
    /// forecast is ignored.
    pub(crate) fn still_passing(
        &mut self,
        blob: &Observation,
        forecast: [f64; 2],
        isolated: &IsolatedView,
        now_ns: u64,
        settings: &Settings,
    ) -> bool {
        let edge_distance = blob.reach - norm(sub(forecast, [blob.x, blob.y]));
        let entered = *self.edge_distance.get_or_insert(edge_distance);
        let radius = sqrt(isolated.area / core::f64::consts::PI);
        let noise = sqrt(0.5 * trace(&blob.covariance));
        let slack =
            SLACK_RADII * radius + SLACK_GATES * settings.gate_base + SLACK_DEVIATIONS * noise;
        self.stopped |=
            fabs(edge_distance - entered) > slack || self.merged_s(now_ns) > MAX_PASSING_S;
        !self.stopped
    }

    pub(crate) fn position(&self, blob: &Observation) -> [f64; 2] {
        add([blob.x, blob.y], self.offset)
    }

    /// Covariance of the position. It grows to that of an object anywhere in the blob, which is a
    /// quarter of the squared radius per axis.
    pub(crate) fn covariance(&self, blob: &Observation, now_ns: u64) -> Covariance {
        let merged_s = self.merged_s(now_ns);
        let variance = 0.25 * self.reach * self.reach * merged_s / (merged_s + HALF_UNCERTAINTY_S);
        let mut covariance = blob.covariance;
        covariance[0][0] += variance;
        covariance[1][1] += variance;
        covariance
    }

    /// Maximum distance from its expected position at which the object may leave the blob.
    pub(crate) fn reach(&self) -> f64 {
        self.reach
    }

    /// Whether the object moves with the blob.
    pub(crate) fn stopped(&self) -> bool {
        self.stopped
    }

    /// Whether the last isolated observation is too long ago.
    pub(crate) fn is_expired(&self, now_ns: u64) -> bool {
        self.merged_s(now_ns) > MAX_MERGE_S
    }

    fn merged_s(&self, now_ns: u64) -> f64 {
        seconds_between(self.since_ns, now_ns)
    }
}
