"""A planner's side of overcam: waits for each scene and prints where every marked robot is, and where it will be half a
second from now, when a command may take effect.

    pip install iceoryx2==0.10.0
    python3 planner.py [NAME [SCENES]]

NAME is that of `overcam --service NAME`; after SCENES scenes it ends. Where overcam runs with `--group GROUP`, set
OVERCAM_GROUP=GROUP. `planner.rs` is the same in Rust.
"""

import sys

import iceoryx2 as iox2

from overcam_scene import HAS_HEADING, KIND_MARKER, Scene, admit, age_s, config, newest, now_ns, pose_at

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


class Subscription:
    """What is open in shared memory."""

    def __init__(self, name):
        """Waits until overcam runs."""
        while True:
            try:
                self.config = config(name)
            except FileNotFoundError:
                self.config = iox2.config.default()  # overcam --group has not run yet
            self.node = iox2.NodeBuilder.new().config(self.config).create(iox2.ServiceType.Ipc)
            try:
                service = self.node.service_builder(iox2.ServiceName.new(name))
                self.scenes = service.publish_subscribe(Scene).open()
                wakeups = self.node.service_builder(iox2.ServiceName.new(name)).event().open()
                break
            except (iox2.PublishSubscribeOpenError, iox2.EventOpenError) as error:
                if "DoesNotExist" not in str(error):
                    raise
                self.node.wait(iox2.Duration.from_millis(100))
        self.opened = newest(self.config, self.scenes)
        self.listener = wakeups.listener_builder().create()
        # The newest scene is enough: a planner that comes late has no use for those it missed.
        self.subscriber = self.scenes.subscriber_builder().buffer_size(1).create()
        admit(self.config)  # lets overcam reach them, should it run as another user of the group

    def was_removed(self):
        return newest(self.config, self.scenes) != self.opened

    def scenes_until_removed(self):
        while True:
            self.node.wait(iox2.Duration.from_millis(0))  # ends with Ctrl-C
            heard = False
            while (sample := self.subscriber.receive()) is not None:
                yield sample.payload().contents
                sample.delete()
                heard = True
            if not self.listener.timed_wait(iox2.Duration.from_secs(1)) and not heard and self.was_removed():
                return


def main():
    service = sys.argv[1] if len(sys.argv) > 1 else "overcam"
    remaining = int(sys.argv[2]) if len(sys.argv) > 2 else sys.maxsize
    iox2.set_log_level(iox2.LogLevel.Fatal)
    try:
        while remaining > 0:
            for scene in Subscription(f"{service}/scene").scenes_until_removed():
                print_robots(scene)
                remaining -= 1
                if remaining <= 0:
                    break
    except (iox2.NodeWaitFailure, iox2.ListenerWaitError) as error:
        if str(error) not in ("Interrupt", "TerminationRequest", "InterruptSignal"):
            raise  # else: Ctrl-C; everything in shared memory is given back


if __name__ == "__main__":
    main()
