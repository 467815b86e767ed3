"""Weights with their configuration inside, as safetensors: no code is loaded with them."""

from __future__ import annotations

import hashlib
import json
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from composenet.config import Config, from_dict, to_dict
from composenet.errors import ComposenetError, WeightsError
from composenet.files import write_atomic
from composenet.network.model import ComposeNet

FORMAT = "composenet.weights/1"
DEFAULT_NAME = "default.safetensors"


def save_weights(
    network: ComposeNet, config: Config, path: Path, notes: dict[str, Any] | None = None
) -> None:
    """Matrices are stored in half precision, statistics in full. Raises DataError where the file
    cannot be written."""
    tensors = {}
    for name, value in network.state_dict().items():
        value = value.detach().cpu().contiguous()
        half = value.is_floating_point() and "running_" not in name
        tensors[name] = value.half() if half else value
    metadata = {
        "format": FORMAT,
        "config": json.dumps(to_dict(config)),
        "notes": json.dumps(notes or {}),
    }
    write_atomic(path, save(tensors, metadata))


def default_weights() -> Path:
    """The weights shipped in the package."""
    return Path(str(resources.files("composenet") / "weights" / DEFAULT_NAME))


def weights_id(path: Path) -> str:
    """Name and fingerprint of a weights file, for results made with it."""
    return f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()[:12]}"


def load_weights(
    path: Path, device: torch.device | str = "cpu"
) -> tuple[ComposeNet, Config, dict[str, Any]]:
    """Network (evaluation mode), configuration and notes.

    Raises WeightsError where the file is missing, corrupt, foreign, or does not fit.
    """
    if not path.is_file():
        raise WeightsError(f"{path}: no such weights file")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise WeightsError(f"{path}: not a readable safetensors file ({error})") from None
    if metadata.get("format") != FORMAT:
        raise WeightsError(
            f"{path}: expected {FORMAT!r} weights, found {metadata.get('format')!r}; "
            "were they made by `composenet train`?"
        )
    try:
        config = from_dict(json.loads(metadata["config"]))
        network = ComposeNet(config.network, config.volume)
        network.load_state_dict(
            {k: v.float() if v.is_floating_point() else v for k, v in tensors.items()}
        )
        notes = json.loads(metadata.get("notes", "{}"))
    except (KeyError, ValueError, RuntimeError, ComposenetError) as error:
        reason = " ".join(str(error).split())[:200]
        raise WeightsError(
            f"{path}: the weights do not fit their configuration ({reason})"
        ) from None
    return network.to(device).eval(), config, notes
