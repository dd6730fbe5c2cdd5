//! Scenes published while a camera delivers no frames, with the duration of the outage.

use std::time::{Duration, Instant};

use scene::{CLOCK_MONOTONIC, SOURCE_WAITING, Scene};

/// Time between two scenes without a frame.
const PERIOD: Duration = Duration::from_secs(1);
/// Silence before an outage is published: this time, and this multiple of the interval of the last
/// two frames. The actual rate of a camera may differ from the stated one.
const SILENCE: (Duration, u32) = (Duration::from_secs(1), 3);

/// The scene published without a frame, and when it is due.
#[derive(Debug)]
pub(super) struct Heartbeat {
    scene: Box<Scene>,
    /// Interval between frames: first as stated by the camera, then as measured.
    interval: Duration,
    last_frame: Option<Instant>,
    last_sent: Option<Instant>,
}

impl Heartbeat {
    /// `rate_hz` is the rate stated by the camera, if any, `frame` the coordinate frame of its
    /// scenes ([`Scene::frame`]).
    pub(super) fn new(rate_hz: Option<f64>, frame: u32) -> Self {
        let interval_s = rate_hz.map_or(0.0, |rate_hz| 1.0 / rate_hz.max(1e-3));
        Self {
            scene: Box::new(Scene {
                frame,
                source: SOURCE_WAITING,
                clock: CLOCK_MONOTONIC,
                ..Scene::EMPTY
            }),
            interval: Duration::from_secs_f64(interval_s),
            last_frame: None,
            last_sent: None,
        }
    }

    /// To be called for each frame, with or without a scene of its own.
    pub(super) fn frame(&mut self, sequence: u64, stamp_ns: u64, now: Instant) {
        (self.scene.sequence, self.scene.stamp_ns) = (sequence, stamp_ns);
        // An outage is no measure of the usual interval.
        if let (Some(last), None) = (self.last_frame, self.last_sent) {
            self.interval = now.saturating_duration_since(last);
        }
        self.last_frame = Some(now);
        self.last_sent = None;
    }

    /// Stores the illumination of the last scene.
    pub(super) fn light(&mut self, scene: &Scene) {
        (self.scene.light, self.scene.gain) = (scene.light, scene.gain);
    }

    /// The scene to publish, if one is due: immediately if the camera is known to be lost,
    /// otherwise after a long silence, and then every second. Never before the first frame.
    /// `now_ns` is on the clock of the stamps.
    pub(super) fn due(&mut self, is_lost: bool, now: Instant, now_ns: u64) -> Option<&Scene> {
        let silence = SILENCE.0.max(SILENCE.1 * self.interval);
        let is_silent = now.saturating_duration_since(self.last_frame?) >= silence;
        let is_due = self
            .last_sent
            .is_none_or(|sent| now.saturating_duration_since(sent) >= PERIOD);
        if !is_due || !(is_lost || is_silent) {
            return None;
        }
        self.last_sent = Some(now);
        let age_ns = now_ns.saturating_sub(self.scene.stamp_ns);
        self.scene.frame_age_s = (age_ns as f64 * 1e-9) as f32;
        Some(&self.scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::{FRAME_FLOOR, LIGHT_DARK};

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn nothing_is_due_while_frames_come() {
        let start = Instant::now();
        let mut heartbeat = Heartbeat::new(Some(30.0), 0);
        assert!(heartbeat.due(true, start, 0).is_none(), "no frame yet");
        for i in 0..100 {
            let now = start + 33 * i * MS;
            heartbeat.frame(u64::from(i), 0, now);
            assert!(heartbeat.due(false, now + 32 * MS, 0).is_none());
        }
    }

    #[test]
    fn a_lost_camera_is_published_at_once_and_then_every_second() {
        let start = Instant::now();
        let mut heartbeat = Heartbeat::new(Some(30.0), FRAME_FLOOR);
        heartbeat.frame(17, 5_000_000_000, start);
        heartbeat.light(&Scene {
            light: LIGHT_DARK,
            ..Scene::EMPTY
        });
        let sent: Vec<u32> = (0..32)
            .filter(|i| {
                heartbeat
                    .due(true, start + 100 * *i * MS, 5_250_000_000)
                    .is_some()
            })
            .collect();
        assert_eq!(sent, [0, 10, 20, 30]);
        let scene = heartbeat
            .due(true, start + 9000 * MS, 5_250_000_000)
            .expect("due");
        assert_eq!((scene.source, scene.sequence), (SOURCE_WAITING, 17));
        assert_eq!((scene.frame, scene.light), (FRAME_FLOOR, LIGHT_DARK));
        assert_eq!((scene.frame_age_s, scene.n_objects), (0.25, 0));
    }

    #[test]
    fn a_camera_that_is_slower_than_it_states_is_not_silent() {
        let start = Instant::now();
        let mut heartbeat = Heartbeat::new(Some(30.0), 0);
        for i in 0..10 {
            heartbeat.frame(u64::from(i), 0, start + 900 * i * MS);
        }
        let last = start + 8100 * MS;
        assert!(heartbeat.due(false, last + 2699 * MS, 0).is_none());
        assert!(heartbeat.due(false, last + 2700 * MS, 0).is_some());
        // The outage did not change the usual interval.
        heartbeat.frame(10, 0, last + 60_000 * MS);
        assert!(heartbeat.due(false, last + 62_700 * MS, 0).is_some());
    }

    #[test]
    fn silence_is_measured_by_the_cameras_rate() {
        let start = Instant::now();
        for (rate_hz, silent_ms) in [(Some(30.0), 1000), (None, 1000), (Some(0.5), 6000)] {
            let mut heartbeat = Heartbeat::new(rate_hz, 0);
            heartbeat.frame(0, 0, start);
            assert!(
                heartbeat
                    .due(false, start + (silent_ms - 1) * MS, 0)
                    .is_none()
            );
            assert!(heartbeat.due(false, start + silent_ms * MS, 0).is_some());
        }
    }
}
