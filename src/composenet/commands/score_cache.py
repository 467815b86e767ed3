"""Scores of finished sequences on disk, so that an interrupted command goes on."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterator
from pathlib import Path

import composenet
from composenet.commands.scoring import ScoredSequence


class ScoreCache:
    """One file a sequence and variant, used again only where all that made it is unchanged: the
    weights, the options, the package's own code and the sequence's ground truth."""

    def __init__(self, folder: Path, weights: Path, *options: object) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._common = hashlib.sha256(repr(options).encode())
        for path in (weights, *_sources()):
            self._common.update(hashlib.sha256(path.read_bytes()).digest())

    def load(self, sequence: Path, variant: str) -> ScoredSequence | None:
        """The scores, None where they are missing or of another making."""
        path = self._path(sequence, variant)
        if not path.is_file():
            return None
        key, _, stored = path.read_bytes().partition(b"\n")
        return pickle.loads(stored) if key == self._key(sequence, variant) else None

    def save(self, sequence: Path, variant: str, scores: ScoredSequence) -> None:
        """Keep the scores; the file appears whole."""
        path = self._path(sequence, variant)
        partial = path.with_suffix(".partial")
        partial.write_bytes(self._key(sequence, variant) + b"\n" + pickle.dumps(scores))
        partial.replace(path)

    def _path(self, sequence: Path, variant: str) -> Path:
        return self.folder / f"{sequence.name}.{variant}.pkl"

    def _key(self, sequence: Path, variant: str) -> bytes:
        key = self._common.copy()
        key.update(f"{sequence.resolve()} {variant}".encode())
        key.update((sequence / "annotations.json").read_bytes())
        return key.hexdigest().encode()


def kept_sequences(folder: Path) -> Iterator[tuple[str, str, ScoredSequence]]:
    """Name of the sequence, variant and scores of all that a cache's folder holds, whatever made
    them. The files are pickles: open only folders that you trust."""
    for path in sorted(folder.glob("*.pkl")):
        name, variant, _ = path.name.split(".")
        yield name, variant, pickle.loads(path.read_bytes().partition(b"\n")[2])


def _sources() -> list[Path]:
    return sorted(Path(composenet.__file__).parent.rglob("*.py"))
