"""The exception of the LiDAR adapter."""

from __future__ import annotations

from laci_stereo.core.errors import InputError


class ScanError(InputError):
    """A scan, a folder of scans or a bag is unusable."""
