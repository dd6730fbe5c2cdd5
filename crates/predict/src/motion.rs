//! The classical forecasts: a straight line and a constant turn, fitted to an object's last samples by least
//! squares.
//!
//! Both are fitted in seconds and units relative to the newest sample, so that uneven frames and far-away origins
//! do not matter. The line through the last five positions is the forecast that any other has to beat; the turn
//! takes over where the path is an arc.
//!
//! # The turn
//!
//! An object that moves at constant speed and turns at the constant rate w is at
//!
//! ```text
//! p(t) = p0 + v * g(t),   g(t) = (sin wt + i (1 - cos wt)) / w      (places as complex numbers, t = 0 newest)
//! ```
//!
//! For a given w this is linear in p0 and v, so these two are eliminated (variable projection) and Gauss-Newton
//! searches for w alone. The start comes from two chords: a chord of an arc is parallel to the tangent at the
//! middle of its time, so the angle between the chords over the older and the newer samples, divided by the time
//! between the middles, is w, exactly so without noise.
//!
//! A turn rate found in noise bends a forecast badly. The rate is therefore scaled by 1 - var(w)/w², not below 0
//! (the positive-part James-Stein factor): a rate that stands out of its own uncertainty stays, another vanishes
//! and leaves a line.

use libm::{atan2, cos, sin};

use crate::history::Sample;

/// Samples of the line fit.
const LINE_SAMPLES: usize = 5;
/// Samples of the turn fit.
const TURN_SAMPLES: usize = 8;
/// Fewest samples of the turn fit: five unknowns and three equations to spare, which tell the noise.
const MIN_TURN_SAMPLES: usize = 4;
/// Gauss-Newton steps from the chords' start; further ones change nothing that matters.
const TURN_ITERATIONS: usize = 2;
/// Fastest turn in radians a forecast step; beyond it five samples cover half a circle and the fit is ambiguous.
const MAX_TURN_PER_STEP: f64 = 0.6;

/// Steady motion along a straight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Line {
    /// Fitted place at the newest sample's time.
    origin: [f64; 2],
    /// Units a second.
    pub(crate) velocity: [f64; 2],
    n: f64,
    /// Mean of the samples' times relative to the newest, not positive.
    mean_s: f64,
    /// Sum of the squared deviations of the times from their mean.
    spread_s2: f64,
}

impl Line {
    /// Fits the last five samples or those there are; one sample, or none, gives no motion.
    pub(crate) fn fit(samples: &[Sample]) -> Self {
        let samples = last(samples, LINE_SAMPLES);
        let Some(newest) = samples.last() else {
            return Self::at_rest([0.0; 2]);
        };
        if samples.len() < 2 {
            return Self::at_rest(newest.position);
        }
        let n = samples.len() as f64;
        let mut mean_s = 0.0;
        let mut mean = [0.0; 2];
        for sample in samples {
            mean_s -= newest.seconds_since(sample) / n;
            let relative = sub(sample.position, newest.position);
            mean = add(mean, scale(relative, 1.0 / n));
        }
        let mut spread_s2 = 0.0;
        let mut moment = [0.0; 2];
        for sample in samples {
            let time_s = -newest.seconds_since(sample) - mean_s;
            let relative = sub(sample.position, newest.position);
            spread_s2 += time_s * time_s;
            moment = add(moment, scale(sub(relative, mean), time_s));
        }
        let velocity = scale(moment, 1.0 / spread_s2);
        let origin = add(newest.position, sub(mean, scale(velocity, mean_s)));
        Self {
            origin,
            velocity,
            n,
            mean_s,
            spread_s2,
        }
    }

    fn at_rest(origin: [f64; 2]) -> Self {
        Self {
            origin,
            velocity: [0.0; 2],
            n: 1.0,
            mean_s: 0.0,
            spread_s2: f64::INFINITY,
        }
    }

    /// Place `ahead_s` seconds after the newest sample.
    pub(crate) fn at(&self, ahead_s: f64) -> [f64; 2] {
        add(self.origin, scale(self.velocity, ahead_s))
    }

    /// Variance of the place `ahead_s` after the newest sample that noise of variance 1 in every sample causes.
    pub(crate) fn noise_gain(&self, ahead_s: f64) -> f64 {
        let from_mean_s = ahead_s - self.mean_s;
        1.0 / self.n + from_mean_s * from_mean_s / self.spread_s2
    }

    /// Whether a velocity could be measured at all.
    pub(crate) fn has_velocity(&self) -> bool {
        self.n > 1.5
    }
}

/// Motion at constant speed and constant turn rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Turn {
    /// Fitted place at the newest sample's time.
    origin: [f64; 2],
    /// Units a second, at the newest sample's time.
    velocity: [f64; 2],
    /// Turn of the velocity in radians a second, from +x towards +y.
    rate_rad_s: f64,
}

impl Turn {
    /// Fits the last eight samples or those there are; `None` with fewer than four or when they do not move.
    pub(crate) fn fit(samples: &[Sample], step_s: f64) -> Option<Self> {
        if samples.len() < MIN_TURN_SAMPLES {
            return None;
        }
        let samples = last(samples, TURN_SAMPLES);
        let most = MAX_TURN_PER_STEP / step_s;
        let mut rate = rate_from_chords(samples)?.clamp(-most, most);
        for _ in 0..TURN_ITERATIONS {
            let slope = RateSlope::of(samples, rate)?;
            if slope.information > 0.0 {
                rate = (rate + slope.gradient / slope.information).clamp(-most, most);
            }
        }
        let rate_rad_s = rate * RateSlope::of(samples, rate)?.certainty(samples.len(), rate);
        let (origin, velocity) = solve_linear(samples, rate_rad_s)?;
        Some(Self {
            origin,
            velocity,
            rate_rad_s,
        })
    }

    /// Place `ahead_s` seconds after the newest sample.
    pub(crate) fn at(&self, ahead_s: f64) -> [f64; 2] {
        let arc = arc(self.rate_rad_s, ahead_s);
        add(self.origin, complex_mul(self.velocity, arc))
    }
}

/// Angle between the chord over the older half of the samples and that over the newer half, by the time between the
/// middles of the two; `None` if a chord has no direction.
fn rate_from_chords(samples: &[Sample]) -> Option<f64> {
    let (oldest, newest) = (samples.first()?, samples.last()?);
    let middle = &samples[samples.len() / 2];
    let older = sub(middle.position, oldest.position);
    let newer = sub(newest.position, middle.position);
    let (cross, dot) = (
        older[0] * newer[1] - older[1] * newer[0],
        older[0] * newer[0] + older[1] * newer[1],
    );
    if cross == 0.0 && dot == 0.0 {
        return None;
    }
    Some(atan2(cross, dot) / (0.5 * newest.seconds_since(oldest)))
}

/// How the squared residual of the best p0 and v changes with the turn rate.
struct RateSlope {
    /// Sum of squared residuals.
    residual: f64,
    /// Half the fall of `residual` for a small rise of the rate, for each rad/s.
    gradient: f64,
    /// Gauss-Newton's curvature; noise variance divided by it is the variance of the rate.
    information: f64,
}

impl RateSlope {
    fn of(samples: &[Sample], rate: f64) -> Option<Self> {
        let newest = samples.last()?;
        let (origin, velocity) = solve_linear(samples, rate)?;
        let n = samples.len() as f64;
        let mut residual = 0.0;
        let mut gradient = 0.0;
        // Sums for taking out of the derivative what a change of p0 and v would take up.
        let (mut arcs, mut arcs_squared) = ([0.0; 2], 0.0);
        let (mut derivatives, mut derivatives_squared) = ([0.0; 2], 0.0);
        let mut product = [0.0; 2];
        for sample in samples {
            let time_s = -newest.seconds_since(sample);
            let arc = arc(rate, time_s);
            let error = sub(sample.position, add(origin, complex_mul(velocity, arc)));
            let derivative = complex_mul(velocity, arc_derivative(rate, time_s, arc));
            residual += norm_squared(error);
            gradient += error[0] * derivative[0] + error[1] * derivative[1];
            arcs = add(arcs, arc);
            arcs_squared += norm_squared(arc);
            derivatives = add(derivatives, derivative);
            derivatives_squared += norm_squared(derivative);
            product = add(product, complex_mul(derivative, conjugate(arc)));
        }
        let spread = arcs_squared - norm_squared(arcs) / n;
        let shared = sub(
            product,
            scale(complex_mul(derivatives, conjugate(arcs)), 1.0 / n),
        );
        let information =
            derivatives_squared - norm_squared(derivatives) / n - norm_squared(shared) / spread;
        (information.is_finite() && gradient.is_finite()).then_some(Self {
            residual,
            gradient,
            information,
        })
    }

    /// Part of the rate that stands out of its uncertainty: 1 - var(w)/w², or nothing.
    fn certainty(&self, n_samples: usize, rate: f64) -> f64 {
        let freedom = (2 * n_samples).saturating_sub(5) as f64;
        let variance = self.residual / freedom / self.information;
        let certainty = 1.0 - variance / (rate * rate);
        // Samples that do not determine the rate give no information, and the comparison fails for what is then no
        // number.
        if self.information > 0.0 && certainty > 0.0 {
            certainty
        } else {
            0.0
        }
    }
}

/// Least squares for p0 and v when the turn rate is known.
fn solve_linear(samples: &[Sample], rate: f64) -> Option<([f64; 2], [f64; 2])> {
    let newest = samples.last()?;
    let n = samples.len() as f64;
    let (mut arcs, mut arcs_squared) = ([0.0; 2], 0.0);
    let (mut places, mut product) = ([0.0; 2], [0.0; 2]);
    for sample in samples {
        let arc = arc(rate, -newest.seconds_since(sample));
        let place = sub(sample.position, newest.position);
        arcs = add(arcs, arc);
        arcs_squared += norm_squared(arc);
        places = add(places, place);
        product = add(product, complex_mul(place, conjugate(arc)));
    }
    let spread = arcs_squared - norm_squared(arcs) / n;
    let velocity = scale(
        sub(
            product,
            scale(complex_mul(places, conjugate(arcs)), 1.0 / n),
        ),
        1.0 / spread,
    );
    let origin = scale(sub(places, complex_mul(velocity, arcs)), 1.0 / n);
    let origin = add(newest.position, origin);
    (velocity.iter().chain(&origin).all(|c| c.is_finite())).then_some((origin, velocity))
}

/// g(t) of the module's documentation; its series where the quotients lose their digits.
fn arc(rate: f64, time_s: f64) -> [f64; 2] {
    let angle = rate * time_s;
    if angle.abs() < 1e-4 {
        [time_s * (1.0 - angle * angle / 6.0), time_s * (0.5 * angle)]
    } else {
        [sin(angle) / rate, (1.0 - cos(angle)) / rate]
    }
}

/// Derivative of g(t) by the turn rate, given g(t) itself.
fn arc_derivative(rate: f64, time_s: f64, arc: [f64; 2]) -> [f64; 2] {
    let angle = rate * time_s;
    if angle.abs() < 1e-3 {
        let squared = time_s * time_s;
        [
            -squared * angle / 3.0,
            squared * (0.5 - angle * angle / 8.0),
        ]
    } else {
        // d/dw (sin wt)/w = (t cos wt - g_x)/w and likewise for y; cos and sin follow from g.
        let (sine, cosine) = (arc[0] * rate, 1.0 - arc[1] * rate);
        [
            (time_s * cosine - arc[0]) / rate,
            (time_s * sine - arc[1]) / rate,
        ]
    }
}

/// The last `n` samples or those there are.
fn last(samples: &[Sample], n: usize) -> &[Sample] {
    &samples[samples.len().saturating_sub(n)..]
}

pub(crate) fn add(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] + b[0], a[1] + b[1]]
}

pub(crate) fn sub(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn scale(a: [f64; 2], by: f64) -> [f64; 2] {
    [a[0] * by, a[1] * by]
}

pub(crate) fn norm_squared(a: [f64; 2]) -> f64 {
    a[0] * a[0] + a[1] * a[1]
}

/// Product of complex numbers; with a unit vector, a rotation.
pub(crate) fn complex_mul(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

pub(crate) fn conjugate(a: [f64; 2]) -> [f64; 2] {
    [a[0], -a[1]]
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    const STEP_S: f64 = 1.0 / 15.0;

    /// Samples of a path at uneven moments.
    fn samples(n: usize, place: impl Fn(f64) -> [f64; 2]) -> Vec<Sample> {
        (0..n)
            .map(|i| {
                let time_ns = 66_666_667 * i as u64 + 9_000_000 * (i as u64 % 3);
                let position = place(time_ns as f64 / 1e9);
                Sample { time_ns, position }
            })
            .collect()
    }

    fn newest_s(samples: &[Sample]) -> f64 {
        samples.last().expect("samples").time_ns as f64 / 1e9
    }

    #[test]
    fn line_is_exact_on_a_line() {
        let place = |t: f64| [1000.0 + 30.0 * t, -7.0 * t];
        for n in 2..9 {
            let samples = samples(n, place);
            let line = Line::fit(&samples);
            let error = sub(line.at(1.0), place(newest_s(&samples) + 1.0));
            assert!(norm_squared(error) < 1e-18, "{n} samples: {error:?}");
            assert!((line.velocity[0] - 30.0).abs() < 1e-9);
        }
    }

    #[test]
    fn line_through_three_points_by_hand() {
        let places = [0.0, 0.0, 3.0];
        let samples: Vec<Sample> = (0..3)
            .map(|i| Sample {
                time_ns: i as u64 * 1_000_000_000,
                position: [places[i], 0.0],
            })
            .collect();
        let line = Line::fit(&samples);
        assert!((line.velocity[0] - 1.5).abs() < 1e-12);
        assert!((line.at(0.0)[0] - 2.5).abs() < 1e-12);
        // 1/3 + (1 + 1)²/2: one second after the newest, two after the mean time.
        assert!((line.noise_gain(1.0) - (1.0 / 3.0 + 2.0)).abs() < 1e-12);
    }

    #[test]
    fn one_sample_stays_where_it_is() {
        let samples = samples(1, |_| [3.0, 4.0]);
        let line = Line::fit(&samples);
        assert_eq!(line.at(1.0), [3.0, 4.0]);
        assert!(!line.has_velocity());
    }

    #[test]
    fn turn_is_exact_on_circles() {
        for rate in [-4.0_f64, -0.5, 1e-3, 0.7, 3.0] {
            let place = |t: f64| [500.0 + 60.0 * sin(rate * t), 60.0 * cos(rate * t)];
            for n in 4..12 {
                let samples = samples(n, place);
                let turn = Turn::fit(&samples, STEP_S).expect("a fit");
                let error = sub(turn.at(1.0), place(newest_s(&samples) + 1.0));
                assert!(norm_squared(error) < 1e-8, "{rate} {n}: {error:?}");
            }
        }
    }

    #[test]
    fn turn_of_a_jittering_line_is_nearly_a_line() {
        let samples = samples(8, |t| {
            let jitter = 0.3 * cos(core::f64::consts::PI * 15.0 * t);
            [50.0 * t, jitter]
        });
        let turn = Turn::fit(&samples, STEP_S).expect("a fit");
        assert!(turn.rate_rad_s.abs() < 0.2, "{turn:?}");
    }

    #[test]
    fn nothing_turns_at_rest() {
        assert_eq!(Turn::fit(&samples(8, |_| [1.0, 2.0]), STEP_S), None);
    }

    #[test]
    fn derivative_of_the_arc_is_its_difference_quotient() {
        for (rate, time_s) in [(0.5, -0.4), (-3.0, 0.9), (1e-3, -0.5), (0.0, 0.3)] {
            let h = 1e-5;
            let analytic = arc_derivative(rate, time_s, arc(rate, time_s));
            let numeric = scale(sub(arc(rate + h, time_s), arc(rate - h, time_s)), 0.5 / h);
            assert!(
                norm_squared(sub(analytic, numeric)) < 1e-12,
                "{rate} {time_s}: {analytic:?} {numeric:?}"
            );
        }
    }
}
