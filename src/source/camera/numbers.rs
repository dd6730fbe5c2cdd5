//! Numbers of frames, from a count that drivers keep each in its own way.

/// Frame numbers that count lost frames, made from a driver's 32-bit count.
#[derive(Debug, Default)]
pub(super) struct Numbers {
    /// The driver's count and ours of the last buffer, and whether it was the first.
    last: Option<(u32, u64, bool)>,
    /// Frames lost so far.
    pub(super) lost: u64,
}

impl Numbers {
    /// The number of the next buffer, from 0.
    ///
    /// The step from the first buffer to the second is always taken as one: v4l2loopback gives the first a count of 0 and the
    /// others their place since the sender's start. A count that stands still or goes back is no count, and taken as one too.
    pub(super) fn next(&mut self, count: u32) -> u64 {
        let Some((last_count, last_number, was_first)) = self.last else {
            self.last = Some((count, 0, true));
            return 0;
        };
        let step = match count.wrapping_sub(last_count) {
            step @ 1..=0x7fff_ffff if !was_first => u64::from(step),
            _ => 1,
        };
        let number = last_number + step;
        self.lost += step - 1;
        self.last = Some((count, number, false));
        number
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
    fn drivers_that_do_not_count_lose_nothing() {
        let mut numbers = Numbers::default();
        let counts = [0, 0, 0, 9, 3];
        assert_eq!(counts.map(|count| numbers.next(count)), [0, 1, 2, 11, 12]);
    }
}
