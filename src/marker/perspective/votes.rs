//! Markers that would be readings if the perspective of the camera were known.

use crate::marker::perspective::expected::StretchReading;

/// Number of votes that are kept, and the number that must agree before a camera of unknown
/// perspective has one. Four unknowns that fit five votes by chance fit six numbers by chance.
const KEPT: usize = 16;
const AGREEING_MIN: usize = 5;

/// Votes that do not agree may be this share of all, one in so many.
const STRAYS: usize = 4;

/// A vote agrees with a perspective within this many standard deviations.
const DEVIATIONS: f64 = 3.0;

/// Two votes of a marker are independent if its heading differs by this much: a wrong shape turns
/// with its stretch, a plate does not.
const TURN_RAD: f32 = 0.5;

/// A marker that may have been seen at an angle by a camera of unknown perspective. It is no
/// reading; enough of them that agree are a perspective.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Vote {
    pub(crate) pixel: [f64; 2],
    /// Index in the family.
    pub(crate) marker: usize,
    pub(crate) heading_rad: f32,
    pub(crate) reading: StretchReading,
}

impl Vote {
    /// Whether it says nothing that another vote does not say.
    fn repeats(&self, other: &Self) -> bool {
        let turn = fourier::wrapped(self.heading_rad - other.heading_rad).abs();
        self.marker == other.marker && turn < TURN_RAD
    }
}

/// The last votes that say something of their own.
#[derive(Debug, Clone, Copy)]
pub(super) struct Votes {
    ring: [Option<Vote>; KEPT],
    newest: usize,
}

impl Votes {
    pub(super) const NONE: Self = Self {
        ring: [None; KEPT],
        newest: 0,
    };

    pub(super) fn add(&mut self, vote: Vote) {
        let repeated = |kept: &Option<Vote>| kept.is_some_and(|kept| vote.repeats(&kept));
        let place = self.ring.iter().position(repeated).unwrap_or_else(|| {
            self.newest = (self.newest + 1) % KEPT;
            self.newest
        });
        self.ring[place] = Some(vote);
    }

    /// The fit of the votes that agree, if there are enough of them. `fit` fits votes, and
    /// `deviation` is how far one is from a fit, in standard deviations.
    pub(super) fn agreed<F>(
        &self,
        fit: impl Fn(&mut dyn Iterator<Item = Vote>) -> F,
        deviation: impl Fn(&F, &Vote) -> f64,
    ) -> Option<F> {
        let mut kept = self.ring;
        let n = kept.iter().flatten().count();
        for left_out in 0..=n / STRAYS {
            if n < AGREEING_MIN + left_out {
                return None;
            }
            let trial = fit(&mut kept.iter().flatten().copied());
            let of = |vote: &Option<Vote>| vote.map_or(0.0, |vote| deviation(&trial, &vote));
            let deviations = kept.each_ref().map(of);
            let worst = (0..KEPT).max_by(|&a, &b| deviations[a].total_cmp(&deviations[b]))?;
            if deviations[worst] <= DEVIATIONS {
                return Some(trial);
            }
            kept[worst] = None;
        }
        None
    }
}
