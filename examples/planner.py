"""A planner's side of overcam: waits for each scene and prints where every marked robot is, and where it will be half a
second from now, when a command may take effect.

    pip install iceoryx2==0.10.0
    python3 planner.py [NAME [SCENES]]

NAME is that of `overcam --service NAME`; after SCENES scenes it ends. `planner.rs` is the same in Rust.
"""

import sys

import iceoryx2 as iox2

from overcam_scene import HAS_HEADING, KIND_MARKER, Scene, age_s, now_ns, pose_at

DELAY_NS = 500_000_000  # until a command takes effect

def print_robots(scene):
    now = now_ns()
    age_ms = age_s(scene, now) * 1e3
    for robot in scene.objects[: scene.n_objects]:
        if robot.kind != KIND_MARKER or not robot.flags & HAS_HEADING:
            continue  # an obstacle
        x, y, _, _ = pose_at(scene, robot, now + DELAY_NS)
        print(
            f"{scene.sequence} {robot.marker.decode(errors='ignore')}"
            f" x {robot.x:.3f} y {robot.y:.3f} heading {robot.heading_rad:.3f}"
            f" in {DELAY_NS / 1e9:.3f} s x {x:.3f} y {y:.3f} age {age_ms:.3f} ms",
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
