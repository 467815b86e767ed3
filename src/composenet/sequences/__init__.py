"""Any RGB-D recording as levelled frames: `open_sequence`."""

from composenet.sequences.odometry import Odometry
from composenet.sequences.options import SequenceOptions
from composenet.sequences.recording import RecordedSequence, open_sequence

__all__ = ["Odometry", "RecordedSequence", "SequenceOptions", "open_sequence"]
