//! What is known of one object: its state in the newest frame, its samples and its forecast.
//!
//! # A marked robot whose marker could not be read
//!
//! A marked track is where the centre of the plate is. When its robot is seen without its marker being read, all
//! there is is the centre of area of the whole robot, which lies elsewhere on the body by an unknown amount that
//! turns with it. Taking it as the robot's place would make the track jump to and fro with every misread. So such a
//! sighting keeps the track alive and moves it only as far as it is informative: it is weighed against the forecast
//! with the observation's covariance plus [`Settings::marker_offset`]² (the update of a Kalman filter). Just after
//! a reading the forecast is far better and stays; the longer the marker is not read, the more the track follows
//! the sighting. The heading is forecast, [`Track::pose_observed`] is false, and nothing is learned from such a
//! sighting.
//!
//! When the marker has not been read for more than [`Settings::max_misses`] frames on end, the track gives it up
//! and goes on under its number as a thing without marker: better an obstacle than a robot that may not be one.
//! Where the measured point changes so from the plate to the outline, or the other way round because a marker is
//! read on a track that had none, the samples are moved by the jump, which keeps the velocity.
//!
//! # An object in a blob with others
//!
//! While objects touch (`merge`), one that may be passing the others coasts on its forecast. Once it has stopped with them,
//! the blob's position and its place in it make the samples: they show how it is pushed or carried along. When it then comes
//! apart from the others, the difference between where it was thought to be and where it is says nothing of its motion: a jump like
//! that of another measured point.

use crate::bounds::pushed_out;
use crate::covariance::{Covariance, kalman_update};
use crate::forecast::Forecaster;
use crate::forecast::curve::{Forecast, ForecastPoint};
use crate::heading::HeadingTrack;
use crate::history::{History, Sample};
use crate::limits::{FORECAST_SPACING_S, MAX_FORECAST};
use crate::observation::{Heading, Observation, Settings};
use crate::time::{NS_PER_S, seconds_between};
use crate::tracker::blob::{Alone, MergedBlob, Place};
use crate::tracker::frame_context::Now;
use crate::tracker::hypotheses::Hypotheses;
use crate::vector::{add, scale, sub};

/// Frames closer together than this part of the frame period are not kept apart in the history.
const LEAST_SPACING_FRAMES: f64 = 0.05;
/// Longest pause in the readings of a marker, in seconds and in frames where these are slow, over which its turns are
/// counted.
const LONGEST_HEADING_GAP_S: f64 = 1.0;
const LEAST_HEADING_GAP_FRAMES: f64 = 2.0;

/// An object with an identity.
#[derive(Debug, Clone)]
pub struct Track {
    id: u64,
    marker: Option<u32>,
    /// The last marker that was read on it, also after it was given up.
    known_as: Option<u32>,
    observed: Option<usize>,
    pose_observed: bool,
    position: [f64; 2],
    covariance: Covariance,
    velocity: [f64; 2],
    heading: Option<Heading>,
    age_frames: u64,
    started_ns: u64,
    age_ns: u64,
    sightings: u32,
    misses: u32,
    /// Frames on end in which a marked track's marker was not read.
    unread: u32,
    /// What sightings without marker have moved the forecast by since the marker was read.
    shift: [f64; 2],
    /// How it looks when nothing touches it.
    alone: Alone,
    /// Its place in the blob that it shares with others, until it is seen by itself again.
    place: Option<Place>,
    points: [ForecastPoint; MAX_FORECAST],
    ahead: Forecast,
    /// Seconds from the newest sample to the frame.
    coasted_s: f64,
    history: History,
    headings: HeadingTrack,
    forecaster: Forecaster,
}

impl Track {
    /// Number of the track, from 1, never given twice by a tracker.
    #[must_use]
    pub fn id(&self) -> u64 {
        self.id
    }

    /// Index of the object's marker.
    #[must_use]
    pub fn marker(&self) -> Option<u32> {
        self.marker
    }

    /// Index, in the slice given to [`Tracker::update`](crate::Tracker::update), of this frame's observation of the
    /// object; `None` when it was not seen and everything here is forecast. The observation of several objects that touch
    /// is one of all of them and given to one, the same from frame to frame.
    #[must_use]
    pub fn observed(&self) -> Option<usize> {
        self.observed
    }

    /// Whether position and heading are this frame's measurements. False when the object was not seen, when a
    /// marked one was seen without its marker being read, and when it was seen as one with others that it touches.
    #[must_use]
    pub fn pose_observed(&self) -> bool {
        self.pose_observed
    }

    /// (x, y) in units: the measurement itself, without a filter's lag, if [`pose_observed`](Self::pose_observed),
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

    /// Velocity along x and y in units a second; zero until the second sighting.
    #[must_use]
    pub fn velocity(&self) -> [f64; 2] {
        self.velocity
    }

    /// Heading, measured or forecast, if one was ever measured.
    #[must_use]
    pub fn heading(&self) -> Option<Heading> {
        self.heading
    }

    /// Turn rate in rad/s: of the marker from its second reading on, otherwise of the direction of motion as the experts of the
    /// forecast see it.
    #[must_use]
    pub fn turn_rate_rad_s(&self) -> f64 {
        self.headings
            .rate_rad_s()
            .unwrap_or(self.ahead.turn_rate_rad_s)
    }

    /// Seconds since the first sighting.
    #[must_use]
    pub fn age_s(&self) -> f64 {
        self.age_ns as f64 / NS_PER_S
    }

    /// Frames since the first sighting, that one included.
    #[must_use]
    pub fn age_frames(&self) -> u64 {
        self.age_frames
    }

    /// Frames on end without a sighting, this one included. In a blob with others counts as sighted.
    #[must_use]
    pub fn misses(&self) -> u32 {
        self.misses
    }

    /// Where the object will be, one point each forecast step, counted from this frame's time stamp also when it
    /// was not seen.
    #[must_use]
    pub fn forecast(&self) -> &[ForecastPoint] {
        &self.points
    }

    /// Where the object will be `dt_s` seconds after this frame's time stamp, at any moment up to
    /// [`FARTHEST_S`](crate::FARTHEST_S) and a little beyond: the curve that the points of
    /// [`forecast`](Self::forecast) lie on. A moment before the frame counts as the frame's, one that is too far ahead as the
    /// farthest.
    #[must_use]
    pub fn forecast_at(&self, dt_s: f64) -> ForecastPoint {
        let dt_s = dt_s.max(0.0).min(self.ahead.longest_s());
        let (place, covariance) = self.ahead.at(self.coasted_s + dt_s);
        let [x, y] = add(place, self.shift);
        ForecastPoint {
            dt_s,
            x,
            y,
            covariance,
        }
    }

    /// No track: a place for one.
    pub const EMPTY: Self = Self {
        id: 0,
        marker: None,
        known_as: None,
        observed: None,
        pose_observed: false,
        position: [0.0; 2],
        covariance: [[0.0; 2]; 2],
        velocity: [0.0; 2],
        heading: None,
        age_frames: 0,
        started_ns: 0,
        age_ns: 0,
        sightings: 0,
        misses: 0,
        unread: 0,
        shift: [0.0; 2],
        alone: Alone::NEVER,
        place: None,
        points: [ForecastPoint {
            dt_s: 0.0,
            x: 0.0,
            y: 0.0,
            covariance: [[0.0; 2]; 2],
        }; MAX_FORECAST],
        ahead: Forecast::EMPTY,
        coasted_s: 0.0,
        history: History::EMPTY,
        headings: HeadingTrack::EMPTY,
        forecaster: Forecaster::START,
    };

    /// A track of something seen for the first time.
    pub(crate) fn start(
        id: u64,
        index: usize,
        observation: &Observation,
        alone: bool,
        now: Now<'_>,
    ) -> Self {
        let mut track = Self {
            id,
            started_ns: now.ns,
            ..Self::EMPTY
        };
        track.sight(index, observation, alone, now);
        track
    }

    /// Where the object should be now, and how surely.
    fn expected(&self, now_ns: u64) -> ([f64; 2], Covariance) {
        let (place, covariance) = self.ahead.at(self.unmeasured_s(now_ns));
        (add(place, self.shift), covariance)
    }

    /// Where the object may be now.
    pub(crate) fn hypotheses(&self, now: Now<'_>) -> Hypotheses {
        let samples = self.history.samples();
        let newest = samples.last().unwrap_or(&Sample::EMPTY);
        let position = add(newest.position, self.shift);
        let (_, noise) = self.ahead.at(0.0);
        Hypotheses::new(self.expected(now.ns), position, &noise, samples, now)
    }

    /// Whether enough was seen of it to report it.
    pub(crate) fn confirmed(&self, settings: &Settings) -> bool {
        self.sightings >= settings.confirm
    }

    /// Whether it is time to drop it.
    pub(crate) fn lost(&self, settings: &Settings) -> bool {
        self.misses > settings.max_misses || (self.misses > 0 && !self.confirmed(settings))
    }

    /// Its looks when nothing touches it.
    pub(crate) fn alone(&self) -> &Alone {
        &self.alone
    }

    /// Whether it may be kept in a blob with others.
    pub(crate) fn may_merge(&self, now_ns: u64, settings: &Settings) -> bool {
        self.confirmed(settings)
            && self.alone.proven()
            && !self.place.is_some_and(|place| place.overdue(now_ns))
    }

    /// Extent of the blob with others that it was in when last seen, 0 if it was by itself.
    pub(crate) fn blob_reach(&self) -> f64 {
        self.place.map_or(0.0, |place| place.reach())
    }

    /// The marker of the robot that it is or was.
    pub(crate) fn known_as(&self) -> Option<u32> {
        self.known_as
    }

    /// Tells that the robot was carried elsewhere: how it moved does not matter any more, how it uses to move does.
    pub(crate) fn put_down(&mut self) {
        self.history = History::EMPTY;
        self.headings = HeadingTrack::EMPTY;
        self.forecaster.measured_elsewhere();
        self.place = None;
    }

    /// Takes this frame's observation of the object. `alone`: nothing else is in it or near.
    pub(crate) fn sight(
        &mut self,
        index: usize,
        observation: &Observation,
        alone: bool,
        now: Now<'_>,
    ) {
        if alone {
            self.alone.see(observation);
        }
        let came_apart = self.place.is_some_and(|place| place.stays());
        self.age_frames += 1;
        self.sightings = self.sightings.saturating_add(1);
        self.misses = 0;
        self.observed = Some(index);
        match (self.marker, observation.marker) {
            (Some(_), None) if self.unread < now.settings.max_misses => {
                self.unread += 1;
                self.follow(observation, now);
            }
            (Some(_), None) => {
                self.headings = HeadingTrack::EMPTY;
                self.measure_elsewhere(observation, now.ns);
                self.measure(observation, now);
            }
            (known, read) if came_apart || (known.is_none() && read.is_some()) => {
                self.measure_elsewhere(observation, now.ns);
                self.measure(observation, now);
            }
            _ => self.measure(observation, now),
        }
        self.publish_ahead(now.ns);
    }

    /// Takes this frame's observation of the object and others that it touches.
    pub(crate) fn merge(&mut self, blob: &MergedBlob, now: Now<'_>) {
        self.age_frames += 1;
        self.misses = 0;
        self.observed = blob.leads.then_some(blob.index);
        self.pose_observed = false;
        let (expected, _) = self.expected(now.ns);
        let last_alone_ns = self
            .history
            .newest()
            .map_or(now.ns, |newest| newest.time_ns);
        let mut place = Place::take(self.place, blob, expected, last_alone_ns);
        if place.passes(
            blob.observation,
            expected,
            &self.alone,
            now.ns,
            now.settings,
        ) {
            self.place = Some(place);
            self.coast(now);
            self.publish_ahead(now.ns);
            return;
        }
        self.place = Some(place);
        if self.shift != [0.0; 2] {
            self.history.translate(self.shift);
            self.forecaster.measured_elsewhere();
            self.shift = [0.0; 2];
        }
        self.heading = self.headings.at(now.ns);
        self.go_on_from(
            place.position(blob.observation),
            place.covariance(blob.observation, now.ns),
            now,
        );
        self.publish_ahead(now.ns);
    }

    /// Lives through a frame in which the object was not seen.
    pub(crate) fn miss(&mut self, now: Now<'_>) {
        self.age_frames += 1;
        self.misses = self.misses.saturating_add(1);
        self.unread = self.unread.saturating_add(1);
        self.observed = None;
        self.coast(now);
        self.publish_ahead(now.ns);
    }

    /// The observation is the pose: take it, learn from it, look ahead from it.
    fn measure(&mut self, observation: &Observation, now: Now<'_>) {
        let period_s = now.settings.frame_period_s;
        self.marker = observation.marker;
        self.known_as = observation.marker.or(self.known_as);
        self.unread = 0;
        self.shift = [0.0; 2];
        self.place = None;
        self.pose_observed = true;
        if let Some(heading) = observation.heading {
            let longest_gap_s = LONGEST_HEADING_GAP_S.max(LEAST_HEADING_GAP_FRAMES * period_s);
            self.headings
                .observe(now.ns, heading, period_s, longest_gap_s);
        }
        self.heading = self.headings.at(now.ns);
        self.go_on_from([observation.x, observation.y], observation.covariance, now);
    }

    /// Makes a place the newest sample, learns from it and looks ahead from it.
    fn go_on_from(&mut self, position: [f64; 2], covariance: Covariance, now: Now<'_>) {
        let period_s = now.settings.frame_period_s;
        self.position = position;
        self.covariance = covariance;
        let sample = Sample {
            time_ns: now.ns,
            position,
        };
        let least_spacing_ns = (LEAST_SPACING_FRAMES * period_s * NS_PER_S) as u64;
        if self.history.push(sample, least_spacing_ns) {
            self.forecaster.learn(&self.history, now.settings);
        }
        let steering = self.headings.steering(self.history.samples());
        self.ahead = self.forecaster.forecast(
            &self.history,
            steering.as_ref(),
            // A place in a blob may lie outside.
            &pushed_out(&now.walls, position),
            &self.covariance,
            now.settings,
        );
        self.velocity = self.ahead.velocity;
    }

    /// The observation is another point of a marked body: weigh it against the forecast.
    fn follow(&mut self, observation: &Observation, now: Now<'_>) {
        self.coast(now);
        let mut noise = observation.covariance;
        let offset_variance = now.settings.marker_offset * now.settings.marker_offset;
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

    /// Everything from the forecast.
    fn coast(&mut self, now: Now<'_>) {
        self.pose_observed = false;
        (self.position, self.covariance) = self.expected(now.ns);
        self.heading = self.headings.at(now.ns);
        let period_s = now.settings.frame_period_s;
        let (next, _) = self.ahead.at(self.unmeasured_s(now.ns) + period_s);
        let moved = sub(add(next, self.shift), self.position);
        self.velocity = scale(moved, 1.0 / period_s);
    }

    /// From this observation on, the position means another point of the body.
    fn measure_elsewhere(&mut self, observation: &Observation, now_ns: u64) {
        // Without the shift: it is not in the samples either.
        let (expected, _) = self.ahead.at(self.unmeasured_s(now_ns));
        if self.history.samples().len() < 2 {
            self.history = History::EMPTY;
        } else {
            self.history
                .translate(sub([observation.x, observation.y], expected));
        }
        self.forecaster.measured_elsewhere();
    }

    fn publish_ahead(&mut self, now_ns: u64) {
        self.age_ns = now_ns - self.started_ns;
        self.coasted_s = self.unmeasured_s(now_ns);
        for i in 0..MAX_FORECAST {
            self.points[i] = self.forecast_at((i as f64 + 1.0) * FORECAST_SPACING_S);
        }
    }

    /// Seconds since the last sample.
    pub(crate) fn unmeasured_s(&self, now_ns: u64) -> f64 {
        self.history
            .newest()
            .map_or(0.0, |newest| seconds_between(newest.time_ns, now_ns))
    }
}
