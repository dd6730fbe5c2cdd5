//! What a track knows of itself as seen alone, and of a blob that it shares with others.

use libm::{fabs, sqrt};

use crate::covariance::{Covariance, trace};
use crate::observation::{Observation, Settings};
use crate::time::seconds_between;
use crate::vector::{add, norm, norm_squared, scale, sub};

/// Frames in which a thing must have been seen by itself to be kept in a blob.
const FRAMES_ALONE: u32 = 10;
/// Longest time for which a track is kept in a blob without having been seen by itself.
const LONGEST_MERGE_S: f64 = 30.0;
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
    pub(crate) area: f64,
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
        seconds_between(self.since_ns, now_ns)
    }
}
