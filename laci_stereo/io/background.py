"""The frames of a recording that a user declares to be without moving objects."""

from __future__ import annotations

from laci_stereo.core.errors import SettingError


def check_frames(first: int, last: int, count: int, noun: str) -> None:
    """Raise if the background frames that a user names are not among the ``count`` frames of the recording.

    Raises
    ------
    SettingError
        With the name for frames in the plural, ``noun``.
    """
    if not 0 <= first <= last < count:
        raise SettingError(f"background {noun} are {first}..{last}; needed are first <= last within 0..{count - 1}")
