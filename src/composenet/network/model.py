"""The whole network: surface voxels to voxel fields, boxes to object fields."""

from __future__ import annotations

from torch import Tensor, nn

from composenet.config import NetworkConfig, VolumeConfig
from composenet.errors import ConfigError
from composenet.network.backbone import Backbone
from composenet.network.batch import CropBatch, VolumeBatch
from composenet.network.box_head import BoxFields, BoxHead
from composenet.network.detection_head import DetectionHead, VoxelFields
from composenet.network.object_net import ObjectFields, ObjectNet, Teacher, likeliest_heading
from composenet.network.sparse import build_pyramid
from composenet.records import CLASS_NAMES
from composenet.volume.voxels import FEATURE_NAMES


class ComposeNet(nn.Module):
    """Detector and object network with shared features (paper figure 2)."""

    def __init__(self, network: NetworkConfig, volume: VolumeConfig) -> None:
        super().__init__()
        if len(network.backbone_blocks) != len(network.backbone_channels):
            raise ConfigError(
                "configuration: backbone_blocks and backbone_channels need one entry a stride each"
            )
        self.config, self.volume_config = network, volume
        self.backbone = Backbone(
            len(FEATURE_NAMES), network.backbone_channels, network.backbone_blocks
        )
        self.detection = DetectionHead(self.backbone.c_out, len(CLASS_NAMES))
        self.boxes = BoxHead(self.backbone.c_out, len(CLASS_NAMES))
        self.objects = ObjectNet(self.backbone.c_out, network.object_channels, len(CLASS_NAMES))

    def voxel_fields(self, batch: VolumeBatch) -> VoxelFields:
        """Backbone and detection heads on every surface voxel."""
        levels = build_pyramid(batch.coords, batch.size, len(self.config.backbone_channels))
        return self.detection(self.backbone(batch.features, levels))

    def box_fields(
        self,
        fields: VoxelFields,
        batch: VolumeBatch,
        center: Tensor,
        extents: Tensor,
        frame: Tensor,
    ) -> BoxFields:
        """A second look at boxes. center, extents: (M, 3) metres, grid frame. frame: (M,) int64."""
        truncation_m = self.volume_config.truncation_m
        return self.boxes(fields, batch, center, extents, frame, truncation_m)

    def object_fields(
        self,
        fields: VoxelFields,
        batch: VolumeBatch,
        crops: CropBatch,
        classes: Tensor,
        teacher: Teacher = likeliest_heading,
    ) -> ObjectFields:
        """Completion and correspondences of every crop.

        fields: of voxel_fields. classes: (M, n_classes) probabilities. teacher: which heading the
        correspondences build on.
        """
        return self.objects(
            fields,
            batch,
            crops,
            classes,
            self.config.crop_cells,
            self.volume_config.truncation_m,
            self.config.crop_margin,
            teacher,
        )
