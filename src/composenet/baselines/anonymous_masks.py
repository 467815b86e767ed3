"""True masks and classes of a generated sequence, without saying who is who."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from composenet.baselines.records import InstanceMasks
from composenet.baselines.true_masks import TrueMasks
from composenet.records import Frame


class AnonymousMasks:
    """`TrueMasks` less the identities. Raises DataError."""

    def __init__(self, folder: Path) -> None:
        self._source = TrueMasks(folder)

    def __call__(self, frame: Frame) -> InstanceMasks:
        return replace(self._source(frame), gt_ids=None)


def anonymous_masks(folder: Path, _device: str) -> AnonymousMasks:
    """For a row: no network, so no device."""
    return AnonymousMasks(folder)
