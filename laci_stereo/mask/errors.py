"""The exception of networks and their contracts."""

from __future__ import annotations

from laci_stereo.core.errors import InputError


class MaskError(InputError):
    """A vehicle mask's network, its contract, or what it returns is unusable."""
