"""The `composenet` program: parses and calls. Bad input gives one line and exit code 2."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from composenet.errors import ComposenetError
from composenet.sequences.options import SequenceOptions

Variant = Literal["full", "no-compl", "no-corr", "no-corr-no-compl"]
Split = Literal["train", "val", "test"]
Recording = Annotated[Path, tyro.conf.Positional]


@dataclass(frozen=True)
class Demo:
    """Generate a sequence, track it with the shipped weights and score the result."""

    out: Path = Path("demo_out")
    """folder for everything the demo makes"""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N"""
    frames: int = 30
    """length of the sequence"""
    weights: Path | None = None
    """weights to use instead of the shipped ones"""

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.demo import run_demo

        return run_demo(self.out, device=self.device, frames=self.frames, weights=self.weights)


@dataclass(frozen=True)
class Synth:
    """Write generated sequences with ground truth, or print how hard they are."""

    out: Path | None = None
    """folder for the sequences"""
    split: Split = "train"
    """the splits never share a scene"""
    count: int = 1
    """number of sequences"""
    start: int = 0
    """index of the first"""
    cad: Path | None = None
    """folder CLASS/*.{obj,ply,off,stl,glb} of meshes to mix in (+Y up, +Z front, metres)"""
    cad_share: float = 0.5
    """share of the furniture taken from --cad; 1 takes all of it"""
    image_size: tuple[int, int] = (320, 240)
    """width and height, pixels"""
    frames: int = 30
    """frames a sequence"""
    stats: bool = False
    """print the table of difficulty of the sequences"""
    workers: int = 1
    """processes"""

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.synth import run_synth

        options = dict(vars(self))
        return run_synth(options.pop("out"), **options)


@dataclass(frozen=True)
class Train:
    """Train on generated scenes (or on --data); continues from --out if a checkpoint is there."""

    out: Path
    """folder for checkpoint.pt, weights.safetensors and logs"""
    config: Path | None = None
    """JSON of training parameters; default: the package's own"""
    max_minutes: float = 60.0
    """stop cleanly after this time"""
    max_steps: int | None = None
    """stop after this many further steps"""
    device: str = "auto"
    """auto, cpu or cuda; several GPUs: torchrun --nproc-per-node N -m composenet train ..."""
    workers: int = 1
    """processes that generate scenes"""
    threads: int | None = None
    """compute threads; default: torch's own choice"""
    data: Path | None = None
    """sequences on disk (from `composenet synth`) instead of streaming new ones"""
    cad: Path | None = None
    """folder of CAD meshes to mix into the generated scenes"""
    cad_share: float = 0.5
    """share of the furniture taken from --cad"""
    start_from: Path | None = None
    """weights to begin a new run from"""

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.train import run_train

        return run_train(**vars(self))


@dataclass(frozen=True)
class TrackCommand:
    """Track a recording: tracks, completed meshes, replay and report in one folder."""

    recording: Recording
    """folder of an RGB-D recording (exported ScanNet, plain color/depth/pose folders, TUM)"""
    out: Path
    """folder for the result"""
    weights: Path | None = None
    """weights to use instead of the shipped ones"""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N"""
    stride: int = 1
    """track every N-th frame"""
    max_frames: int | None = None
    """stop after this many frames"""
    save_every: int = 50
    """write what is done every N frames"""
    variant: Variant = "full"
    """the paper's ablations: without completion, without correspondences, or both"""
    offline: bool = False
    """link tracks over the whole recording at the end (looks into the future)"""
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = SequenceOptions()

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.evaluate import VARIANTS
        from composenet.commands.track import run_track

        return run_track(
            self.recording,
            self.out,
            weights=self.weights,
            device=self.device,
            stride=self.stride,
            max_frames=self.max_frames,
            save_every=self.save_every,
            variant={**VARIANTS[self.variant], "offline": self.offline},
            reading=self.reading,
        )


@dataclass(frozen=True)
class Eval:
    """Track and score every sequence of a folder, or score what `track` wrote."""

    data: Path
    """folder of sequences from `composenet synth`"""
    out: Path
    """folder for results.json and results.md; finished sequences are kept there"""
    variants: str = "full"
    """comma-separated: full, no-compl, no-corr, no-corr-no-compl"""
    predictions: Path | None = None
    """score these result folders of `track` instead of tracking"""
    weights: Path | None = None
    """weights to use instead of the shipped ones"""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N"""
    offline: bool = False
    """with the offline second pass (looks into the future)"""
    workers: int = 1
    """processes"""
    seed: int = 0
    """noted in the results; tracking itself draws no random numbers"""

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.evaluate import run_eval

        options = dict(vars(self))
        options["variants"] = [name.strip() for name in self.variants.split(",")]
        return run_eval(options.pop("data"), options.pop("out"), **options)


@dataclass(frozen=True)
class View:
    """Show a result of `track`: opens its report, or its replay in the rerun viewer."""

    result: Annotated[Path, tyro.conf.Positional]
    """result folder of `track`"""
    replay: bool = False
    """serve replay.rrd in the rerun web viewer (needs composenet[viz])"""

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.view import run_view

        return run_view(self.result, replay=self.replay)


COMMANDS = {
    "demo": Demo,
    "synth": Synth,
    "train": Train,
    "track": TrackCommand,
    "eval": Eval,
    "view": View,
}


def main() -> None:
    """Entry point."""
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="composenet",
        description="Finds, completes, poses and tracks furniture in RGB-D video.",
        config=(tyro.conf.OmitArgPrefixes,),
    )
    sys.exit(_guarded(command))


def _guarded(command) -> int:
    try:
        return command.run()
    except ComposenetError as error:
        print(f"composenet: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("composenet: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    main()
