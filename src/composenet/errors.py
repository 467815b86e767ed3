"""Errors that a user can act on: printed as one line, without a traceback."""

from __future__ import annotations


class ComposenetError(Exception):
    """Base of all errors caused by input. The message names the file or frame, what was
    expected and what to do."""


class SequenceError(ComposenetError):
    """A recording cannot be read."""


class WeightsError(ComposenetError):
    """Weights are missing, corrupt or made for another network."""


class ConfigError(ComposenetError):
    """A configuration does not validate."""


class DeviceError(ComposenetError):
    """The machine cannot do what is asked of it: out of memory, or a failure of the GPU."""


class DataError(ComposenetError):
    """A data folder, mesh folder or result file is not what was expected."""
