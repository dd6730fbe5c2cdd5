//! The horizons at which forecasts are scored: from one step to [`FORECAST_RANGE_S`], spaced evenly
//! on a logarithmic scale.

use libm::{exp2, log2};

use crate::layout::HORIZONS;
use crate::limits::FORECAST_RANGE_S;

/// Minimum time to the first horizon in seconds. At higher frame rates, the motion between two
/// frames is too small to score.
const MIN_STEP_S: f64 = 1.0 / 16.0;

/// Times ahead for one frame period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Horizons {
    /// Nominal time between two frames, not longer than `step_s`.
    pub(crate) frame_s: f64,
    /// Time to the first horizon, which is also the unit in which ages are counted.
    pub(crate) step_s: f64,
    pub(crate) times_s: [f64; HORIZONS],
    /// Octaves between two horizons.
    octaves: f64,
}

impl Horizons {
    pub(crate) const ONE_SECOND: Self = Self {
        frame_s: 1.0,
        step_s: 1.0,
        times_s: [1.0; HORIZONS],
        octaves: 0.0,
    };

    /// Horizons for a frame period in seconds.
    pub(crate) fn new(frame_period_s: f64) -> Self {
        let first_s = frame_period_s.max(MIN_STEP_S);
        let octaves = log2(FORECAST_RANGE_S.max(first_s) / first_s) / (HORIZONS - 1) as f64;
        let mut times_s = [0.0; HORIZONS];
        let ratio = exp2(octaves);
        let mut ahead_s = first_s;
        for time_s in &mut times_s {
            *time_s = ahead_s;
            ahead_s *= ratio;
        }
        Self {
            frame_s: frame_period_s,
            step_s: first_s,
            times_s,
            octaves,
        }
    }

    /// Index of the horizon before `ahead_s`, and the fraction of the interval to the next one, 0
    /// to 1.
    pub(crate) fn around(&self, ahead_s: f64) -> (usize, f64) {
        if ahead_s <= self.times_s[0] || self.octaves <= 0.0 {
            return (0, 0.0);
        }
        let at = log2(ahead_s / self.times_s[0]) / self.octaves;
        let index = (at as usize).min(HORIZONS - 2);
        (index, (at - index as f64).clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_one_frame_to_two_seconds() {
        for period_s in [1.0 / 120.0, 1.0 / 30.0, 1.0 / 15.0, 0.4] {
            let horizons = Horizons::new(period_s);
            assert_eq!(horizons.times_s[0], period_s.max(MIN_STEP_S));
            assert!((horizons.times_s[HORIZONS - 1] - FORECAST_RANGE_S).abs() < 1e-12);
            assert!(horizons.times_s.is_sorted());
        }
    }

    #[test]
    fn every_time_lies_between_its_horizons() {
        let horizons = Horizons::new(1.0 / 15.0);
        for i in 0..250 {
            let ahead_s = 0.01 * f64::from(i);
            let (index, part) = horizons.around(ahead_s);
            assert!((0.0..=1.0).contains(&part) && index + 1 < HORIZONS);
            let (from, to) = (horizons.times_s[index], horizons.times_s[index + 1]);
            if (from..to).contains(&ahead_s) {
                let expected = libm::log(ahead_s / from) / libm::log(to / from);
                assert!((part - expected).abs() < 1e-9, "{ahead_s}");
            }
        }
        assert_eq!(horizons.around(99.0), (HORIZONS - 2, 1.0));
        // At this frame period all horizons coincide.
        assert_eq!(Horizons::new(5.0).around(7.0), (0, 0.0));
    }
}
