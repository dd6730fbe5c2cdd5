//! The heading of a marker over time: unwrapped angles, and a constant turn rate fitted to the
//! newest of them.

use core::f64::consts::PI;

use libm::floor;

use crate::history::Sample;
use crate::observation::Heading;
use crate::time::seconds_between;

/// Number of angles that the turn rate is fitted to.
pub(crate) const MAX_ANGLES: usize = 5;
/// Standard deviation of the turn rate when only one angle is known, in rad/s.
const UNKNOWN_RATE_RAD_S: f64 = 1.0;
/// Variance of an unknown direction: uniform over the full circle.
const MAX_VARIANCE: f64 = PI * PI / 3.0;

/// The newest measured headings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HeadingTrack {
    times_ns: [u64; MAX_ANGLES],
    /// Unwrapped relative to each other. The newest is within (-π, π].
    angles_rad: [f64; MAX_ANGLES],
    len: usize,
    variance: f64,
    rate_rad_s: f64,
    rate_variance: f64,
}

/// Turn rate of a marker, and its headings at the newest positions, newest first.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Steering {
    pub(crate) rate_rad_s: f64,
    /// The first `len` are valid. They are unwrapped relative to each other.
    pub(crate) headings_rad: [f64; MAX_ANGLES],
    pub(crate) len: usize,
}

impl HeadingTrack {
    pub(crate) const EMPTY: Self = Self {
        times_ns: [0; MAX_ANGLES],
        angles_rad: [0.0; MAX_ANGLES],
        len: 0,
        variance: 0.0,
        rate_rad_s: 0.0,
        rate_variance: 0.0,
    };

    /// Adds a measurement that is not older than the newest one.
    ///
    /// Of the angles that differ by full turns, the one nearest to the extrapolated heading is
    /// used. A robot is assumed to turn by less than half a turn per frame, since the camera cannot
    /// tell otherwise. After more than `max_gap_s` without a measurement the older angles are
    /// dropped, because full turns cannot be counted across the gap.
    pub(crate) fn observe(&mut self, time_ns: u64, measured: Heading, step_s: f64, max_gap_s: f64) {
        if self.len > 0 && self.age_s(time_ns) > max_gap_s {
            self.len = 0;
        }
        self.variance = measured.variance;
        let mut angle = wrapped(measured.rad);
        if self.len > 0 {
            let expected = self.angles_rad[self.len - 1] + self.rate_rad_s * self.age_s(time_ns);
            angle = expected + wrapped(angle - expected);
            if self.times_ns[self.len - 1] == time_ns {
                self.len -= 1;
            } else if self.len == MAX_ANGLES {
                self.times_ns.copy_within(1.., 0);
                self.angles_rad.copy_within(1.., 0);
                self.len -= 1;
            }
        }
        self.times_ns[self.len] = time_ns;
        self.angles_rad[self.len] = angle;
        self.len += 1;
        // Subtracting the same full turns from all angles keeps them small however long a robot
        // spins.
        let turns = angle - wrapped(angle);
        for angle in &mut self.angles_rad[..self.len] {
            *angle -= turns;
        }
        self.fit_rate(PI / step_s);
    }

    /// Heading at a time not before the newest measurement.
    pub(crate) fn at(&self, time_ns: u64) -> Option<Heading> {
        let newest = self.angles_rad[..self.len].last()?;
        let age_s = self.age_s(time_ns);
        Some(Heading {
            rad: wrapped(newest + self.rate_rad_s * age_s),
            variance: (self.variance + self.rate_variance * age_s * age_s).min(MAX_VARIANCE),
        })
    }

    /// Steering of an object with these newest samples, oldest first. `None` if fewer than two of
    /// them have a heading.
    pub(crate) fn steering(&self, samples: &[Sample]) -> Option<Steering> {
        let mut steering = Steering {
            rate_rad_s: self.rate_rad_s,
            headings_rad: [0.0; MAX_ANGLES],
            len: 0,
        };
        let read = self.times_ns[..self.len].iter().zip(&self.angles_rad);
        for ((time_ns, angle), sample) in read.rev().zip(samples.iter().rev()) {
            if *time_ns != sample.time_ns {
                break;
            }
            steering.headings_rad[steering.len] = *angle;
            steering.len += 1;
        }
        (steering.len > 1).then_some(steering)
    }

    /// Turn rate in rad/s, known from the second measurement on.
    pub(crate) fn rate_rad_s(&self) -> Option<f64> {
        (self.len > 1).then_some(self.rate_rad_s)
    }

    fn age_s(&self, time_ns: u64) -> f64 {
        seconds_between(self.times_ns[self.len - 1], time_ns)
    }

    /// Slope of the least-squares line through the angles, limited to ±`max_rad_s`.
    fn fit_rate(&mut self, max_rad_s: f64) {
        self.rate_rad_s = 0.0;
        self.rate_variance = UNKNOWN_RATE_RAD_S * UNKNOWN_RATE_RAD_S;
        if self.len < 2 {
            return;
        }
        let n = self.len as f64;
        let first_ns = self.times_ns[0];
        let seconds = |time_ns: u64| seconds_between(first_ns, time_ns);
        let points = self.times_ns[..self.len]
            .iter()
            .map(|time_ns| seconds(*time_ns))
            .zip(self.angles_rad[..self.len].iter().copied());
        let (mean_s, mean_rad) = points
            .clone()
            .fold((0.0, 0.0), |(s, rad), p| (s + p.0 / n, rad + p.1 / n));
        let (spread, moment) = points.fold((0.0, 0.0), |(spread, moment), (s, rad)| {
            let from_mean_s = s - mean_s;
            (
                spread + from_mean_s * from_mean_s,
                moment + from_mean_s * (rad - mean_rad),
            )
        });
        self.rate_rad_s = (moment / spread).clamp(-max_rad_s, max_rad_s);
        self.rate_variance = self.variance / spread;
    }
}

/// The same direction within (-π, π].
fn wrapped(rad: f64) -> f64 {
    let turns = floor((PI - rad) / (2.0 * PI));
    let angle = rad + 2.0 * PI * turns;
    // Rounding may give exactly -π, which stands for π.
    if angle <= -PI { PI } else { angle.min(PI) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: u64 = 66_666_667;
    const STEP_S: f64 = 1.0 / 15.0;

    fn heading(rad: f64) -> Heading {
        Heading {
            rad,
            variance: 1e-4,
        }
    }

    #[test]
    fn wraps_to_the_half_open_interval() {
        for (rad, expected) in [(0.0, 0.0), (PI, PI), (-PI, PI), (4.0, 4.0 - 2.0 * PI)] {
            assert!((wrapped(rad) - expected).abs() < 1e-12, "{rad}");
        }
        assert!((wrapped(-7.0) - (2.0 * PI - 7.0)).abs() < 1e-12);
    }

    #[test]
    fn the_rate_of_a_spinning_marker_survives_wrapping() {
        for rate in [-20.0, -3.0, 3.0, 20.0] {
            let mut track = HeadingTrack::EMPTY;
            // Slow at first: two frames do not show the sense of a fast spin.
            let mut angle = 0.0;
            let mut time_ns = 0;
            for i in 0..200 {
                angle += rate * STEP_S * (f64::from(i) / 100.0).min(1.0);
                time_ns += STEP_NS;
                track.observe(time_ns, heading(wrapped(angle)), STEP_S, 1.0);
            }
            let found = track.rate_rad_s().expect("a rate");
            assert!((found - rate).abs() < 1e-3, "{found} for {rate}");
            let ahead = track.at(time_ns + 5 * STEP_NS).expect("a heading");
            let error = wrapped(ahead.rad - (angle + rate * 5.0 * STEP_S));
            assert!(error.abs() < 1e-3, "{error}");
        }
    }

    #[test]
    fn variance_grows_to_that_of_an_unknown_direction() {
        let mut track = HeadingTrack::EMPTY;
        track.observe(0, heading(1.0), STEP_S, 1.0);
        assert_eq!(track.rate_rad_s(), None);
        let variance = |time_ns| track.at(time_ns).expect("a heading").variance;
        assert!(variance(0) < variance(STEP_NS));
        assert_eq!(variance(1_000_000_000_000), MAX_VARIANCE);
    }

    #[test]
    fn a_long_gap_resets_the_rate() {
        let mut track = HeadingTrack::EMPTY;
        track.observe(0, heading(0.0), STEP_S, 1.0);
        track.observe(STEP_NS, heading(0.3), STEP_S, 1.0);
        assert!(track.rate_rad_s().is_some());
        track.observe(20 * STEP_NS, heading(-2.0), STEP_S, 1.0);
        assert_eq!(track.rate_rad_s(), None);
    }
}
