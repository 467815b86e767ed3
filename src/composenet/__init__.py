"""ComPoseNet: completed, posed and tracked objects from RGB-D video.

>>> import composenet
>>> tracker = composenet.load_tracker()
>>> for frame in composenet.open_sequence("recording"):
...     for thing in tracker(frame).objects:
...         print(thing.track_id, thing.state, thing.box.center)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from composenet.compiled import keep_compiled_loops

__version__ = "0.1.0"

keep_compiled_loops()

if TYPE_CHECKING:
    from composenet.pipeline import ObjectTracker, load_tracker
    from composenet.records import Camera, Frame
    from composenet.sequences import Odometry, level_camera, open_sequence

__all__ = [
    "Camera",
    "Frame",
    "ObjectTracker",
    "Odometry",
    "level_camera",
    "load_tracker",
    "open_sequence",
]


def __getattr__(name: str) -> Any:
    """Import on first use, so that `import composenet` and `--help` stay instant."""
    if name in ("Odometry", "level_camera", "open_sequence"):
        from composenet import sequences

        return getattr(sequences, name)
    if name in ("Camera", "Frame"):
        from composenet import records

        return getattr(records, name)
    if name in ("ObjectTracker", "load_tracker"):
        from composenet import pipeline

        return getattr(pipeline, name)
    raise AttributeError(f"module 'composenet' has no attribute {name!r}")
