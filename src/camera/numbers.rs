//! Numbers of frames, from a count that drivers keep each in its own way.

/// Frame numbers that count lost frames, made from a driver's 32-bit count.
#[derive(Debug, Default)]
pub(super) struct Numbers {
    /// The number of a buffer that follows without a gap.
    next: u64,
    /// The driver's count of the last buffer, and whether that was the first since the camera was started.
    last: Option<(u32, bool)>,
    /// Frames lost so far.
    pub(super) lost: u64,
}

impl Numbers {
    /// The number of the next buffer, from 0.
    ///
    /// The step from the first buffer to the second is always taken as one: v4l2loopback gives the first a count of 0 and the
    /// others their place since the sender's start. A count that stands still or goes back is no count, and taken as one too.
    pub(super) fn next(&mut self, count: u32) -> u64 {
        let lost = match self.last {
            Some((last, false)) => match count.wrapping_sub(last) {
                step @ 1..=0x7fff_ffff => u64::from(step - 1),
                _ => 0,
            },
            _ => 0,
        };
        self.last = Some((count, self.last.is_none()));
        let number = self.next + lost;
        self.next = number + 1;
        self.lost += lost;
        number
    }

    /// The camera is started again, and its count with it. Numbers go on; how many frames there would have been meanwhile, nobody
    /// knows.
    pub(super) fn restart(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_count_what_is_lost() {
        let mut numbers = Numbers::default();
        let counts = [7, 8, 9, 12, 13];
        assert_eq!(counts.map(|count| numbers.next(count)), [0, 1, 2, 5, 6]);
        assert_eq!(numbers.lost, 2);
    }

    #[test]
    fn the_drivers_count_wraps_around() {
        let mut numbers = Numbers::default();
        let counts = [u32::MAX - 2, u32::MAX - 1, u32::MAX, 0, 2];
        assert_eq!(counts.map(|count| numbers.next(count)), [0, 1, 2, 3, 5]);
        assert_eq!(numbers.lost, 1);
    }

    #[test]
    fn a_first_count_of_zero_is_no_gap() {
        let mut numbers = Numbers::default();
        let counts = [0, 5_000_000, 5_000_001];
        assert_eq!(counts.map(|count| numbers.next(count)), [0, 1, 2]);
        assert_eq!(numbers.lost, 0);
    }

    #[test]
    fn numbers_go_on_when_the_count_starts_again() {
        let mut numbers = Numbers::default();
        assert_eq!([0, 1, 2].map(|count| numbers.next(count)), [0, 1, 2]);
        numbers.restart();
        assert_eq!([0, 700, 702].map(|count| numbers.next(count)), [3, 4, 6]);
        assert_eq!(numbers.lost, 1);
    }

    #[test]
    fn drivers_that_do_not_count_lose_nothing() {
        let mut numbers = Numbers::default();
        let counts = [0, 0, 0, 9, 3];
        assert_eq!(counts.map(|count| numbers.next(count)), [0, 1, 2, 11, 12]);
    }
}
