"""What overcam publishes, for subscribers in Python: the layout of crates/scene, and where an object is at a chosen moment.

    from overcam_scene import Scene, pose_at

`planner.py` shows how to subscribe.
"""

import ctypes
import math
import time

# The layout of crates/scene. The type names carry its version: another one is refused, not misread.
f64, u32, u64 = ctypes.c_double, ctypes.c_uint32, ctypes.c_uint64
CLOCK_MONOTONIC = 1  # Scene.clock
SOURCE_WAITING = 1  # Scene.source
KIND_MARKER = 1  # Object.kind
HAS_HEADING = 2  # bit of Object.flags


class ForecastPoint(ctypes.Structure):
    _fields_ = [("dt_s", f64), ("x", f64), ("y", f64), ("covariance", f64 * 2 * 2)]


class Object(ctypes.Structure):
    _fields_ = [
        ("track", u64),
        ("x", f64),
        ("y", f64),
        ("heading_rad", f64),
        ("vx", f64),
        ("vy", f64),
        ("turn_rate_rad_s", f64),
        ("age_s", f64),
        ("size", f64),
        ("confidence", f64),
        ("covariance", f64 * 3 * 3),
        ("marker", ctypes.c_char * 32),
        ("kind", u32),
        ("flags", u32),
        ("n_outline", u32),
        ("n_forecast", u32),
        ("outline", f64 * 2 * 64),
        ("forecast", ForecastPoint * 20),
    ]


class Scene(ctypes.Structure):
    _fields_ = [
        ("sequence", u64),
        ("stamp_ns", u64),
        ("published_ns", u64),
        ("frame", u32),
        ("n_objects", u32),
        ("n_overflow", u32),
        ("clock", u32),
        ("light", u32),
        ("gain", ctypes.c_float * 3),
        ("source", u32),
        ("frame_age_s", ctypes.c_float),
        ("objects", Object * 64),
    ]

    @staticmethod
    def type_name() -> str:
        return "overcam.Scene.v5"


def now_ns():
    """Reading of the clock that `pose_at` counts in."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


def age_s(scene, at_ns):
    """Seconds from the scene's exposure to the moment `at_ns`; from its publication where the source has its own clock."""
    since_ns = scene.stamp_ns if scene.clock == CLOCK_MONOTONIC else scene.published_ns
    return max(at_ns - since_ns, 0) * 1e-9


def pose_at(scene, thing, at_ns):
    """Where one of the scene's objects is at the moment `at_ns` of CLOCK_MONOTONIC: (x, y, heading_rad or None, covariance).

    For a planner whose command takes effect after `delay_ns`, that is `now_ns() + delay_ns`. The object's own pose at the
    exposure, then along the forecast: a cubic curve between its points (Hermite's, with the slopes of the neighbouring points, at
    the start that of the velocity), the covariance of (x, y) linear. After the last point it stays there; an object without
    forecast stays where it is. The heading turns on at `turn_rate_rad_s`. Coordinates as in `Scene.frame`. The same as
    `Scene::pose_at` of the Rust crate `scene`.
    """
    dt_s = age_s(scene, at_ns)
    forecast = thing.forecast[: min(thing.n_forecast, len(thing.forecast))]
    now = [[thing.covariance[i][j] for j in (0, 1)] for i in (0, 1)]
    points = [(0.0, (thing.x, thing.y), now)] + [
        (point.dt_s, (point.x, point.y), [list(row) for row in point.covariance]) for point in forecast
    ]
    heading = None
    if thing.flags & HAS_HEADING:
        heading = math.remainder(thing.heading_rad + thing.turn_rate_rad_s * dt_s, math.tau)
    after = 1 + sum(point.dt_s <= dt_s for point in forecast)
    if after == len(points):
        _, (x, y), covariance = points[-1]
        return x, y, heading, covariance

    def slope(i):
        if i == 0:
            return thing.vx, thing.vy
        (t0, a, _), (t1, b, _) = points[i - 1], points[min(i + 1, len(points) - 1)]
        return tuple((end - start) / (t1 - t0) for start, end in zip(a, b))

    (t0, start, from_covariance), (t1, end, to_covariance) = points[after - 1], points[after]
    span, part = t1 - t0, (dt_s - t0) / (t1 - t0)

    def curve(a, b, slope_a, slope_b):
        u, v = slope_a * span, slope_b * span
        return a + part * (u + part * (3 * (b - a) - 2 * u - v + part * (u + v - 2 * (b - a))))

    x, y = (curve(*axis) for axis in zip(start, end, slope(after - 1), slope(after)))
    covariance = [
        [a + part * (b - a) for a, b in zip(*rows)] for rows in zip(from_covariance, to_covariance)
    ]
    return x, y, heading, covariance
