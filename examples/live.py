"""Track what a camera sees while it sees it: one thread follows the camera, the other tracks the
newest image.

python examples/live.py                  # an Intel RealSense: pip install pyrealsense2
python examples/live.py RECORDING        # a recording, played as if it were a camera

Both need `pip install -e '.[odometry]'`. Where poses come from elsewhere (SLAM, a robot's arm),
put them in the place of `odometry(...)`, in a world whose z is up and whose floor is at 0.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

import composenet
from composenet.geometry.camera import subsample_camera, subsampled
from composenet.records import FloatArray, TrackedObject

LOST_S = 10.0
"""After so long without a pose the camera's way begins anew, in a world of its own. Until then it
may see what it saw before, as when a hand that covered it is gone."""


@dataclass(frozen=True)
class Image:
    """What a camera gives. depth_m: (H, W) float32 metres, 0 = nothing measured. color: (H, W, 3)
    uint8 RGB, or None. time_s: when it came, by this machine's clock."""

    depth_m: FloatArray
    color: np.ndarray | None
    camera: composenet.Camera
    time_s: float


@dataclass(frozen=True)
class Seen:
    """An image and where its camera was, in the world number `world`."""

    image: Image
    T_world_camera: FloatArray
    world: int


class Newest:
    """A place for one thing: what is put there replaces what nobody took."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._seen: Seen | None = None
        self._ended = False
        self._error: Exception | None = None

    def put(self, seen: Seen) -> None:
        with self._changed:
            self._seen = seen
            self._changed.notify()

    def end(self, error: Exception | None = None) -> None:
        """Nothing comes any more, by this error if there is one."""
        with self._changed:
            self._ended, self._error = True, error
            self._changed.notify()

    def take(self) -> Seen | None:
        """Waits until there is one; None after the end. Raises what ended it."""
        with self._changed:
            while self._seen is None and not self._ended:
                self._changed.wait(0.2)  # wakes now and then, so that ctrl-C is heard
            seen, self._seen = self._seen, None
            if seen is None and self._error is not None:
                raise self._error
            return seen


def realsense() -> Generator[Image]:
    """Depth aligned to colour, half of 640 x 480, from the first camera that is found."""
    import pyrealsense2 as rs

    pipeline, config = rs.pipeline(), rs.config()
    config.enable_stream(rs.stream.depth, 640, 480, rs.format.z16, 30)
    config.enable_stream(rs.stream.color, 640, 480, rs.format.rgb8, 30)
    profile = pipeline.start(config)
    try:
        unit_m = profile.get_device().first_depth_sensor().get_depth_scale()
        lens = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        K = np.array([[lens.fx, 0, lens.ppx], [0, lens.fy, lens.ppy], [0, 0, 1]])
        camera = subsample_camera(composenet.Camera(K, lens.width, lens.height), 2)
        align = rs.align(rs.stream.color)
        while True:
            frames = align.process(pipeline.wait_for_frames())
            seen = frames.get_depth_frame(), frames.get_color_frame()
            if not all(seen):  # the first ones may lack one of the two
                continue
            depth, color = (np.asanyarray(frame.get_data()) for frame in seen)
            depth_m = subsampled(depth, 2).astype(np.float32) * np.float32(unit_m)
            yield Image(depth_m, subsampled(color, 2).copy(), camera, time.monotonic())
    finally:
        pipeline.stop()


def played(recording: Path, rate_hz: float) -> Generator[Image]:
    """A recording's images when they would come from a camera, which waits for nobody; its poses
    are not used."""
    sequence = composenet.open_sequence(recording)
    start = time.monotonic()
    for count, frame in enumerate(sequence):
        ahead_s = start + count / rate_hz - time.monotonic()
        if ahead_s < -1 / rate_hz:
            continue
        time.sleep(max(0.0, ahead_s))
        yield Image(frame.depth_m, frame.color, frame.camera, time.monotonic())


def follow(images: Generator[Image], newest: Newest, stop: threading.Event) -> None:
    """Find the camera in every image that there is time for, and leave the newest to the
    tracker."""
    try:
        odometry, world, found_s = composenet.Odometry(), 0, time.monotonic()
        with contextlib.closing(images):  # lets go of the camera
            for image in images:
                if stop.is_set():
                    break
                T_world_camera = odometry(image.depth_m, image.camera, image.color)
                if T_world_camera is not None:
                    newest.put(Seen(image, T_world_camera, world))
                    found_s = image.time_s
                elif image.time_s - found_s > LOST_S:
                    odometry, world, found_s = composenet.Odometry(), world + 1, image.time_s
    except Exception as error:  # a camera's library raises what it likes
        newest.end(error)
    else:
        newest.end()


def publish(things: Sequence[TrackedObject], world: int, count: int, delay_s: float) -> None:
    """What a robot would be told: replace it by yours. What is not among these any more is to be
    deleted where it is shown; in another world ids and places begin anew."""
    print(f"world {world}, frame {count}, {delay_s * 1e3:.0f} ms after its image:")
    for thing in things:
        x, y, z = thing.T_world_object[:3, 3]
        print(
            f"  {thing.track_id:3d} {thing.class_name:10s} {thing.state.value:9s}"
            f" at {x:6.2f} {y:6.2f} {z:6.2f} m, confidence {thing.confidence:.2f}"
        )


def main(
    recording: Annotated[Path | None, tyro.conf.Positional] = None,
    rate_hz: float = 10.0,
    device: str = "auto",
) -> None:
    """Track a live camera. recording: played instead of one, at rate_hz."""
    eyes = composenet.load_tracker(device=device)
    images = played(recording, rate_hz) if recording else realsense()
    newest, stop = Newest(), threading.Event()
    thread = threading.Thread(target=follow, args=(images, newest, stop), daemon=True)
    thread.start()
    tracker, world, count = eyes, 0, 0
    try:
        while (seen := newest.take()) is not None:
            if seen.world != world:  # places of another world mean nothing here
                tracker, world, count = eyes.restart(), seen.world, 0
            image = seen.image
            try:
                frame = composenet.Frame(
                    count, image.depth_m, image.camera, seen.T_world_camera, image.color
                )
                things = tracker(frame).objects
            except composenet.SequenceError as error:  # the tracker is as it was
                print(f"left out: {error}")
                continue
            publish(things, seen.world, count, time.monotonic() - image.time_s)
            count += 1
    except KeyboardInterrupt:
        print("stopped")
    finally:
        stop.set()
        thread.join(6.0)  # a camera that gives no image keeps its library waiting for five


if __name__ == "__main__":
    try:
        tyro.cli(main)
    # ImportError, RuntimeError: no pyrealsense2, or no such camera.
    except (composenet.ComposenetError, ImportError, RuntimeError) as error:
        sys.exit(f"live: {error}")
