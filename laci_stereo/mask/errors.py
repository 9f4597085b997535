"""What is wrong with a network or its contract."""

from __future__ import annotations

from laci_stereo.core.errors import InputError


class MaskError(InputError):
    """A vehicle mask's network, its contract, or what it returns is unusable."""
