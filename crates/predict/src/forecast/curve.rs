//! The forecast of one track as a function of time.

use libm::sqrt;

use crate::covariance::Covariance;
use crate::forecast::horizon::Horizons;
use crate::forecast::motion::Motion;
use crate::layout::{ByExpert, EXPERTS, HORIZONS};
use crate::vector::{add, norm_squared, scale, sub};

/// Expected position at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForecastPoint {
    /// Seconds after the time stamp of the frame.
    pub dt_s: f64,
    /// Expected position.
    pub x: f64,
    /// See `x`.
    pub y: f64,
    /// Covariance of (x, y) as a camera would measure it then, in squared units.
    pub covariance: [[f64; 2]; 2],
}

/// Expected positions after the newest sample.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Forecast {
    pub(crate) horizons: Horizons,
    /// Longest time ahead in seconds.
    pub(crate) max_ahead_s: f64,
    pub(crate) speed_limit: f64,
    pub(crate) origin: [f64; 2],
    pub(crate) motions: [Motion; EXPERTS],
    pub(crate) shares: ByExpert<f32>,
    /// At the newest sample, and by horizon.
    pub(crate) covariance: Covariance,
    pub(crate) covariances: [Covariance; HORIZONS],
    /// Velocity at the newest sample in units per second.
    pub(crate) velocity: [f64; 2],
    /// Turn rate of the velocity.
    pub(crate) turn_rate_rad_s: f64,
}

impl Forecast {
    pub(crate) const EMPTY: Self = Self {
        horizons: Horizons::ONE_SECOND,
        max_ahead_s: 1.0,
        speed_limit: 0.0,
        origin: [0.0; 2],
        motions: [Motion::NONE; EXPERTS],
        shares: [[0.0; EXPERTS]; HORIZONS],
        covariance: [[0.0; 2]; 2],
        covariances: [[[0.0; 2]; 2]; HORIZONS],
        velocity: [0.0; 2],
        turn_rate_rad_s: 0.0,
    };

    /// Position and covariance `ahead_s` seconds after the newest sample. Shares are interpolated
    /// between horizons; the experts are evaluated at exactly this time. After the last horizon its
    /// shares are kept and standard deviations grow with time, up to the longest gap.
    pub(crate) fn at(&self, ahead_s: f64) -> ([f64; 2], Covariance) {
        let ahead_s = ahead_s.clamp(0.0, self.max_ahead_s);
        let (index, part) = self.horizons.around(ahead_s);
        let next = (index + 1).min(HORIZONS - 1);
        let mut position = [0.0_f32; 2];
        let shares = self.shares[index].iter().zip(&self.shares[next]);
        for (motion, (share, later)) in self.motions.iter().zip(shares) {
            let share = share + part as f32 * (later - share);
            if share == 0.0 {
                continue;
            }
            let [x, y] = motion.at(ahead_s as f32);
            position[0] += share * x;
            position[1] += share * y;
        }
        let reach = self.speed_limit * ahead_s;
        let position = add(self.origin, limited(position.map(f64::from), reach));

        let times_s = &self.horizons.times_s;
        let covariance = if ahead_s > times_s[HORIZONS - 1] {
            let growth = ahead_s / times_s[HORIZONS - 1];
            self.covariances[HORIZONS - 1].map(|row| scale(row, growth * growth))
        } else if ahead_s <= times_s[0] {
            let part = ahead_s / times_s[0];
            interpolated(&self.covariance, &self.covariances[0], part)
        } else {
            let part = (ahead_s - times_s[index]) / (times_s[next] - times_s[index]);
            interpolated(&self.covariances[index], &self.covariances[next], part)
        };
        (position, covariance)
    }
}

fn interpolated(from: &Covariance, to: &Covariance, part: f64) -> Covariance {
    let mut covariance = *from;
    for (row, to) in covariance.iter_mut().zip(to) {
        *row = add(*row, scale(sub(*to, *row), part));
    }
    covariance
}

/// The vector, shortened to the length `max`. Zero if it is not finite.
pub(crate) fn limited(vector: [f64; 2], max: f64) -> [f64; 2] {
    let length = sqrt(norm_squared(vector));
    if !length.is_finite() {
        [0.0; 2]
    } else if length > max {
        scale(vector, max / length)
    } else {
        vector
    }
}
