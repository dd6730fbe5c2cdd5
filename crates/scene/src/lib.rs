//! What a subscriber of overcam reads: plain data types and the name of the service.
//!
//! A planner depends only on this crate (and on `iceoryx2` to subscribe). One [`Scene`] is
//! published for every processed frame, even if it shows nothing, on the publish-subscribe service
//! `NAME/scene` ([`DEFAULT_SERVICE`], [`SERVICE_SUFFIX`]). The event service of the same name is
//! notified after each publication, so a reader can block on it. While the camera delivers no
//! frames, an empty scene per second reports this ([`Scene::source`]).
//!
//! # Layout
//!
//! All types are `repr(C)`, have a fixed size, and have no pointers and no padding between fields,
//! so a C struct or a Python `ctypes.Structure` with the same fields can read them. Lists are
//! arrays preceded by a count; entries beyond the count are zero. Any change of layout changes the
//! number in the type name, so iceoryx2 rejects a subscriber built for another layout.
//!
//! # Coordinates
//!
//! [`Scene::frame`] gives the coordinate frame of all numbers:
//!
//! * [`FRAME_IMAGE`]: pixels; (0, 0) is the centre of the top left pixel, x right, y down; headings
//!   are from +x towards +y, clockwise on the screen.
//! * [`FRAME_FLOOR`]: metres on the floor, z up; headings are counter-clockwise from +x (REP-103).
//!
//! Headings are in radians within (-π, π], velocities are per second.
//!
//! # Where to subscribe
//!
//! [`config`] returns the iceoryx2 configuration that finds a service, even if overcam runs as
//! another user with `--group GROUP`. In that case a subscriber calls [`admit`] once it has its
//! ports. With a single user, `Config::default()` is enough.
#![no_std]
#![forbid(unsafe_code)]

mod domain;

pub use domain::{
    GROUP_VARIABLE, admit, config, group_config, group_directory, is_current, static_file,
    user_config,
};

use iceoryx2::prelude::ZeroCopySend;

/// `NAME` of the service without `--service NAME`.
pub const DEFAULT_SERVICE: &str = "overcam";
/// Suffix of `NAME` in the names of the publish-subscribe and event services: `overcam/scene`.
pub const SERVICE_SUFFIX: &str = "/scene";

/// Maximum number of objects in a scene. Further objects are counted in [`Scene::n_overflow`].
pub const MAX_OBJECTS: usize = 64;
/// Maximum number of points in an object's outline.
pub const MAX_OUTLINE: usize = 64;
/// Number of points in a forecast, evenly spaced up to two seconds ahead.
pub const MAX_FORECAST: usize = 20;
/// Bytes of a marker name: UTF-8, padded with zeros.
pub const NAME_BYTES: usize = 32;

/// [`Scene::frame`]: coordinates are pixels of the image.
pub const FRAME_IMAGE: u32 = 0;
/// [`Scene::frame`]: coordinates are metres on the floor.
pub const FRAME_FLOOR: u32 = 1;

/// [`Scene::clock`]: stamps count from the first frame of the source.
pub const CLOCK_SOURCE: u32 = 0;
/// [`Scene::clock`]: stamps are `CLOCK_MONOTONIC` of this machine.
pub const CLOCK_MONOTONIC: u32 = 1;

/// [`Scene::light`]: the light has not changed.
pub const LIGHT_STEADY: u32 = 0;
/// [`Scene::light`]: the light has just changed; new objects are withheld for a moment.
pub const LIGHT_CHANGED: u32 = 1;
/// [`Scene::light`]: too dark to see anything.
pub const LIGHT_DARK: u32 = 2;

/// [`Scene::source`]: frames arrive.
pub const SOURCE_RUNNING: u32 = 0;
/// [`Scene::source`]: no frames arrive because the camera is unplugged or has stalled. overcam
/// waits for it. The scene is empty; its sequence and stamp are those of the last frame.
pub const SOURCE_WAITING: u32 = 1;

/// [`Object::kind`]: an object without a recognised marker.
pub const KIND_OBSTACLE: u32 = 0;
/// [`Object::kind`]: a robot or target with a recognised marker.
pub const KIND_MARKER: u32 = 1;

/// Bit of [`Object::flags`]: seen in this frame. Otherwise the pose is forecast from earlier
/// frames.
pub const OBSERVED: u32 = 1;
/// Bit of [`Object::flags`]: `heading_rad` and its covariances are valid.
pub const HAS_HEADING: u32 = 2;

/// Everything known about the floor at the time one frame was exposed.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("overcam.Scene.v5")]
pub struct Scene {
    /// Index of the frame in its source, from 0. Includes frames that were dropped, skipped or used
    /// for learning.
    pub sequence: u64,
    /// Time of exposure on the clock given by `clock`.
    pub stamp_ns: u64,
    /// `CLOCK_MONOTONIC` just before publication; 0 if the scene was not published.
    pub published_ns: u64,
    /// [`FRAME_IMAGE`] or [`FRAME_FLOOR`].
    pub frame: u32,
    /// Number of valid entries of `objects`.
    pub n_objects: u32,
    /// Number of shapes and tracks of this frame that are not reported because a capacity was
    /// reached.
    pub n_overflow: u32,
    /// Clock of `stamp_ns`: [`CLOCK_MONOTONIC`] for a camera, [`CLOCK_SOURCE`] for everything else.
    pub clock: u32,
    /// [`LIGHT_STEADY`], [`LIGHT_CHANGED`] or [`LIGHT_DARK`].
    pub light: u32,
    /// Brightness of red, green and blue relative to the picture of the empty floor: lamps,
    /// exposure, white balance.
    pub gain: [f32; 3],
    /// [`SOURCE_RUNNING`] or [`SOURCE_WAITING`].
    pub source: u32,
    /// Seconds since the exposure of the last frame while the source is [`SOURCE_WAITING`].
    /// Otherwise 0; see [`Scene::age_ns`].
    pub frame_age_s: f32,
    /// The objects in order of their track ids.
    pub objects: [Object; MAX_OBJECTS],
}

/// An object on the floor.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("overcam.Object.v3")]
pub struct Object {
    /// Track id: the same object keeps it from frame to frame, and it is never reused within a run.
    pub track: u64,
    /// Marker: centre of the plate. Obstacle: centroid of the outline.
    pub x: f64,
    /// See `x`.
    pub y: f64,
    /// Direction in which the marker's drawing points up. Valid only with [`HAS_HEADING`].
    pub heading_rad: f64,
    /// Velocity along x, per second.
    pub vx: f64,
    /// Velocity along y, per second.
    pub vy: f64,
    /// Turn rate in rad/s, with the same sign as a heading: that of the marker if its headings
    /// determine it, otherwise that of the direction of motion.
    pub turn_rate_rad_s: f64,
    /// Seconds since the object was first seen.
    pub age_s: f64,
    /// Marker: side of the plate. Obstacle: square root of the outline's area.
    pub size: f64,
    /// How well the recognised marker explains the pixels of its plate: share of their variation, 0
    /// to 1. Noise, low contrast and foreign objects reduce it. 0 if no marker was read in this
    /// frame.
    pub confidence: f64,
    /// Covariance of (x, y, heading), row by row. The row and column of the heading are zero
    /// without [`HAS_HEADING`].
    pub covariance: [[f64; 3]; 3],
    /// Name of the marker; all zero for an obstacle. See [`Object::marker_name`].
    pub marker: [u8; NAME_BYTES],
    /// [`KIND_OBSTACLE`] or [`KIND_MARKER`].
    pub kind: u32,
    /// [`OBSERVED`] and [`HAS_HEADING`].
    pub flags: u32,
    /// Number of valid entries of `outline`.
    pub n_outline: u32,
    /// Number of valid entries of `forecast`.
    pub n_forecast: u32,
    /// Outline of the whole object as (x, y), in order; the first point is not repeated. Empty if
    /// not observed.
    pub outline: [[f64; 2]; MAX_OUTLINE],
    /// Future positions in order of time.
    pub forecast: [ForecastPoint; MAX_FORECAST],
}

/// A forecast for one time.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("overcam.ForecastPoint.v1")]
pub struct ForecastPoint {
    /// Seconds after [`Scene::stamp_ns`].
    pub dt_s: f64,
    /// Expected x.
    pub x: f64,
    /// Expected y.
    pub y: f64,
    /// Covariance of (x, y), row by row.
    pub covariance: [[f64; 2]; 2],
}

impl Scene {
    /// A scene without objects.
    pub const EMPTY: Self = Self {
        sequence: 0,
        stamp_ns: 0,
        published_ns: 0,
        frame: FRAME_IMAGE,
        n_objects: 0,
        n_overflow: 0,
        clock: CLOCK_SOURCE,
        light: LIGHT_STEADY,
        gain: [1.0; 3],
        source: SOURCE_RUNNING,
        frame_age_s: 0.0,
        objects: [Object::EMPTY; MAX_OBJECTS],
    };

    /// The valid objects.
    #[must_use]
    pub fn objects(&self) -> &[Object] {
        &self.objects[..(self.n_objects as usize).min(MAX_OBJECTS)]
    }

    /// Nanoseconds from the exposure to `now_ns`, a reading of `CLOCK_MONOTONIC` on the same
    /// machine.
    ///
    /// If the source has its own clock, the age counts from publication: a file was exposed long
    /// ago, and only the time that the scene took to reach the reader is relevant.
    #[must_use]
    pub fn age_ns(&self, now_ns: u64) -> u64 {
        let since_ns = match self.clock {
            CLOCK_MONOTONIC => self.stamp_ns,
            _ => self.published_ns,
        };
        now_ns.saturating_sub(since_ns)
    }

    /// Position of one of this scene's objects at the time `at_ns` of `CLOCK_MONOTONIC`. For a
    /// planner whose command takes effect after `delay_ns`, that is a reading of the clock plus
    /// `delay_ns`.
    ///
    /// The same as [`Object::pose_at`] with the scene's age ([`Scene::age_ns`]) at that time.
    #[must_use]
    pub fn pose_at(&self, object: &Object, at_ns: u64) -> Pose {
        object.pose_at(self.age_ns(at_ns) as f64 * 1e-9)
    }
}

impl Object {
    /// An object with every field zero.
    pub const EMPTY: Self = Self {
        track: 0,
        x: 0.0,
        y: 0.0,
        heading_rad: 0.0,
        vx: 0.0,
        vy: 0.0,
        turn_rate_rad_s: 0.0,
        age_s: 0.0,
        size: 0.0,
        confidence: 0.0,
        covariance: [[0.0; 3]; 3],
        marker: [0; NAME_BYTES],
        kind: KIND_OBSTACLE,
        flags: 0,
        n_outline: 0,
        n_forecast: 0,
        outline: [[0.0; 2]; MAX_OUTLINE],
        forecast: [ForecastPoint::EMPTY; MAX_FORECAST],
    };

    /// Name of the marker, `None` for an obstacle. A name cut within a character ends before that
    /// character.
    #[must_use]
    pub fn marker_name(&self) -> Option<&str> {
        if self.kind != KIND_MARKER {
            return None;
        }
        let name = self.marker.split(|&byte| byte == 0).next()?;
        let valid = name.utf8_chunks().next().map_or("", |chunk| chunk.valid());
        Some(valid)
    }

    /// Direction of the marker in radians, if it has one.
    #[must_use]
    pub fn heading(&self) -> Option<f64> {
        (self.flags & HAS_HEADING != 0).then_some(self.heading_rad)
    }

    /// Whether the object was seen in this frame.
    #[must_use]
    pub fn observed(&self) -> bool {
        self.flags & OBSERVED != 0
    }

    /// The points of the outline.
    #[must_use]
    pub fn outline(&self) -> &[[f64; 2]] {
        &self.outline[..(self.n_outline as usize).min(MAX_OUTLINE)]
    }

    /// The points of the forecast.
    #[must_use]
    pub fn forecast(&self) -> &[ForecastPoint] {
        &self.forecast[..(self.n_forecast as usize).min(MAX_FORECAST)]
    }
}

/// Pose of an object at one time, in the coordinates of [`Scene::frame`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Expected x.
    pub x: f64,
    /// Expected y.
    pub y: f64,
    /// Expected direction within (-π, π], if there is a marker.
    pub heading_rad: Option<f64>,
    /// Covariance of (x, y), row by row.
    pub covariance: [[f64; 2]; 2],
}

impl Object {
    /// The pose `dt_s` seconds after the scene's exposure: the object's own at 0, then along the
    /// forecast. The heading changes at [`turn_rate_rad_s`](Object::turn_rate_rad_s).
    ///
    /// Between the points of the forecast, the path is a cubic Hermite curve and the covariance is
    /// linear. Its slopes come from the neighbouring points, and from the velocity at the start.
    /// After the last point the object stays there; without a forecast it stays where it is. A
    /// negative or NaN `dt_s` counts as 0.
    #[must_use]
    pub fn pose_at(&self, dt_s: f64) -> Pose {
        let now = ForecastPoint {
            dt_s: 0.0,
            x: self.x,
            y: self.y,
            covariance: [0, 1].map(|i| [self.covariance[i][0], self.covariance[i][1]]),
        };
        let forecast = self.forecast();
        let point = |i: usize| if i == 0 { now } else { forecast[i - 1] };
        let dt_s = dt_s.max(0.0);
        // Index of the first point after this time, where 0 is the present.
        let after = 1 + forecast
            .iter()
            .take_while(|point| point.dt_s <= dt_s)
            .count();
        let (x, y, covariance) = if after > forecast.len() {
            let last = point(forecast.len());
            (last.x, last.y, last.covariance)
        } else {
            let (from, to) = (point(after - 1), point(after));
            let slope = |i: usize| {
                if i == 0 {
                    return [self.vx, self.vy];
                }
                let (before, after) = (point(i - 1), point((i + 1).min(forecast.len())));
                let span_s = after.dt_s - before.dt_s;
                [(after.x - before.x) / span_s, (after.y - before.y) / span_s]
            };
            let (start, end) = (slope(after - 1), slope(after));
            let span_s = to.dt_s - from.dt_s;
            let part = (dt_s - from.dt_s) / span_s;
            let curve = |from: f64, to: f64, start: f64, end: f64| {
                let (start, end) = (start * span_s, end * span_s);
                let (quadratic, cubic) = (
                    3.0 * (to - from) - 2.0 * start - end,
                    start + end - 2.0 * (to - from),
                );
                from + part * (start + part * (quadratic + part * cubic))
            };
            let mut covariance = from.covariance;
            for (row, to) in covariance.iter_mut().zip(to.covariance) {
                for (value, to) in row.iter_mut().zip(to) {
                    *value += part * (to - *value);
                }
            }
            (
                curve(from.x, to.x, start[0], end[0]),
                curve(from.y, to.y, start[1], end[1]),
                covariance,
            )
        };
        Pose {
            x,
            y,
            heading_rad: self
                .heading()
                .map(|heading| within_a_turn(heading + self.turn_rate_rad_s * dt_s)),
            covariance,
        }
    }
}

/// The same direction within (-π, π], for an angle within a few turns of it. NaN if not finite.
fn within_a_turn(mut rad: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    rad %= TAU;
    if rad > PI {
        rad -= TAU;
    } else if rad <= -PI {
        rad += TAU;
    }
    rad
}

impl ForecastPoint {
    /// A point with every field zero.
    pub const EMPTY: Self = Self {
        dt_s: 0.0,
        x: 0.0,
        y: 0.0,
        covariance: [[0.0; 2]; 2],
    };
}

// Programs in other languages rely on this layout, so a change must fail here first.
const _: () = {
    assert!(core::mem::size_of::<ForecastPoint>() == 56);
    assert!(
        core::mem::size_of::<Object>()
            == 8 * 19 + NAME_BYTES + 16 + 16 * MAX_OUTLINE + 56 * MAX_FORECAST
    );
    assert!(core::mem::size_of::<Scene>() == 64 + MAX_OBJECTS * core::mem::size_of::<Object>());
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marker_always_has_a_name_and_an_obstacle_never() {
        let mut object = Object::EMPTY;
        object.marker[..5].copy_from_slice(b"arrow");
        assert_eq!(object.marker_name(), None);
        object.kind = KIND_MARKER;
        assert_eq!(object.marker_name(), Some("arrow"));
        object.marker = [b'x'; NAME_BYTES];
        object.marker[NAME_BYTES - 1] = "\u{e9}".as_bytes()[0]; // the first of two bytes
        assert_eq!(object.marker_name().map(str::len), Some(NAME_BYTES - 1));
        object.marker = [0; NAME_BYTES];
        assert_eq!(object.marker_name(), Some(""));
    }

    #[test]
    fn counts_beyond_the_arrays_are_cut() {
        let mut object = Object::EMPTY;
        object.n_outline = u32::MAX;
        object.n_forecast = u32::MAX;
        assert_eq!(object.outline().len(), MAX_OUTLINE);
        assert_eq!(object.forecast().len(), MAX_FORECAST);
    }

    /// A robot on a circle of radius 2 about the origin, at one radian per second, now at (2, 0),
    /// with a point every tenth of a second.
    fn circling() -> Object {
        let mut robot = Object {
            x: 2.0,
            vy: 2.0,
            turn_rate_rad_s: 1.0,
            heading_rad: 3.0,
            flags: OBSERVED | HAS_HEADING,
            n_forecast: 20,
            ..Object::EMPTY
        };
        for (i, point) in robot.forecast.iter_mut().enumerate() {
            let angle = 0.1 * (i as f64 + 1.0);
            let [x, y] = on_circle(angle);
            *point = ForecastPoint {
                dt_s: angle,
                x,
                y,
                covariance: [[angle, 0.0], [0.0, 2.0 * angle]],
            };
        }
        robot
    }

    /// Series of cosine and sine, since the crate has no maths library.
    fn on_circle(angle: f64) -> [f64; 2] {
        let (mut cosine, mut sine, mut term) = (0.0, 0.0, 1.0);
        for power in 0..30 {
            match power % 4 {
                0 => cosine += term,
                1 => sine += term,
                2 => cosine -= term,
                _ => sine -= term,
            }
            term *= angle / f64::from(power + 1);
        }
        [2.0 * cosine, 2.0 * sine]
    }

    #[test]
    fn a_pose_lies_on_the_curve_through_the_forecast() {
        let robot = circling();
        for dt_s in [0.0, 0.033, 0.1, 0.25, 0.777, 1.85] {
            let pose = robot.pose_at(dt_s);
            let [x, y] = on_circle(dt_s);
            assert!((pose.x - x).abs() < 2e-4, "{dt_s}: {pose:?} {x}");
            assert!((pose.y - y).abs() < 2e-4, "{dt_s}: {pose:?} {y}");
            assert!((pose.covariance[1][1] - 2.0 * dt_s).abs() < 1e-9);
        }
        let [x, _] = on_circle(2.0);
        assert!(
            (robot.pose_at(9.0).x - x).abs() < 1e-9,
            "it stays at the end"
        );
        let heading = robot.pose_at(0.5).heading_rad.expect("a marker");
        assert!((heading - (3.5 - core::f64::consts::TAU)).abs() < 1e-9);
    }

    #[test]
    fn a_pose_without_a_forecast_is_the_present_one() {
        let mut object = Object::EMPTY;
        object.x = 3.0;
        object.vx = 1.0;
        for dt_s in [0.0, 1.0, -1.0, f64::NAN, f64::INFINITY] {
            let pose = object.pose_at(dt_s);
            assert_eq!((pose.x, pose.y, pose.heading_rad), (3.0, 0.0, None));
        }
    }

    #[test]
    fn a_scene_knows_how_old_it_will_be() {
        let robot = circling();
        let mut scene = Scene::EMPTY;
        scene.stamp_ns = 1_000_000_000;
        scene.clock = CLOCK_MONOTONIC;
        assert_eq!(scene.pose_at(&robot, 1_500_000_000), robot.pose_at(0.5));
        assert_eq!(scene.pose_at(&robot, 0), robot.pose_at(0.0));
    }

    #[test]
    fn the_age_counts_from_the_exposure_where_the_clock_allows_it() {
        let mut scene = Scene::EMPTY;
        scene.stamp_ns = 1_000;
        scene.published_ns = 5_000;
        assert_eq!(scene.age_ns(6_000), 1_000);
        scene.clock = CLOCK_MONOTONIC;
        assert_eq!(scene.age_ns(6_000), 5_000);
        assert_eq!(scene.age_ns(500), 0);
    }
}
