"""Any RGB-D recording as levelled frames: `open_sequence`."""

from composenet.sequences.leveling import level_camera
from composenet.sequences.odometry import Odometry
from composenet.sequences.options import SequenceOptions
from composenet.sequences.recording import RecordedSequence, open_sequence

__all__ = ["Odometry", "RecordedSequence", "SequenceOptions", "level_camera", "open_sequence"]
