//! Frame numbers from the driver's count, which differs between drivers.

/// Frame numbers that include lost frames, from a driver's 32-bit count.
#[derive(Debug, Default)]
pub(super) struct Numbers {
    /// The number of the next buffer if there is no gap.
    next: u64,
    /// The driver's count of the last buffer, and whether that was the first since the start of the
    /// camera.
    last: Option<(u32, bool)>,
    /// Frames lost so far.
    pub(super) lost: u64,
}

impl Numbers {
    /// The number of the next buffer, from 0.
    ///
    /// The step from the first buffer to the second always counts as one: v4l2loopback gives the
    /// first a count of 0 and the others their position since the start of the sender. A count that
    /// does not increase is invalid, and also counts as one.
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

    /// Restarts with the camera, whose count restarts too. Numbers continue; the number of frames
    /// missed meanwhile is unknown.
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
