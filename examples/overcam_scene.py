"""What overcam publishes, for subscribers in Python: the layout of crates/scene, and where an object is at a chosen moment.

    from overcam_scene import Scene, pose_at

`planner.py` shows how to subscribe.
"""

import ctypes
import glob
import math
import os
import stat
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


# Where overcam publishes: what the Rust crate `scene` has in the functions of the same names. A planner of the very user who runs
# overcam can do with `iox2.config.default()`.


def config(name):
    """The configuration with which the service `name` ("overcam/scene") is found now; to be asked for anew while waiting for it.

    With the environment variable OVERCAM_GROUP it is that of `overcam --group`. Raises FileNotFoundError until overcam has run with
    that group, and PermissionError for whoever is not a member.
    """
    import iceoryx2 as iox2

    def configured(root, prefix):
        configuration = iox2.config.default()
        configuration.global_cfg.root_path = iox2.Path.new(root)
        configuration.global_cfg.prefix = iox2.FileName.new(prefix)
        return configuration

    def exists(configuration):
        pattern = iox2.MessagingPattern.PublishSubscribe
        return iox2.Service.does_exist(iox2.ServiceName.new(name), configuration, pattern, iox2.ServiceType.Ipc)

    group = os.environ.get("OVERCAM_GROUP")
    if group:
        root = f"/dev/shm/overcam-{group}"
        found = os.lstat(root)
        if not stat.S_ISDIR(found.st_mode) or found.st_mode & 0o007:
            raise PermissionError(f"{root} is no directory of a group")
        os.listdir(root)
        digest = 0x811C9DC5  # FNV-1a
        for byte in group.encode():
            digest = (digest ^ byte) * 0x01000193 & 0xFFFFFFFF
        return configured(root, f"ovc{digest:08x}_")
    default = iox2.config.default()
    # Where overcam publishes if another user's files are in the way of the first place.
    own = configured(f"/dev/shm/overcam.{os.getuid()}", f"ovu{os.getuid()}_")
    try:
        if exists(own):
            return own
        exists(default)  # raises where it is another user's
        return default
    except iox2.ServiceDetailsError:
        return own


def admit(config):
    """Lets an overcam of another user of the group reach what this user has opened; to be called when the ports are made."""
    settings = config.global_cfg
    root, prefix = settings.root_path.to_string().rstrip("/"), settings.prefix.to_string()
    if not root.startswith("/dev/shm/overcam-"):
        return
    gid = os.stat(root).st_gid
    files = glob.glob(f"/dev/shm/{prefix}*") + glob.glob(f"{root}/{prefix}*")
    # After the files: a port has its tag before its connections.
    tags = glob.glob(f"{root}/nodes/*/*.port_tag")
    ports = {tag.removesuffix(".port_tag").rsplit("_", 1)[1] for tag in tags}
    for path in files:
        try:
            found = os.lstat(path)
            if found.st_uid != os.getuid() or not (stat.S_ISREG(found.st_mode) or stat.S_ISSOCK(found.st_mode)):
                continue
            if path.endswith(".connection") and path.rsplit("_", 1)[1].removesuffix(".connection") not in ports:
                os.unlink(path)  # of a planner that has ended; only its owner can remove it
            elif stat.S_IMODE(found.st_mode) == 0o600:
                os.chown(path, -1, gid)
                os.chmod(path, 0o660)
        except FileNotFoundError:
            pass


def newest(config, service):
    """Tells the service that newcomers find from others of its name, None if there is none.

    When it is no longer what it was when the service was opened, the files were removed, and the service is to be opened again.
    """
    settings = config.global_cfg
    file = f"{settings.prefix.to_string()}{service.service_hash.as_str}.service"
    try:
        with open(f"{settings.service_dir.to_string()}/{file}", "rb") as description:
            return description.read()
    except FileNotFoundError:
        return None
