"""ComPoseNet: completed, posed and tracked objects from RGB-D video.

>>> import composenet
>>> tracker = composenet.load_tracker()
>>> for frame in composenet.open_sequence("recording"):
...     for thing in tracker(frame).objects:
...         print(thing.track_id, thing.class_name, thing.state, thing.box.center)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from composenet.compiled import keep_compiled_loops

__version__ = "0.1.0"

keep_compiled_loops()

if TYPE_CHECKING:
    from composenet.errors import ComposenetError, DataError, SequenceError
    from composenet.output import OutputWriter, read_predictions
    from composenet.pipeline import ObjectTracker, load_tracker
    from composenet.records import CLASS_NAMES, Camera, Frame, TrackState
    from composenet.sequences import (
        Odometry,
        SequenceOptions,
        level_camera,
        open_sequence,
    )
    from composenet.view.meshes import object_mesh, track_mesh

_MODULES = {
    "CLASS_NAMES": "records",
    "Camera": "records",
    "ComposenetError": "errors",
    "DataError": "errors",
    "Frame": "records",
    "ObjectTracker": "pipeline",
    "Odometry": "sequences",
    "OutputWriter": "output",
    "SequenceError": "errors",
    "SequenceOptions": "sequences",
    "TrackState": "records",
    "level_camera": "sequences",
    "load_tracker": "pipeline",
    "object_mesh": "view.meshes",
    "open_sequence": "sequences",
    "read_predictions": "output",
    "track_mesh": "view.meshes",
}

__all__ = [
    "CLASS_NAMES",
    "Camera",
    "ComposenetError",
    "DataError",
    "Frame",
    "ObjectTracker",
    "Odometry",
    "OutputWriter",
    "SequenceError",
    "SequenceOptions",
    "TrackState",
    "level_camera",
    "load_tracker",
    "object_mesh",
    "open_sequence",
    "read_predictions",
    "track_mesh",
]


def __getattr__(name: str) -> Any:
    """Import on first use, so that `import composenet` and `--help` stay instant."""
    if name not in _MODULES:
        raise AttributeError(f"module 'composenet' has no attribute {name!r}")
    return getattr(import_module(f"composenet.{_MODULES[name]}"), name)
