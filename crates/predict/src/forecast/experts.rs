//! The experts: a few kinds of motion, fitted to short and long windows of recent samples.
//!
//! Short fits follow recent changes; long fits average out noise. The network decides which to
//! trust.

use libm::{cos, sin};

use crate::forecast::motion::Motion;
use crate::forecast::past::{MIN_TURN_SAMPLES, Past, Point};
use crate::heading::Steering;
use crate::layout::EXPERTS;
use crate::vector::{add, complex_mul, conjugate, scale, sub};

/// Maximum turn in radians per sample. Beyond it, five samples cover half a circle and the fit is
/// ambiguous.
const MAX_TURN_PER_SAMPLE: f64 = 0.6;

#[derive(Debug, Clone, Copy)]
enum Fit {
    Rest,
    Line,
    Turn,
    /// Constant acceleration: neither a line nor a turn.
    Parabola,
    /// A vehicle that keeps its velocity relative to its body and the turn rate of its marker.
    Steered,
    /// A line reflected at the bounds of everything observed so far.
    Bounce,
}

/// Kind of motion, and the maximum number of samples it is fitted to.
const FITS: [(Fit, usize); EXPERTS] = [
    (Fit::Rest, 1),
    (Fit::Rest, 16),
    (Fit::Line, 2),
    (Fit::Line, 6),
    (Fit::Line, 12),
    (Fit::Line, 32),
    (Fit::Parabola, 10),
    (Fit::Turn, 5),
    (Fit::Turn, 9),
    (Fit::Turn, 16),
    (Fit::Turn, 32),
    (Fit::Steered, 5),
    (Fit::Bounce, 5),
];

/// The motion of every expert. `bounds` are relative to the newest position. An expert that lacks
/// its input falls back to a line through the same samples.
pub(crate) fn fit(
    past: &Past,
    steering: Option<&Steering>,
    bounds: [[f64; 2]; 2],
) -> [Motion; EXPERTS] {
    let Some(step_s) = past.median_step_s() else {
        return [Motion::NONE; EXPERTS];
    };
    FITS.map(|(fit, n)| {
        let min_samples = match fit {
            Fit::Turn | Fit::Parabola => MIN_TURN_SAMPLES,
            Fit::Rest | Fit::Line | Fit::Steered | Fit::Bounce => 2,
        };
        let points = past.recent(n, min_samples, step_s);
        match fit {
            Fit::Rest => Motion::rest(points),
            Fit::Line => Motion::line(points),
            Fit::Turn => Motion::turn(points, MAX_TURN_PER_SAMPLE / step_s),
            Fit::Parabola => Motion::parabola(points),
            Fit::Bounce => Motion::bounce(points, bounds),
            Fit::Steered => steering
                .and_then(|steering| steered(points, steering))
                .unwrap_or_else(|| Motion::line(points)),
        }
    })
}

/// The mean velocity in the body frame, which turns with the body from now on.
fn steered(points: &[Point], steering: &Steering) -> Option<Motion> {
    let n = points.len().min(steering.len);
    if n < 2 {
        return None;
    }
    let (points, headings) = (&points[..n], &steering.headings_rad[..n]);
    // Sum of the displacements in the body frame.
    let mut chords = [0.0; 2];
    for (pair, headings) in points.windows(2).zip(headings.windows(2)) {
        let middle = 0.5 * (headings[0] + headings[1]);
        let chord = sub(pair[0].position, pair[1].position);
        chords = add(
            chords,
            complex_mul(chord, conjugate([cos(middle), sin(middle)])),
        );
    }
    let velocity = scale(chords, 1.0 / -points[n - 1].time_s);
    let newest = headings[0];
    let velocity = complex_mul(velocity, [cos(newest), sin(newest)]);
    let motion = Motion::Turn {
        origin: [0.0; 2],
        velocity: velocity.map(|v| v as f32),
        rate_rad_s: steering.rate_rad_s as f32,
    };
    velocity.iter().all(|v| v.is_finite()).then_some(motion)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::{History, Sample};

    /// A robot that drives sideways on a circle, with its heading a quarter turn off its course.
    #[test]
    fn steering_works_in_any_direction_of_travel() {
        let (rate, period_s) = (0.8, 0.1);
        let position = |t: f64| [50.0 * cos(rate * t), 50.0 * sin(rate * t)];
        let mut history = History::EMPTY;
        for i in 0..5_u32 {
            let t = period_s * f64::from(i);
            let sample = Sample {
                time_ns: u64::from(i) * 100_000_000,
                position: position(t),
            };
            history.push(sample, 0);
        }
        let now_s = 4.0 * period_s;
        let steering = Steering {
            rate_rad_s: rate,
            headings_rad: core::array::from_fn(|i| rate * (now_s - period_s * i as f64)),
            len: 5,
        };
        let past = Past::of(&history);
        let motion = steered(past.newest(5), &steering).expect("it moves");
        let [x, y] = motion.at(1.0).map(f64::from);
        let [now, then] = [position(now_s), position(now_s + 1.0)];
        let error = sub([x, y], sub(then, now));
        // Chords are slightly shorter than arcs.
        assert!(error[0].abs() < 0.05 && error[1].abs() < 0.05, "{error:?}");
        assert_eq!(steered(past.newest(1), &steering), None);
    }

    #[test]
    fn one_sample_gives_rest() {
        let mut history = History::EMPTY;
        history.push(Sample::EMPTY, 0);
        let motions = fit(&Past::of(&history), None, [[0.0; 2]; 2]);
        assert_eq!(motions, [Motion::NONE; EXPERTS]);
    }
}
