"""The comparison systems of the benchmark's table: a new one is one entry."""

from __future__ import annotations

from composenet.baselines.frame_to_frame import FrameToFrame
from composenet.baselines.records import Row
from composenet.baselines.true_masks import TrueMasks

ROWS: dict[str, Row] = {
    "f2f-gt": Row(FrameToFrame, TrueMasks, told="true masks, classes and identities"),
}
"""By name, in the table's order."""
