//! The caller's input: observations and settings.

use crate::covariance::semidefinite;

/// Larger coordinates are an error of the caller, in any unit.
const MAX_COORDINATE: f64 = 1e9;
/// Longest gap, in seconds or in frames, whichever is longer.
const MAX_GAP_S: f64 = 2.0;
const MAX_GAP_FRAMES: f64 = 4.0;
/// Objects faster than this multiple of the top speed are not tracked. The top speed is only an
/// estimate.
const SPEED_MARGIN: f64 = 2.0;
const MAX_VARIANCE: f64 = MAX_COORDINATE * MAX_COORDINATE;

/// One object detected in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Measured position: the centre of the plate if the marker was read, otherwise the centroid.
    pub x: f64,
    /// See `x`.
    pub y: f64,
    /// Covariance of (x, y) in squared units.
    pub covariance: [[f64; 2]; 2],
    /// Heading of the marker, if it was read.
    pub heading: Option<Heading>,
    /// Index of the marker that was read. `None` for an object without a marker, or with one that
    /// could not be read.
    pub marker: Option<u32>,
    /// Distance from (x, y) to the farthest point of the object's contour, in units. 0 for a point,
    /// which cannot merge with other objects.
    pub reach: f64,
    /// Area inside the object's contour, in squared units.
    pub area: f64,
}

/// A direction and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heading {
    /// Direction in radians, from +x towards +y. Any number of turns on input, within (-π, π] on
    /// output.
    pub rad: f64,
    /// Variance in rad².
    pub variance: f64,
}

/// What the tracker must know about the scene. Lengths are in the unit of the observations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Nominal time between two frames in seconds.
    pub frame_period_s: f64,
    /// Speed of the fastest object in units per second.
    pub top_speed: f64,
    /// Distance, in units, at which an object at rest may be found from its forecast because of
    /// noise and changes of shape.
    pub gate_base: f64,
    /// Standard deviation per axis, in units, of the offset between the centre of a marker and the
    /// centroid of the object that carries it. It determines how much an observation without a
    /// marker is trusted as the position of a marked robot.
    pub marker_offset: f64,
    /// Number of consecutive frames without an observation after which a track is dropped. Until
    /// then the forecast replaces the measurement.
    pub max_misses: u32,
    /// Number of observations before a track is reported. Until then a single miss ends it. 1
    /// reports every track at once; 0 means 1.
    pub confirm: u32,
}

impl Default for Settings {
    /// For observations in pixels of a 640x480 picture at 15 frames per second.
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
    /// The same settings in another unit: all lengths are multiplied by `units_per_unit`, for
    /// example by the metres per pixel on the floor.
    #[must_use]
    pub fn scaled(self, units_per_unit: f64) -> Self {
        Self {
            top_speed: self.top_speed * units_per_unit,
            gate_base: self.gate_base * units_per_unit,
            marker_offset: self.marker_offset * units_per_unit,
            ..self
        }
    }

    /// Every value limited to the range that the arithmetic supports. NaN becomes the default.
    pub(crate) fn checked(self) -> Self {
        let clamped = |value: f64, default: f64, min: f64, max: f64| {
            if value.is_nan() {
                default
            } else {
                value.clamp(min, max)
            }
        };
        let default = Self::default();
        Self {
            frame_period_s: clamped(self.frame_period_s, default.frame_period_s, 1e-4, 10.0),
            top_speed: clamped(self.top_speed, default.top_speed, 0.0, MAX_COORDINATE),
            gate_base: clamped(self.gate_base, default.gate_base, 0.0, MAX_COORDINATE),
            marker_offset: clamped(
                self.marker_offset,
                default.marker_offset,
                0.0,
                MAX_COORDINATE,
            ),
            max_misses: self.max_misses,
            confirm: self.confirm.max(1),
        }
    }

    /// Longest time that anything is extrapolated. A longer pause between two frames counts as this
    /// long.
    pub(crate) fn max_gap_s(&self) -> f64 {
        MAX_GAP_S.max(MAX_GAP_FRAMES * self.frame_period_s)
    }

    /// Maximum distance that an object can cover in a time, in units.
    pub(crate) fn max_distance(&self, time_s: f64) -> f64 {
        self.gate_base + SPEED_MARGIN * self.top_speed * time_s
    }

    /// Maximum speed of a forecast in units per second: nothing faster is tracked.
    pub(crate) fn speed_limit(&self) -> f64 {
        self.max_distance(self.frame_period_s) / self.frame_period_s
    }
}

impl Observation {
    /// The observation with a symmetric, positive semidefinite covariance. `None` if a number is
    /// not finite, a variance is negative, or a coordinate or extent is out of range.
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
    fn rejects_invalid_observations() {
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
    fn repairs_invalid_settings() {
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
