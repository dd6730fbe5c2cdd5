//! The state of one object: its current pose, its samples and its forecast.
//!
//! # A marked robot whose marker was not read
//!
//! The position of a marked track is the centre of the plate. When the robot is detected without
//! its marker, only the centroid of the whole robot is known. It lies elsewhere on the body, at an
//! unknown offset that turns with the robot. Used as the position, it would make the track jump
//! with every misread. Such an observation therefore keeps the track alive and corrects it only as
//! far as it is informative: by a Kalman update of the forecast with the observation's covariance
//! plus [`Settings::marker_offset`]². Just after a reading the forecast is much better and hardly
//! changes. The longer the marker is not read, the more the track follows the observations. The
//! heading is forecast, [`Track::pose_observed`] is false, and nothing is learned.
//!
//! When the marker has not been read for more than [`Settings::max_misses`] consecutive frames, the
//! track gives it up and continues under its id as an object without a marker: better an obstacle
//! than a robot that may not be one. The reference point then changes from the plate to the
//! centroid. It changes back when a marker is read on a track without one. In both cases all
//! samples are moved by the jump, which keeps the velocity.
//!
//! # An object in a blob with others
//!
//! While objects touch (`merge`), one that may be passing the others coasts on its forecast. Once
//! it has stopped with them, its samples are the position of the blob plus its offset in it, which
//! show how it is pushed or carried along. When it separates, the difference between its assumed
//! and its measured position says nothing about its motion. It is treated like a change of the
//! reference point.

use crate::bounds::expanded;
use crate::covariance::{Covariance, kalman_update};
use crate::forecast::Forecaster;
use crate::forecast::curve::{Forecast, ForecastPoint};
use crate::heading::HeadingTrack;
use crate::history::{History, Sample};
use crate::limits::{FORECAST_SPACING_S, MAX_FORECAST};
use crate::observation::{Heading, Observation, Settings};
use crate::time::{NS_PER_S, seconds_between};
use crate::tracker::blob::{BlobMember, IsolatedView, MergedBlob};
use crate::tracker::frame_context::FrameContext;
use crate::tracker::hypotheses::Hypotheses;
use crate::vector::{add, scale, sub};

/// Minimum spacing of samples in the history, in frame periods.
const MIN_SPACING_FRAMES: f64 = 0.05;
/// Longest pause between readings of a marker over which its turns are counted, in seconds or in
/// frames, whichever is longer.
const MAX_HEADING_GAP_S: f64 = 1.0;
const MAX_HEADING_GAP_FRAMES: f64 = 2.0;

/// A tracked object.
#[derive(Debug, Clone)]
pub struct Track {
    id: u64,
    marker: Option<u32>,
    /// The last marker that was read, even after it was given up.
    last_marker: Option<u32>,
    observed: Option<usize>,
    pose_observed: bool,
    position: [f64; 2],
    covariance: Covariance,
    velocity: [f64; 2],
    heading: Option<Heading>,
    started_ns: u64,
    age_ns: u64,
    n_observed: u32,
    misses: u32,
    /// Consecutive frames in which the marker of a marked track was not read.
    unread_frames: u32,
    /// Correction of the forecast by observations without a marker since the marker was last read.
    shift: [f64; 2],
    /// The object as observed in isolation.
    isolated: IsolatedView,
    /// Its membership of a blob shared with others, until it is observed by itself again.
    blob: Option<BlobMember>,
    points: [ForecastPoint; MAX_FORECAST],
    forecast: Forecast,
    /// Seconds from the newest sample to the frame.
    coasted_s: f64,
    history: History,
    headings: HeadingTrack,
    forecaster: Forecaster,
}

impl Track {
    /// Id of the track, from 1. A tracker never uses an id for two objects.
    #[must_use]
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Index of the object's marker.
    #[must_use]
    pub fn marker(&self) -> Option<u32> {
        self.marker
    }

    /// Index of this frame's observation of the object in the slice given to
    /// [`Tracker::update`](crate::Tracker::update). `None` if the object was not observed and
    /// everything here is forecast. An observation of several touching objects is reported by one
    /// of their tracks, the same from frame to frame.
    #[must_use]
    pub fn observed(&self) -> Option<usize> {
        self.observed
    }

    /// Whether position and heading were measured in this frame. False if the object was not
    /// observed, if it has a marker that was not read, or if it was observed as one blob with
    /// others.
    #[must_use]
    pub fn pose_observed(&self) -> bool {
        self.pose_observed
    }

    /// (x, y) in units: the unfiltered measurement if [`pose_observed`](Self::pose_observed),
    /// otherwise the estimate.
    #[must_use]
    pub fn position(&self) -> [f64; 2] {
        self.position
    }

    /// Covariance of [`position`](Self::position) in squared units.
    #[must_use]
    pub fn covariance(&self) -> [[f64; 2]; 2] {
        self.covariance
    }

    /// Velocity along x and y in units per second. Zero until the second observation.
    #[must_use]
    pub fn velocity(&self) -> [f64; 2] {
        self.velocity
    }

    /// Measured or forecast heading, if one was ever measured.
    #[must_use]
    pub fn heading(&self) -> Option<Heading> {
        self.heading
    }

    /// Turn rate in rad/s: of the marker from its second reading on, otherwise of the forecast
    /// direction of motion.
    #[must_use]
    pub fn turn_rate_rad_s(&self) -> f64 {
        self.headings
            .rate_rad_s()
            .unwrap_or(self.forecast.turn_rate_rad_s)
    }

    /// Seconds since the first observation.
    #[must_use]
    pub fn age_s(&self) -> f64 {
        self.age_ns as f64 / NS_PER_S
    }

    /// Number of consecutive frames without an observation, including this one. An object in a blob
    /// with others counts as observed.
    #[must_use]
    pub fn misses(&self) -> u32 {
        self.misses
    }

    /// Future positions at intervals of [`FORECAST_SPACING_S`], counted from the time stamp of this
    /// frame even if the object was not observed.
    #[must_use]
    pub fn forecast(&self) -> &[ForecastPoint] {
        &self.points
    }

    /// Expected position `dt_s` seconds after the time stamp of this frame, for any time up to
    /// [`FORECAST_RANGE_S`](crate::FORECAST_RANGE_S) and a little beyond. The points of
    /// [`forecast`](Self::forecast) lie on this curve. Times outside the range are clamped to it.
    #[must_use]
    pub fn forecast_at(&self, dt_s: f64) -> ForecastPoint {
        let dt_s = dt_s.max(0.0).min(self.forecast.max_ahead_s);
        let (position, covariance) = self.forecast.at(self.coasted_s + dt_s);
        let [x, y] = add(position, self.shift);
        ForecastPoint {
            dt_s,
            x,
            y,
            covariance,
        }
    }

    /// An unused slot.
    pub const EMPTY: Self = Self {
        id: 0,
        marker: None,
        last_marker: None,
        observed: None,
        pose_observed: false,
        position: [0.0; 2],
        covariance: [[0.0; 2]; 2],
        velocity: [0.0; 2],
        heading: None,
        started_ns: 0,
        age_ns: 0,
        n_observed: 0,
        misses: 0,
        unread_frames: 0,
        shift: [0.0; 2],
        isolated: IsolatedView::NONE,
        blob: None,
        points: [ForecastPoint {
            dt_s: 0.0,
            x: 0.0,
            y: 0.0,
            covariance: [[0.0; 2]; 2],
        }; MAX_FORECAST],
        forecast: Forecast::EMPTY,
        coasted_s: 0.0,
        history: History::EMPTY,
        headings: HeadingTrack::EMPTY,
        forecaster: Forecaster::START,
    };

    /// A track of an object observed for the first time.
    pub(crate) fn start(
        id: u64,
        index: usize,
        observation: &Observation,
        isolated: bool,
        frame: FrameContext<'_>,
    ) -> Self {
        let mut track = Self {
            id,
            started_ns: frame.time_ns,
            ..Self::EMPTY
        };
        track.observe(index, observation, isolated, frame);
        track
    }

    /// Expected position at a time, and its covariance.
    fn expected(&self, now_ns: u64) -> ([f64; 2], Covariance) {
        let (position, covariance) = self.forecast.at(self.since_sample_s(now_ns));
        (add(position, self.shift), covariance)
    }

    /// Positions where the object may be in this frame.
    pub(crate) fn hypotheses(&self, frame: FrameContext<'_>) -> Hypotheses {
        let samples = self.history.samples();
        let newest = samples.last().unwrap_or(&Sample::EMPTY);
        let position = add(newest.position, self.shift);
        let (_, noise) = self.forecast.at(0.0);
        Hypotheses::new(
            self.expected(frame.time_ns),
            position,
            &noise,
            samples,
            frame,
        )
    }

    /// Whether there were enough observations to report the track.
    pub(crate) fn is_confirmed(&self, settings: &Settings) -> bool {
        self.n_observed >= settings.confirm
    }

    /// Whether the track should be dropped.
    pub(crate) fn is_lost(&self, settings: &Settings) -> bool {
        self.misses > settings.max_misses || (self.misses > 0 && !self.is_confirmed(settings))
    }

    /// Lets the track be dropped, because another one continues it.
    pub(crate) fn end(&mut self) {
        self.misses = u32::MAX;
        self.last_marker = None;
    }

    /// Gives it the id of the track that it continues.
    pub(crate) fn rename(&mut self, id: u64) {
        self.id = id;
    }

    /// The object as observed in isolation.
    pub(crate) fn isolated(&self) -> &IsolatedView {
        &self.isolated
    }

    /// Whether the track may be kept in a blob with others.
    pub(crate) fn may_merge(&self, now_ns: u64, settings: &Settings) -> bool {
        self.is_confirmed(settings)
            && self.isolated.is_established()
            && !self.blob.is_some_and(|member| member.is_expired(now_ns))
    }

    /// Extent of the blob that the object was in when last observed. 0 if it was by itself.
    pub(crate) fn blob_reach(&self) -> f64 {
        self.blob.map_or(0.0, |member| member.reach())
    }

    /// The last marker that was read.
    pub(crate) fn last_marker(&self) -> Option<u32> {
        self.last_marker
    }

    /// Forgets the recent motion, because the robot was carried elsewhere. What was learned about
    /// its way of moving is kept.
    pub(crate) fn forget_motion(&mut self) {
        self.history = History::EMPTY;
        self.headings = HeadingTrack::EMPTY;
        self.forecaster.discard_pending();
        self.blob = None;
    }

    /// Processes this frame's observation of the object. `isolated`: no other object is in it or
    /// near.
    pub(crate) fn observe(
        &mut self,
        index: usize,
        observation: &Observation,
        isolated: bool,
        frame: FrameContext<'_>,
    ) {
        if isolated {
            self.isolated.update(observation);
        }
        let separated = self.blob.is_some_and(|member| member.stopped());
        self.n_observed = self.n_observed.saturating_add(1);
        self.misses = 0;
        self.observed = Some(index);
        match (self.marker, observation.marker) {
            (Some(_), None) if self.unread_frames < frame.settings.max_misses => {
                self.unread_frames += 1;
                self.correct(observation, frame);
            }
            (Some(_), None) => {
                self.headings = HeadingTrack::EMPTY;
                self.move_reference_point(observation, frame.time_ns);
                self.take_pose(observation, frame);
            }
            (known, read) if separated || (known.is_none() && read.is_some()) => {
                self.move_reference_point(observation, frame.time_ns);
                self.take_pose(observation, frame);
            }
            _ => self.take_pose(observation, frame),
        }
        self.update_points(frame.time_ns);
    }

    /// Processes an observation of the object together with others that it touches.
    pub(crate) fn observe_merged(&mut self, blob: &MergedBlob, frame: FrameContext<'_>) {
        self.misses = 0;
        self.observed = blob.is_primary.then_some(blob.index);
        self.pose_observed = false;
        let (expected, _) = self.expected(frame.time_ns);
        let last_isolated_ns = self
            .history
            .newest()
            .map_or(frame.time_ns, |newest| newest.time_ns);
        let mut member = BlobMember::enter(self.blob, blob, expected, last_isolated_ns);
        if member.still_passing(
            blob.observation,
            expected,
            &self.isolated,
            frame.time_ns,
            frame.settings,
        ) {
            self.blob = Some(member);
            self.coast(frame);
            self.update_points(frame.time_ns);
            return;
        }
        self.blob = Some(member);
        if self.shift != [0.0; 2] {
            self.history.translate(self.shift);
            self.forecaster.discard_pending();
            self.shift = [0.0; 2];
        }
        self.heading = self.headings.at(frame.time_ns);
        self.take_sample(
            member.position(blob.observation),
            member.covariance(blob.observation, frame.time_ns),
            frame,
        );
        self.update_points(frame.time_ns);
    }

    /// Processes a frame without an observation of the object.
    pub(crate) fn miss(&mut self, frame: FrameContext<'_>) {
        self.misses = self.misses.saturating_add(1);
        self.unread_frames = self.unread_frames.saturating_add(1);
        self.observed = None;
        self.coast(frame);
        self.update_points(frame.time_ns);
    }

    /// Takes the pose from the observation, learns from it and forecasts from it.
    fn take_pose(&mut self, observation: &Observation, frame: FrameContext<'_>) {
        let period_s = frame.settings.frame_period_s;
        self.marker = observation.marker;
        self.last_marker = observation.marker.or(self.last_marker);
        self.unread_frames = 0;
        self.shift = [0.0; 2];
        self.blob = None;
        self.pose_observed = true;
        if let Some(heading) = observation.heading {
            let max_gap_s = MAX_HEADING_GAP_S.max(MAX_HEADING_GAP_FRAMES * period_s);
            self.headings
                .observe(frame.time_ns, heading, period_s, max_gap_s);
        }
        self.heading = self.headings.at(frame.time_ns);
        self.take_sample(
            [observation.x, observation.y],
            observation.covariance,
            frame,
        );
    }

    /// Adds a position as the newest sample, learns from it and forecasts from it.
    fn take_sample(&mut self, position: [f64; 2], covariance: Covariance, frame: FrameContext<'_>) {
        let period_s = frame.settings.frame_period_s;
        self.position = position;
        self.covariance = covariance;
        let sample = Sample {
            time_ns: frame.time_ns,
            position,
        };
        let min_spacing_ns = (MIN_SPACING_FRAMES * period_s * NS_PER_S) as u64;
        if self.history.push(sample, min_spacing_ns) {
            self.forecaster.learn(&self.history, frame.settings);
        }
        let steering = self.headings.steering(self.history.samples());
        self.forecast = self.forecaster.forecast(
            &self.history,
            steering.as_ref(),
            // A position in a blob may be out of bounds.
            &expanded(&frame.bounds, position),
            &self.covariance,
            frame.settings,
        );
        self.velocity = self.forecast.velocity;
    }

    /// Corrects the forecast by an observation of another reference point of the marked object.
    fn correct(&mut self, observation: &Observation, frame: FrameContext<'_>) {
        self.coast(frame);
        let mut noise = observation.covariance;
        let offset_variance = frame.settings.marker_offset * frame.settings.marker_offset;
        noise[0][0] += offset_variance;
        noise[1][1] += offset_variance;
        let innovation = sub([observation.x, observation.y], self.position);
        if let Some((correction, covariance)) = kalman_update(&self.covariance, &noise, innovation)
        {
            self.shift = add(self.shift, correction);
            self.position = add(self.position, correction);
            self.covariance = covariance;
        }
    }

    /// Takes the pose from the forecast.
    fn coast(&mut self, frame: FrameContext<'_>) {
        self.pose_observed = false;
        (self.position, self.covariance) = self.expected(frame.time_ns);
        self.heading = self.headings.at(frame.time_ns);
        let period_s = frame.settings.frame_period_s;
        let (next, _) = self
            .forecast
            .at(self.since_sample_s(frame.time_ns) + period_s);
        let travel = sub(add(next, self.shift), self.position);
        self.velocity = scale(travel, 1.0 / period_s);
    }

    /// Changes the reference point: from this observation on, the position is that of another point
    /// of the object.
    fn move_reference_point(&mut self, observation: &Observation, now_ns: u64) {
        // Without the shift, which is not in the samples either.
        let (expected, _) = self.forecast.at(self.since_sample_s(now_ns));
        if self.history.samples().len() < 2 {
            self.history = History::EMPTY;
        } else {
            self.history
                .translate(sub([observation.x, observation.y], expected));
        }
        self.forecaster.discard_pending();
    }

    fn update_points(&mut self, now_ns: u64) {
        self.age_ns = now_ns - self.started_ns;
        self.coasted_s = self.since_sample_s(now_ns);
        for i in 0..MAX_FORECAST {
            self.points[i] = self.forecast_at((i as f64 + 1.0) * FORECAST_SPACING_S);
        }
    }

    /// Seconds since the newest sample.
    pub(crate) fn since_sample_s(&self, now_ns: u64) -> f64 {
        self.history
            .newest()
            .map_or(0.0, |newest| seconds_between(newest.time_ns, now_ns))
    }
}
