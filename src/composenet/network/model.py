"""The whole network: surface voxels to voxel fields, boxes to object fields."""

from __future__ import annotations

from torch import nn

from composenet.config import NetworkConfig, VolumeConfig
from composenet.network.backbone import Backbone
from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.detection_head import DetectionHead, VoxelFields
from composenet.network.object_net import ObjectFields, ObjectNet, Teacher, likeliest_heading
from composenet.network.sparse import build_pyramid
from composenet.records import CLASS_NAMES
from composenet.volume.voxels import FEATURE_NAMES


class ComposeNet(nn.Module):
    """Detector and object network with shared features (paper figure 2)."""

    def __init__(self, network: NetworkConfig, volume: VolumeConfig) -> None:
        super().__init__()
        self.config, self.volume_config = network, volume
        self.backbone = Backbone(len(FEATURE_NAMES), network.backbone_channels)
        self.detection = DetectionHead(self.backbone.c_out, len(CLASS_NAMES))
        self.objects = ObjectNet(self.backbone.c_out, network.object_channels, len(CLASS_NAMES))

    def voxel_fields(self, batch: VolumeBatch) -> VoxelFields:
        """Backbone and detection heads on every surface voxel."""
        levels = build_pyramid(batch.coords, batch.size, len(self.config.backbone_channels))
        return self.detection(self.backbone(batch.features, levels))

    def object_fields(
        self,
        fields: VoxelFields,
        batch: VolumeBatch,
        crops: CropBatch,
        teacher: Teacher = likeliest_heading,
    ) -> ObjectFields:
        """Completion, correspondences, quality and class of every crop.

        fields: of voxel_fields. teacher: which heading the correspondences build on.
        """
        return self.objects(
            fields,
            batch,
            crops,
            self.config.crop_cells,
            self.volume_config.truncation_m,
            self.config.crop_margin,
            teacher,
        )
