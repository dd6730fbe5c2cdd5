//! The newest measured positions of an object, in order of time.

use crate::time::seconds_between;

/// Number of samples kept: enough for the longest fit.
pub(crate) const MAX_SAMPLES: usize = 32;

/// A position at a time of the tracker's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sample {
    pub(crate) time_ns: u64,
    pub(crate) position: [f64; 2],
}

impl Sample {
    pub(crate) const EMPTY: Self = Self {
        time_ns: 0,
        position: [0.0; 2],
    };

    /// Seconds from `earlier` to `self`.
    pub(crate) fn seconds_since(&self, earlier: &Self) -> f64 {
        seconds_between(earlier.time_ns, self.time_ns)
    }
}

/// At most [`MAX_SAMPLES`] samples, oldest first, with strictly increasing times.
#[derive(Debug, Clone, Copy)]
pub(crate) struct History {
    samples: [Sample; MAX_SAMPLES],
    len: usize,
}

impl History {
    pub(crate) const EMPTY: Self = Self {
        samples: [Sample::EMPTY; MAX_SAMPLES],
        len: 0,
    };

    pub(crate) fn samples(&self) -> &[Sample] {
        &self.samples[..self.len]
    }

    pub(crate) fn newest(&self) -> Option<&Sample> {
        self.samples().last()
    }

    /// Adds a sample that is not older than the newest one. Returns whether the history grew.
    ///
    /// Only the newest two samples may be closer together than `min_spacing_ns`. A burst of frames
    /// or a repeated time stamp replaces the newest sample, so that the history is not filled with
    /// samples too close together to fit a slope.
    pub(crate) fn push(&mut self, sample: Sample, min_spacing_ns: u64) -> bool {
        if let [.., before, newest] = self.samples()
            && newest.time_ns - before.time_ns < min_spacing_ns
        {
            self.samples[self.len - 1] = sample;
            return false;
        }
        if self
            .newest()
            .is_some_and(|newest| sample.time_ns <= newest.time_ns)
        {
            self.samples[self.len - 1] = Sample {
                time_ns: self.samples[self.len - 1].time_ns,
                ..sample
            };
            return false;
        }
        if self.len == MAX_SAMPLES {
            self.samples.copy_within(1.., 0);
            self.len -= 1;
        }
        self.samples[self.len] = sample;
        self.len += 1;
        true
    }

    /// Moves all samples, because from now on another reference point of the object is measured.
    pub(crate) fn translate(&mut self, by: [f64; 2]) {
        for sample in &mut self.samples[..self.len] {
            sample.position[0] += by[0];
            sample.position[1] += by[1];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time_ns: u64) -> Sample {
        Sample {
            time_ns,
            position: [time_ns as f64, 0.0],
        }
    }

    fn times<const N: usize>(history: &History) -> Option<[u64; N]> {
        let mut times = [0; N];
        if history.samples().len() != N {
            return None;
        }
        for (time, sample) in times.iter_mut().zip(history.samples()) {
            *time = sample.time_ns;
        }
        Some(times)
    }

    #[test]
    fn drops_the_oldest_sample() {
        let mut history = History::EMPTY;
        for time in 1..=MAX_SAMPLES as u64 + 3 {
            assert!(history.push(at(time), 0));
        }
        assert_eq!(history.samples().len(), MAX_SAMPLES);
        assert_eq!(history.samples()[0], at(4));
        assert_eq!(history.newest(), Some(&at(MAX_SAMPLES as u64 + 3)));
    }

    #[test]
    fn a_burst_replaces_the_newest_sample() {
        let mut history = History::EMPTY;
        for time in [0, 100, 101, 102, 210] {
            history.push(at(time), 50);
        }
        assert_eq!(times(&history), Some([0, 100, 210]));
        history.push(at(260), 50);
        assert_eq!(times(&history), Some([0, 100, 210, 260]));
    }

    #[test]
    fn a_repeated_time_keeps_the_later_position() {
        let mut history = History::EMPTY;
        history.push(at(7), 0);
        let moved = Sample {
            position: [5.0, 5.0],
            ..at(7)
        };
        assert!(!history.push(moved, 0));
        assert_eq!(history.samples(), [moved]);
    }
}
