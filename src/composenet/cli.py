"""The `composenet` program: parses and calls. Bad input gives one line and exit code 2."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from pydantic import Field

from composenet.arguments import parse_command
from composenet.config import Count, Positive, Share
from composenet.errors import ComposenetError
from composenet.process import keep_freed_memory, wait_asleep
from composenet.sequences.options import SequenceOptions

Variant = Literal["full", "no-compl", "no-corr", "no-corr-no-compl"]
CameraPoses = Literal["given", "estimated"]
Split = Literal["train", "val", "test"]
PixelCount = Annotated[int, Field(ge=32)]
Recording = Annotated[Path, tyro.conf.Positional]


@dataclass(frozen=True)
class Demo:
    """Generate a sequence, track it with the shipped weights and score the result."""

    out: Path = Path("demo_out")
    """folder for everything the demo makes"""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N"""
    frames: Count = 30
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
    count: Count = 1
    """number of sequences"""
    start: Annotated[int, Field(ge=0)] = 0
    """index of the first"""
    cad: Path | None = None
    """folder CLASS/*.{obj,ply,off,stl,glb} of meshes to mix in (+Y up, +Z front, metres)"""
    cad_share: Share = 0.5
    """share of the furniture taken from --cad; 1 takes all of it"""
    image_size: tuple[PixelCount, PixelCount] = (320, 240)
    """width and height, pixels"""
    frames: Count = 30
    """frames a sequence"""
    stats: bool = False
    """print the table of difficulty of the sequences"""
    workers: Count = 1
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
    """JSON of training parameters, or `paper` for those of the paper, `further` for learning on
    from the shipped weights; default: our own"""
    max_minutes: Positive = 60.0
    """stop cleanly after this time, at the end of a step (of many frames, as with `further`, one
    takes long on a CPU)"""
    max_steps: Count | None = None
    """stop after this many further steps"""
    device: str = "auto"
    """auto, cpu or cuda; several GPUs: torchrun --nproc-per-node N -m composenet train ..."""
    workers: Annotated[int, Field(ge=0)] = 1
    """processes that generate scenes; 0: in the training process itself"""
    threads: Count | None = None
    """compute threads; default: torch's own choice"""
    data: Path | None = None
    """sequences on disk (from `composenet synth`, or annotated ones of your own) instead of
    streaming new ones"""
    data_share: Share = 1.0
    """share of the scenes taken from --data; the others are generated"""
    cad: Path | None = None
    """folder of CAD meshes to mix into the generated scenes"""
    cad_share: Share = 0.5
    """share of the furniture taken from --cad"""
    start_from: Path | None = None
    """weights to begin a new run from; with another seed than theirs it meets new scenes"""

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.train import run_train

        return run_train(**vars(self))


@dataclass(frozen=True)
class TrackCommand:
    """Track a recording: tracks, completed meshes, replay and report in one folder."""

    recording: Recording
    """RGB-D recording: a folder (plain color/depth/pose, exported ScanNet, TUM, 7-Scenes, 3DMatch,
    Open3D), a ScanNet .sens file, or of ROS and RealSense a .bag, .mcap or .db3"""
    out: Path
    """folder for the result"""
    weights: Path | None = None
    """weights to use instead of the shipped ones"""
    config: Path | None = None
    """configuration to use instead of the weights' own, e.g. a result's config.json"""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N"""
    stride: Count = 1
    """track every N-th frame"""
    max_frames: Count | None = None
    """stop after this many frames"""
    save_every: Count = 50
    """write what is done every N frames"""
    variant: Variant | None = None
    """the paper's ablations: without completion, without correspondences, or both; not given: as
    the configuration says, which is full in the shipped weights"""
    offline: tyro.conf.FlagCreatePairsOff[bool] = False
    """look at the recording once more, backwards, and link tracks over the whole of it: every frame
    is then seen with what later ones showed (twice the time)"""
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(
        default_factory=SequenceOptions
    )

    def run(self) -> int:
        """Exit code."""
        from composenet.commands.scoring import VARIANTS
        from composenet.commands.track import run_track

        return run_track(
            self.recording,
            self.out,
            weights=self.weights,
            config=self.config,
            device=self.device,
            stride=self.stride,
            max_frames=self.max_frames,
            save_every=self.save_every,
            variant=(VARIANTS[self.variant] if self.variant else {})
            | ({"offline": True} if self.offline else {}),
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
    """comma-separated: full, no-compl, no-corr, no-corr-no-compl, and as `track --offline` runs
    them, whose frames see into the future: offline, offline-no-compl, and so on"""
    predictions: Path | None = None
    """score what `track` wrote instead of tracking: a folder PREDICTIONS/SEQUENCE for each
    sequence of --data, or one result where there is one sequence"""
    weights: Path | None = None
    """weights to use instead of the shipped ones"""
    config: Path | None = None
    """configuration to use instead of the weights' own; the variants replace fields of it"""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N"""
    workers: Count = 1
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
class Bench:
    """Score the paper's comparison systems and our variants on the same frames, in one table."""

    data: Path
    """folder of sequences from `composenet synth`"""
    out: Path
    """folder for results.json and results.md (with pictures); finished sequences are kept there"""
    methods: str = "all"
    """all (whose weights there are), or comma-separated: f2f-gt, f2f-mask-rcnn,
    maskfusion-gt-masks, maskfusion, midfusion-gt-masks, midfusion, no-corr-no-compl, no-corr,
    no-compl, full"""
    camera: CameraPoses = "given"
    """given: the recording's camera poses; estimated: each method finds its own, ours as `track
    --odometry` does, the others from the true pose of the first frame on"""
    weights: Path | None = None
    """weights of our network to use instead of the shipped ones"""
    device: str = "auto"
    """auto, cpu, cuda or cuda:N"""
    workers: Count = 1
    """processes"""
    report: Path | None = None
    """Markdown page to write instead of OUT/results.md; its pictures lie in a folder of its name"""

    def run(self) -> int:
        """Exit code."""
        from composenet.baselines.records import Cameras
        from composenet.commands.bench import run_bench

        options = dict(vars(self))
        options["methods"] = [name.strip() for name in self.methods.split(",")]
        options["camera"] = Cameras(self.camera)
        return run_bench(options.pop("data"), options.pop("out"), **options)


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


COMMANDS: dict[str, Callable[..., Any]] = {
    "demo": Demo,
    "synth": Synth,
    "train": Train,
    "track": TrackCommand,
    "eval": Eval,
    "bench": Bench,
    "view": View,
}


def main() -> None:
    """Entry point."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # a path may be in no known encoding
        sys.stdout.reconfigure(errors="replace")
    wait_asleep()
    keep_freed_memory()
    sys.exit(_guarded(lambda: parse_command(COMMANDS)))


def _guarded(parse: Callable[[], Any]) -> int:
    try:
        code: int = parse().run()
        return code
    except BrokenPipeError:  # the reader of our output has gone
        sys.stderr.close()
        return 1
    except (ComposenetError, OSError) as error:
        print(f"composenet: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("composenet: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    main()
