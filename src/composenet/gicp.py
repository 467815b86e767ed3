"""small_gicp, an optional library that aligns clouds of points."""

from __future__ import annotations

from types import ModuleType

from composenet.errors import ConfigError


def small_gicp() -> ModuleType:
    """The library. Raises ConfigError where it is not installed."""
    try:
        import small_gicp as library
    except ImportError:
        raise ConfigError(
            "this needs small_gicp: install it with `pip install 'composenet[odometry]'`"
        ) from None
    return library
