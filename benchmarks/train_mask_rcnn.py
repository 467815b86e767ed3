"""Train the Mask R-CNN of the comparison systems on rendered frames of the train split.

python benchmarks/train_mask_rcnn.py --out runs/mask_rcnn --max-minutes 60 [--resume]

Stops at --max-minutes or ctrl-C with weights written; the rate falls to zero at the run's end.
Every further run with --resume takes it up again. Needs `pip install 'composenet[baselines]'`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import tyro

from composenet.baselines.mask_rcnn import NAME
from composenet.errors import ComposenetError


def main(
    out: Path,
    max_minutes: float = 60.0,
    max_steps: int | None = None,
    batch_frames: int = 2,
    learning_rate: float = 1e-3,
    workers: int = 1,
    threads: int | None = None,
    device: str = "auto",
    seed: int = 0,
    resume: bool = False,
    image_size: tuple[int, int] = (320, 240),
) -> None:
    """Write checkpoint, log and weights to a folder.

    Args:
        out: folder of the run.
        max_minutes: the run ends after so long.
        max_steps: or after so many steps.
        batch_frames: images a step.
        learning_rate: its peak.
        workers: processes that render frames.
        threads: of torch.
        device: auto, cpu, cuda or cuda:N.
        seed: of the first weights and of the order of frames.
        resume: go on from the checkpoint in the folder.
        image_size: width and height of the rendered frames.
    """
    try:
        from composenet.baselines.mask_rcnn_network import MaskRcnnConfig
        from composenet.baselines.mask_rcnn_training import TrainingOptions, train
        from composenet.synth.scene import SceneOptions

        options = TrainingOptions(
            out, max_minutes, max_steps, batch_frames, learning_rate, workers, threads, device,
            seed, resume,
        )  # fmt: skip
        path = train(MaskRcnnConfig(), options, SceneOptions(image_size=image_size))
    except ComposenetError as error:
        sys.exit(f"train_mask_rcnn: {error}")
    print(f"wrote {path}; to use it, copy it to src/composenet/weights/{NAME}")


if __name__ == "__main__":
    tyro.cli(main)
