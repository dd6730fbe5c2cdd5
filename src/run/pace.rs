//! Detects and reports during the run that a camera's frames are not processed as fast as they
//! arrive.

use std::time::{Duration, Instant};

use imgproc::Size;

/// Time of the first check, and interval of the following ones.
const FIRST_LOOK: Duration = Duration::from_secs(10);
const PERIOD: Duration = Duration::from_secs(60);
/// Minimum share of missed frames for a report.
const SHARE_MIN: f64 = 0.05;

/// Sizes to suggest, largest first.
const SIZES: [(usize, usize); 9] = [
    (1920, 1080),
    (1600, 1200),
    (1280, 960),
    (1280, 720),
    (960, 540),
    (800, 600),
    (640, 480),
    (640, 360),
    (320, 240),
];

/// Frame counts so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Totals {
    pub(super) captured: u64,
    /// For a newer one, or because no slot was free.
    pub(super) skipped: u64,
    pub(super) lost_by_driver: u64,
    pub(super) processed: u64,
}

/// Counts since the last check.
#[derive(Debug)]
pub(super) struct Pace {
    size: Size,
    since: Instant,
    period: Duration,
    start: Totals,
    busy: Duration,
}

impl Pace {
    pub(super) fn new(size: Size, now: Instant) -> Self {
        Self {
            size,
            since: now,
            period: FIRST_LOOK,
            start: Totals::default(),
            busy: Duration::ZERO,
        }
    }

    /// Adds the processing time of a frame.
    pub(super) fn processed(&mut self, took: Duration) {
        self.busy += took;
    }

    /// The message to report at `now`, if a check is due and frames were missed.
    pub(super) fn look(&mut self, totals: Totals, now: Instant) -> Option<String> {
        let elapsed = now.saturating_duration_since(self.since);
        if elapsed < self.period {
            return None;
        }
        let (start, busy) = (self.start, self.busy);
        (self.since, self.period) = (now, PERIOD);
        (self.start, self.busy) = (totals, Duration::ZERO);

        let captured = totals.captured - start.captured;
        let skipped = totals.skipped - start.skipped;
        let lost = totals.lost_by_driver - start.lost_by_driver;
        let missed = (skipped + lost) as f64;
        if missed < SHARE_MIN * (captured + lost) as f64 || captured == 0 {
            return None;
        }
        let processed = (totals.processed - start.processed).max(1);
        let frame_ms = 1e3 * busy.as_secs_f64() / processed as f64;
        let period_ms = 1e3 * elapsed.as_secs_f64() / (captured + lost) as f64;
        let Size { width, height } = self.size;
        let remedy = if frame_ms > 0.9 * period_ms {
            let rate_hz = (900.0 / frame_ms).floor();
            match self.smaller(0.9 * period_ms / frame_ms) {
                Some((width, height)) => {
                    format!("try --size {width}x{height}, or --rate {rate_hz:.0}")
                }
                None => format!("try --rate {rate_hz:.0}"),
            }
        } else {
            "other programs keep this machine busy".to_owned()
        };
        Some(format!(
            "too slow: passed over {skipped} of {captured} frames in {:.0} s, driver lost {lost}: {frame_ms:.0} ms a frame at \
             {width}x{height}, and one comes every {period_ms:.0} ms; {remedy}",
            elapsed.as_secs_f64()
        ))
    }

    /// The largest common size with the same aspect ratio and at most this share of the pixels.
    fn smaller(&self, share: f64) -> Option<(usize, usize)> {
        let aspect = |width: usize, height: usize| width as f64 / height as f64;
        let own = aspect(self.size.width, self.size.height);
        let area_max = share * self.size.area() as f64;
        SIZES.into_iter().find(|&(width, height)| {
            (width * height) as f64 <= area_max && (aspect(width, height) / own - 1.0).abs() < 0.05
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL_HD: Size = Size {
        width: 1920,
        height: 1080,
    };

    fn seconds(n: u64) -> Duration {
        Duration::from_secs(n)
    }

    #[test]
    fn a_camera_that_is_followed_is_not_worth_a_word() {
        let start = Instant::now();
        let mut pace = Pace::new(FULL_HD, start);
        let totals = |captured, skipped| Totals {
            captured,
            skipped,
            lost_by_driver: 0,
            processed: captured - skipped,
        };
        assert_eq!(pace.look(totals(300, 200), start + seconds(9)), None);
        assert_eq!(pace.look(totals(300, 10), start + seconds(10)), None);
        assert_eq!(pace.look(totals(330, 40), start + seconds(11)), None);
        assert_eq!(pace.look(totals(2100, 41), start + seconds(70)), None);
    }

    #[test]
    fn advice_for_a_slow_machine_is_given_once_a_minute() {
        let start = Instant::now();
        let mut pace = Pace::new(FULL_HD, start);
        let totals = Totals {
            captured: 300,
            skipped: 170,
            lost_by_driver: 33,
            processed: 130,
        };
        (0..130).for_each(|_| pace.processed(Duration::from_millis(60)));
        assert_eq!(
            pace.look(totals, start + seconds(10)).as_deref(),
            Some(
                "too slow: passed over 170 of 300 frames in 10 s, driver lost 33: 60 ms a frame at 1920x1080, and one comes every 30 ms; \
                 try --size 1280x720, or --rate 15"
            )
        );
        let later = Totals {
            captured: 600,
            skipped: 340,
            ..totals
        };
        assert_eq!(pace.look(later, start + seconds(69)), None);
        assert!(pace.look(later, start + seconds(70)).is_some());
    }

    #[test]
    fn no_smaller_size_is_suggested_for_a_busy_machine() {
        let start = Instant::now();
        let mut pace = Pace::new(FULL_HD, start);
        (0..200).for_each(|_| pace.processed(Duration::from_millis(5)));
        let totals = Totals {
            captured: 300,
            skipped: 100,
            lost_by_driver: 0,
            processed: 200,
        };
        let message = pace.look(totals, start + seconds(10)).expect("a message");
        assert!(
            message.ends_with("other programs keep this machine busy"),
            "{message}"
        );
    }

    #[test]
    fn nothing_smaller_than_the_smallest_is_proposed() {
        let size = Size {
            width: 160,
            height: 120,
        };
        let pace = Pace::new(size, Instant::now());
        assert_eq!(pace.smaller(0.5), None);
        assert_eq!(
            Pace::new(FULL_HD, Instant::now()).smaller(0.2),
            Some((640, 360))
        );
    }
}
