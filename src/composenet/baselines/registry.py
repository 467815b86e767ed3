"""The comparison systems of the benchmark's table: a new one is one entry."""

from __future__ import annotations

from composenet.baselines.anonymous_masks import anonymous_masks
from composenet.baselines.frame_to_frame import FrameToFrame
from composenet.baselines.mask_fusion import MaskFusion
from composenet.baselines.mask_rcnn import mask_rcnn_masks, mask_rcnn_weights
from composenet.baselines.mid_fusion import MidFusion
from composenet.baselines.records import Row
from composenet.baselines.true_masks import true_masks

ROWS: dict[str, Row] = {
    "f2f-gt": Row(FrameToFrame, true_masks, told="true masks, classes and identities"),
    "f2f-mask-rcnn": Row(FrameToFrame, mask_rcnn_masks, weights=mask_rcnn_weights),
    "maskfusion-gt-masks": Row(
        MaskFusion, anonymous_masks, told="true masks and classes, no identities"
    ),
    "maskfusion": Row(MaskFusion, mask_rcnn_masks, weights=mask_rcnn_weights),
    "midfusion-gt-masks": Row(
        MidFusion, anonymous_masks, told="true masks and classes, no identities"
    ),
    "midfusion": Row(MidFusion, mask_rcnn_masks, weights=mask_rcnn_weights),
}
"""By name, in the table's order."""
