//! The classical forecasts that the network weighs: the same few motions over short and long stretches of the past.
//!
//! Short fits follow what has just changed, long ones average noise away; which of them is right is the one question
//! that the network answers.

use libm::{cos, sin};

use crate::forecast::motion::Motion;
use crate::forecast::past::{MIN_TURN_SAMPLES, Past, Point};
use crate::heading::Steering;
use crate::layout::EXPERTS;
use crate::vector::{add, complex_mul, conjugate, scale, sub};

/// Fastest turn in radians a sample; beyond it five samples cover half a circle and a fit is ambiguous.
const MAX_TURN_PER_SAMPLE: f64 = 0.6;
#[derive(Debug, Clone, Copy)]
enum Fit {
    Rest,
    Line,
    Turn,
    /// Steady acceleration: what neither a line nor a turn is.
    Parabola,
    /// A vehicle that keeps its velocity relative to its body and the turn rate that its marker shows.
    Steered,
    /// A line thrown back by the walls beyond which nothing was ever seen.
    Walled,
}

/// Kind of motion, and the most samples it is fitted to.
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
    (Fit::Walled, 5),
];

/// Every expert's motion. `walls`: lowest and highest coordinates at which anything was ever seen, relative to the
/// newest place. Where an expert lacks what it needs, it says what the line through as many samples says.
pub(crate) fn fit(
    past: &Past,
    steering: Option<&Steering>,
    walls: [[f64; 2]; 2],
) -> [Motion; EXPERTS] {
    let Some(step_s) = past.usual_step_s() else {
        return [Motion::NONE; EXPERTS];
    };
    FITS.map(|(fit, n)| {
        let least = match fit {
            Fit::Turn | Fit::Parabola => MIN_TURN_SAMPLES,
            Fit::Rest | Fit::Line | Fit::Steered | Fit::Walled => 2,
        };
        let points = past.recent(n, least, step_s);
        match fit {
            Fit::Rest => Motion::rest(points),
            Fit::Line => Motion::line(points),
            Fit::Turn => Motion::turn(points, MAX_TURN_PER_SAMPLE / step_s),
            Fit::Parabola => Motion::parabola(points),
            Fit::Walled => Motion::walled(points, walls),
            Fit::Steered => steering
                .and_then(|steering| steered(points, steering))
                .unwrap_or_else(|| Motion::line(points)),
        }
    })
}

/// The mean velocity as seen from the body, turned with the body from now on.
fn steered(points: &[Point], steering: &Steering) -> Option<Motion> {
    let n = points.len().min(steering.len);
    if n < 2 {
        return None;
    }
    let (points, headings) = (&points[..n], &steering.headings_rad[..n]);
    // Each step's velocity as seen from the body, weighed by the time it took.
    let mut moved = [0.0; 2];
    for (pair, headings) in points.windows(2).zip(headings.windows(2)) {
        let middle = 0.5 * (headings[0] + headings[1]);
        let chord = sub(pair[0].place, pair[1].place);
        moved = add(
            moved,
            complex_mul(chord, conjugate([cos(middle), sin(middle)])),
        );
    }
    let velocity = scale(moved, 1.0 / -points[n - 1].time_s);
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

    /// A robot that drives sideways, its nose a quarter turn off its way, on a circle.
    #[test]
    fn a_marker_tells_how_a_vehicle_steers_in_whatever_direction_it_drives() {
        let (rate, period_s) = (0.8, 0.1);
        let place = |t: f64| [50.0 * cos(rate * t), 50.0 * sin(rate * t)];
        let mut history = History::EMPTY;
        for i in 0..5_u32 {
            let t = period_s * f64::from(i);
            let sample = Sample {
                time_ns: u64::from(i) * 100_000_000,
                position: place(t),
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
        let [now, then] = [place(now_s), place(now_s + 1.0)];
        let error = sub([x, y], sub(then, now));
        // The chords are a little shorter than the arcs.
        assert!(error[0].abs() < 0.05 && error[1].abs() < 0.05, "{error:?}");
        assert_eq!(steered(past.newest(1), &steering), None);
    }

    #[test]
    fn one_sample_says_that_it_stays() {
        let mut history = History::EMPTY;
        history.push(Sample::EMPTY, 0);
        let motions = fit(&Past::of(&history), None, [[0.0; 2]; 2]);
        assert_eq!(motions, [Motion::NONE; EXPERTS]);
    }
}
