"""Scores of finished sequences on disk, so that an interrupted command goes on."""

from __future__ import annotations

import ast
import hashlib
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import composenet
from composenet.commands.scoring import ScoredSequence
from composenet.errors import DataError
from composenet.files import write_atomic


class ScoreCache:
    """One file a sequence and variant, used again only where all that made it is unchanged: the
    weights, the options, the code and the sequence's files.

    made_by: the modules that make the scores; their code and that of all they import from this
    package counts, so that a change of ours does not undo hours of another system's.
    """

    def __init__(
        self, folder: Path, made_by: Sequence[str], weights: Path, *options: object
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._files: dict[Path, bytes] = {}  # the digests of sequences
        self._common = hashlib.sha256(repr(options).encode())
        for path in (weights, *sources_of(*made_by)):
            self._common.update(hashlib.sha256(path.read_bytes()).digest())

    def load(self, sequence: Path, variant: str) -> ScoredSequence | None:
        """The scores, None where they are missing or of another making."""
        path = self._path(sequence, variant)
        if not path.is_file():
            return None
        key, _, stored = path.read_bytes().partition(b"\n")
        if key != self._key(sequence, variant):
            return None
        try:
            return pickle.loads(stored)
        except (EOFError, pickle.UnpicklingError):  # cut off: another program's doing
            return None

    def save(self, sequence: Path, variant: str, scores: ScoredSequence) -> None:
        """Keep the scores; the file appears whole."""
        data = self._key(sequence, variant) + b"\n" + pickle.dumps(scores)
        write_atomic(self._path(sequence, variant), data)

    def _path(self, sequence: Path, variant: str) -> Path:
        return self.folder / f"{sequence.name}.{variant}.pkl"

    def _key(self, sequence: Path, variant: str) -> bytes:
        key = self._common.copy()
        key.update(f"{sequence.resolve()} {variant}".encode(errors="surrogateescape"))
        if sequence not in self._files:
            self._files[sequence] = _digest(sequence)
        key.update(self._files[sequence])
        return key.hexdigest().encode()


def _digest(folder: Path) -> bytes:
    """Of the names and the contents of all files there."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        digest.update(f"{path.relative_to(folder)} {content}\n".encode(errors="surrogateescape"))
    return digest.digest()


def kept_sequences(folder: Path) -> Iterator[tuple[str, str, ScoredSequence]]:
    """Name of the sequence, variant and scores of all that a cache's folder holds, whatever made
    them. The files are pickles: open only folders that you trust. Raises DataError for what an
    older version has kept."""
    for path in sorted(folder.glob("*.pkl")):
        name, variant, _ = path.name.rsplit(".", 2)
        scores = pickle.loads(path.read_bytes().partition(b"\n")[2])
        if lacking := {field.name for field in fields(ScoredSequence)} - vars(scores).keys():
            raise DataError(
                f"{path}: kept by an older version, without {min(lacking)}; run the command that "
                "made it once more"
            )
        yield name, variant, scores


def sources_of(*modules: str) -> list[Path]:
    """The files of this package that modules of it are made of: their own and those of all that
    they import, wherever in their code, directly or not; by path."""
    found: dict[str, Path] = {}
    waiting = [*modules]
    while waiting:
        name = waiting.pop()
        if name in found or (path := _file_of(name)) is None:
            continue
        found[name] = path
        waiting.append(name.rpartition(".")[0])  # a package's own file runs first
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.module:
                waiting += [node.module, *(f"{node.module}.{part.name}" for part in node.names)]
            elif isinstance(node, ast.Import):
                waiting += [part.name for part in node.names]
    return sorted(found.values())


def _file_of(module: str) -> Path | None:
    """Of a module of this package; None for anything else, and for the package itself, which only
    hands on."""
    package, *parts = module.split(".")
    if package != composenet.__name__ or not parts:
        return None
    base = Path(composenet.__file__).parent.joinpath(*parts)
    files = (base / "__init__.py", base.with_suffix(".py"))
    return next((path for path in files if path.is_file()), None)
