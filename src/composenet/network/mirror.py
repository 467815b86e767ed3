"""The scene and its mirror image, looked at alike and averaged.

Furniture and rooms are as likely as their mirror images, so what the network says of one must hold
for the other; where the two differ, their mean errs less. Costs a second pass of the backbone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from composenet.network.batch import VolumeBatch
from composenet.network.box_head import BoxFields
from composenet.network.detection_head import VoxelFields
from composenet.network.model import ComposeNet
from composenet.volume.memory import FREE_CELL_M
from composenet.volume.voxels import FEATURE_NAMES

_SIDEWAYS = ("offset_y", "normal_y", "view_y")
_SIGNS = [-1.0 if name in _SIDEWAYS else 1.0 for name in FEATURE_NAMES]
"""of a voxel's features in the mirror image"""


@dataclass(frozen=True)
class Mirror:
    """The mirror image of a batch across its grid's y axis, with its voxel fields.

    batch: the same rows with y turned round; its T_camera_grid leads from the image's points to
    where the scene's camera sees them (so it is no rotation), depth_m and K stay. width_m: y of a
    point and of its image add up to this.
    """

    batch: VolumeBatch
    fields: VoxelFields
    width_m: float

    @staticmethod
    def of(network: ComposeNet, batch: VolumeBatch) -> Mirror:
        """Looks at the mirror image."""
        coords = batch.coords.clone()
        last = int(coords[:, 2].max())
        coords[:, 2] = last - coords[:, 2]
        features = batch.features * batch.features.new_tensor(_SIGNS)
        width_m = last * batch.voxel_size_m
        T_grid_image = torch.diag(batch.T_camera_grid.new_tensor([1.0, -1.0, 1.0, 1.0]))
        T_grid_image[1, 3] = width_m
        T_camera_image = batch.T_camera_grid @ T_grid_image
        free_low = batch.free_low.clone()
        free_low[:, 1] = width_m - free_low[:, 1] - batch.free.shape[2] * FREE_CELL_M
        image = replace(
            batch, coords=coords, features=features, T_camera_grid=T_camera_image,
            free=batch.free.flip(2), free_low=free_low,
        )  # fmt: skip
        return Mirror(image, network.voxel_fields(image), width_m)

    def agreed(self, fields: VoxelFields) -> tuple[VoxelFields, Mirror]:
        """Fields of the scene and of its image, each with its own features and with what both
        say on average of objectness, centre, extents and class."""
        own = replace(
            self.fields,
            objectness=(fields.objectness + self.fields.objectness) / 2,
            center_offset=(_turned(fields.center_offset) + self.fields.center_offset) / 2,
            extents=(fields.extents + self.fields.extents) / 2,
            class_logits=(fields.class_logits + self.fields.class_logits) / 2,
        )
        scene = replace(own, features=fields.features, center_offset=_turned(own.center_offset))
        return scene, replace(self, fields=own)

    def box_fields(
        self, network: ComposeNet, center: Tensor, extents: Tensor, frame: Tensor
    ) -> BoxFields:
        """A second look at the images of boxes of the scene; answers in the scene."""
        seen = network.box_fields(self.fields, self.batch, self._image(center), extents, frame)
        return replace(seen, center=self._image(seen.center))

    def _image(self, points: Tensor) -> Tensor:
        """(M, 3) points -> their images."""
        turned = _turned(points)
        turned[:, 1] += self.width_m
        return turned


def mean_boxes(one: BoxFields, other: BoxFields) -> BoxFields:
    """What two looks at the same boxes say on average."""
    pairs = zip(vars(one).values(), vars(other).values(), strict=True)
    return BoxFields(*(torch.stack(pair).mean(dim=0) for pair in pairs))


def _turned(vectors: Tensor) -> Tensor:
    """(N, 3) vectors with y turned round."""
    return vectors * vectors.new_tensor([1.0, -1.0, 1.0])
