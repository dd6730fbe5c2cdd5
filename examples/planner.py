"""A planner's side of overcam: waits for each scene and prints where every marked robot is, and where it will be half a
second later.

    pip install iceoryx2==0.10.0
    python3 planner.py [NAME [SCENES]]

NAME is that of `overcam --service NAME`; after SCENES scenes it ends. `planner.rs` is the same in Rust.
"""

import ctypes
import sys
import time

import iceoryx2 as iox2

# The layout of crates/scene. The type names carry its version: another one is refused, not misread.
f64, u32, u64 = ctypes.c_double, ctypes.c_uint32, ctypes.c_uint64
CLOCK_MONOTONIC = 1  # Scene.clock
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
        ("size", f64),
        ("confidence", f64),
        ("covariance", f64 * 3 * 3),
        ("marker", ctypes.c_char * 32),
        ("kind", u32),
        ("flags", u32),
        ("n_outline", u32),
        ("n_forecast", u32),
        ("outline", f64 * 2 * 64),
        ("forecast", ForecastPoint * 15),
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
        ("objects", Object * 64),
    ]

    @staticmethod
    def type_name() -> str:
        return "overcam.Scene.v3"


def print_robots(scene):
    since_ns = scene.stamp_ns if scene.clock == CLOCK_MONOTONIC else scene.published_ns
    age_ms = (time.clock_gettime_ns(time.CLOCK_MONOTONIC) - since_ns) / 1e6
    for robot in scene.objects[: scene.n_objects]:
        if robot.kind != KIND_MARKER or not robot.flags & HAS_HEADING:
            continue  # an obstacle
        # The forecast nearest to half a second; a robot without one is taken to stay.
        forecast = robot.forecast[: robot.n_forecast]
        ahead = min(forecast, key=lambda point: abs(point.dt_s - 0.5), default=None)
        dt, x, y = (ahead.dt_s, ahead.x, ahead.y) if ahead else (0.0, robot.x, robot.y)
        print(
            f"{scene.sequence} {robot.marker.decode(errors='ignore')}"
            f" x {robot.x:.3f} y {robot.y:.3f} heading {robot.heading_rad:.3f}"
            f" in {dt:.3f} s x {x:.3f} y {y:.3f} age {age_ms:.3f} ms",
            flush=True,
        )


def subscribe(node, name):
    """Waits until overcam runs; returns a subscriber and the listener that is woken for it."""
    while True:
        try:
            scenes = node.service_builder(name).publish_subscribe(Scene).open()
            wakeups = node.service_builder(name).event().open()
        except (iox2.PublishSubscribeOpenError, iox2.EventOpenError) as error:
            if "DoesNotExist" not in str(error):
                raise
            node.wait(iox2.Duration.from_millis(100))
            continue
        listener = wakeups.listener_builder().create()
        # The newest scene is enough: a planner that comes late has no use for those it missed.
        return scenes.subscriber_builder().buffer_size(1).create(), listener


def main():
    service = sys.argv[1] if len(sys.argv) > 1 else "overcam"
    remaining = int(sys.argv[2]) if len(sys.argv) > 2 else sys.maxsize
    iox2.set_log_level(iox2.LogLevel.Fatal)
    node = iox2.NodeBuilder.new().config(iox2.config.default()).create(iox2.ServiceType.Ipc)
    try:
        subscriber, listener = subscribe(node, iox2.ServiceName.new(f"{service}/scene"))
        while remaining > 0:
            node.wait(iox2.Duration.from_millis(0))
            while (sample := subscriber.receive()) is not None:
                print_robots(sample.payload().contents)
                sample.delete()
                remaining -= 1
            listener.timed_wait(iox2.Duration.from_secs(1))
    except (iox2.NodeWaitFailure, iox2.ListenerWaitError) as error:
        if str(error) not in ("Interrupt", "TerminationRequest", "InterruptSignal"):
            raise  # else: Ctrl-C; everything in shared memory is given back


if __name__ == "__main__":
    main()
