//! A tracker that is fed frame by frame.

use predict::{MAX_TRACKS, Observation, Settings, Track, Tracker, Update};
use random::SplitMix64;

/// Frame period at 15 frames per second.
pub(crate) const STEP_NS: u64 = 66_666_667;
pub(crate) const STEP_S: f64 = STEP_NS as f64 / 1e9;

pub(crate) fn settings() -> Settings {
    Settings {
        frame_period_s: STEP_S,
        ..Settings::default()
    }
}

/// A tracker and the index of the next frame.
pub(crate) struct Floor {
    pub(crate) tracker: Tracker<Vec<Track>>,
    pub(crate) settings: Settings,
    pub(crate) frame: u64,
}

impl Floor {
    pub(crate) fn new() -> Self {
        Self {
            tracker: Tracker::new(vec![Track::EMPTY; MAX_TRACKS]),
            settings: settings(),
            frame: 0,
        }
    }

    pub(crate) fn observe(&mut self, observations: &[Observation]) -> Update {
        let stamp_ns = self.frame * STEP_NS;
        self.frame += 1;
        self.tracker.update(stamp_ns, observations, &self.settings)
    }

    pub(crate) fn ids(&self) -> Vec<u64> {
        self.tracker.tracks().map(Track::id).collect()
    }

    /// The track with this id.
    pub(crate) fn track(&self, id: u64) -> &Track {
        self.tracker
            .tracks()
            .find(|track| track.id() == id)
            .unwrap_or_else(|| panic!("no track {id} among {:?}", self.ids()))
    }

    /// The only track.
    pub(crate) fn only(&self) -> &Track {
        let mut tracks = self.tracker.tracks();
        let track = tracks.next().expect("a track");
        assert!(tracks.next().is_none(), "more than one track");
        track
    }

    pub(crate) fn assert_at(&self, id: u64, position: [f64; 2], within: f64) {
        let at = self.track(id).position();
        let off = distance(at, position);
        assert!(
            off <= within + 1e-9,
            "frame {}: track {id} at {at:?}, {off} px off",
            self.frame
        );
    }
}

pub(crate) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    f64::hypot(a[0] - b[0], a[1] - b[1])
}

/// Random numbers of a scene.
pub(crate) struct Random(SplitMix64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(SplitMix64(seed))
    }

    /// Uniform in [0, 1).
    pub(crate) fn next(&mut self) -> f64 {
        self.0.unit_f64()
    }

    pub(crate) fn within(&mut self, min: f64, max: f64) -> f64 {
        min + (max - min) * self.next()
    }

    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}
