//! What the caller gives: observations of one frame and the settings.

use crate::covariance::semidefinite;

/// A place further out than this is a fault of the caller's arithmetic, not a place on a floor, in any unit.
const MAX_COORDINATE: f64 = 1e9;
/// Longest gap in seconds, and in frames where these are slow.
const LONGEST_GAP_S: f64 = 2.0;
const LEAST_GAP_FRAMES: f64 = 4.0;
/// What is faster than so many top speeds is not followed: top speeds are guessed.
const TOP_SPEEDS: f64 = 2.0;
const MAX_VARIANCE: f64 = MAX_COORDINATE * MAX_COORDINATE;

/// One thing seen in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Measured place: the centre of the plate when the marker was read, otherwise the centre of area.
    pub x: f64,
    /// See `x`.
    pub y: f64,
    /// Covariance of (x, y), in squared units.
    pub covariance: [[f64; 2]; 2],
    /// Direction of the marker, where one was read.
    pub heading: Option<Heading>,
    /// Index of the marker that was read, `None` for a thing without one or with one that could not be read.
    pub marker: Option<u32>,
    /// Distance from (x, y) to the farthest point of the whole object's outline, in units. 0 for a point, which nothing
    /// can merge with.
    pub reach: f64,
    /// Area within the whole object's outline, in squared units.
    pub area: f64,
}

/// A direction and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heading {
    /// Direction in radians, from +x towards +y. Any turn on input, within (-π, π] on output.
    pub rad: f64,
    /// Its variance in rad².
    pub variance: f64,
}

/// What the tracker must know about the scene. Lengths are in the unit of the observations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Nominal time between two frames in seconds.
    pub frame_period_s: f64,
    /// Speed of the fastest object in units a second.
    pub top_speed: f64,
    /// Distance by which an object at rest may be found beside its forecast: noise and a change of shape, in units.
    pub gate_base: f64,
    /// Standard deviation, in units and each axis, of the distance between a marker's centre and the centre of area
    /// of the whole object that carries it. Says how far an observation without marker is trusted as the place of a
    /// marked robot.
    pub marker_offset: f64,
    /// Consecutive frames for which a missing observation is replaced by the forecast before the track is retired.
    pub max_misses: u32,
    /// Sightings before a track is reported; until then one miss ends it. 1 reports everything at once, 0 means 1.
    pub confirm: u32,
}

impl Default for Settings {
    /// For observations in pixels of a 640x480 picture at 15 frames a second.
    fn default() -> Self {
        Self {
            frame_period_s: 1.0 / 15.0,
            top_speed: 300.0,
            gate_base: 8.0,
            marker_offset: 8.0,
            max_misses: 8,
            confirm: 1,
        }
    }
}

impl Settings {
    /// The same settings for observations in another unit: all lengths times `units_per_unit`, for example the
    /// metres of a pixel on the floor.
    #[must_use]
    pub fn scaled(self, units_per_unit: f64) -> Self {
        Self {
            top_speed: self.top_speed * units_per_unit,
            gate_base: self.gate_base * units_per_unit,
            marker_offset: self.marker_offset * units_per_unit,
            ..self
        }
    }

    /// Every value within what the arithmetic bears; one that is no number becomes the default.
    pub(crate) fn checked(self) -> Self {
        let within = |value: f64, default: f64, least: f64, most: f64| {
            if value.is_nan() {
                default
            } else {
                value.clamp(least, most)
            }
        };
        let default = Self::default();
        Self {
            frame_period_s: within(self.frame_period_s, default.frame_period_s, 1e-4, 10.0),
            top_speed: within(self.top_speed, default.top_speed, 0.0, MAX_COORDINATE),
            gate_base: within(self.gate_base, default.gate_base, 0.0, MAX_COORDINATE),
            marker_offset: within(
                self.marker_offset,
                default.marker_offset,
                0.0,
                MAX_COORDINATE,
            ),
            max_misses: self.max_misses,
            confirm: self.confirm.max(1),
        }
    }

    /// Longest time over which anything is extrapolated. A longer pause between two frames counts as this long.
    pub(crate) fn longest_gap_s(&self) -> f64 {
        LONGEST_GAP_S.max(LEAST_GAP_FRAMES * self.frame_period_s)
    }

    /// Farthest that an object can have gone in a time, in units.
    pub(crate) fn farthest(&self, time_s: f64) -> f64 {
        self.gate_base + TOP_SPEEDS * self.top_speed * time_s
    }

    /// Speed that no forecast exceeds, in units a second: none faster is followed.
    pub(crate) fn speed_limit(&self) -> f64 {
        self.farthest(self.frame_period_s) / self.frame_period_s
    }
}

impl Observation {
    /// The observation with a symmetric, positive semidefinite covariance; `None` if a number in it is not finite,
    /// a variance negative or a coordinate or extent absurd.
    pub(crate) fn checked(&self) -> Option<Self> {
        let [[xx, xy], [yx, yy]] = self.covariance;
        let place_ok = self.x.abs() <= MAX_COORDINATE && self.y.abs() <= MAX_COORDINATE;
        let variance_ok = (0.0..=MAX_VARIANCE).contains(&xx) && (0.0..=MAX_VARIANCE).contains(&yy);
        let covariance_ok = xy.abs() <= MAX_VARIANCE && yx.abs() <= MAX_VARIANCE;
        let heading_ok = self.heading.is_none_or(|heading| {
            heading.rad.abs() <= MAX_COORDINATE && (0.0..=MAX_VARIANCE).contains(&heading.variance)
        });
        let extent_ok = (0.0..=MAX_COORDINATE).contains(&self.reach)
            && (0.0..=MAX_VARIANCE).contains(&self.area);
        if !(extent_ok && place_ok && variance_ok && covariance_ok && heading_ok) {
            return None;
        }
        Some(Self {
            covariance: semidefinite(&self.covariance),
            ..*self
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: Observation = Observation {
        x: 1.0,
        y: 2.0,
        covariance: [[4.0, 0.0], [0.0, 9.0]],
        heading: None,
        marker: None,
        reach: 0.0,
        area: 0.0,
    };

    #[test]
    fn refuses_what_is_no_place() {
        assert!(PLAIN.checked().is_some());
        for x in [f64::NAN, f64::INFINITY, -1e10] {
            assert_eq!(Observation { x, ..PLAIN }.checked(), None);
        }
        for variance in [f64::NAN, -1.0, f64::INFINITY] {
            let covariance = [[variance, 0.0], [0.0, 1.0]];
            assert_eq!(
                Observation {
                    covariance,
                    ..PLAIN
                }
                .checked(),
                None
            );
            let (reach, area) = (variance, variance);
            assert_eq!(Observation { reach, ..PLAIN }.checked(), None);
            assert_eq!(Observation { area, ..PLAIN }.checked(), None);
            let heading = Some(Heading { rad: 0.0, variance });
            assert_eq!(Observation { heading, ..PLAIN }.checked(), None);
        }
    }

    #[test]
    fn makes_the_covariance_symmetric_and_semidefinite() {
        let covariance = [[4.0, 100.0], [0.0, 9.0]];
        let checked = Observation {
            covariance,
            ..PLAIN
        }
        .checked();
        assert_eq!(
            checked.map(|o| o.covariance),
            Some([[4.0, 6.0], [6.0, 9.0]])
        );
    }

    #[test]
    fn repairs_settings_that_are_no_numbers() {
        let settings = Settings {
            frame_period_s: f64::NAN,
            top_speed: f64::INFINITY,
            gate_base: -1.0,
            confirm: 0,
            ..Settings::default()
        }
        .checked();
        assert_eq!(settings.frame_period_s, 1.0 / 15.0);
        assert_eq!(settings.top_speed, MAX_COORDINATE);
        assert_eq!(settings.gate_base, 0.0);
        assert_eq!(settings.confirm, 1);
    }
}
