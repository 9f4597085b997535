"""The frames of a recording that a user declares to be without moving objects."""

from __future__ import annotations

from laci_stereo.core.errors import SettingError


def check_frames(first: int, last: int, count: int, noun: str) -> None:
    """Raise if the background frames that a user names are not in the recording.

    Parameters
    ----------
    first, last : int
        Indices of the first and the last background frame.
    count : int
        Number of frames in the recording.
    noun : str
        What frames are called, in the plural.

    Raises
    ------
    SettingError
        If the indices are outside the recording, or last is before first.
    """
    if not 0 <= first <= last < count:
        raise SettingError(f"background {noun} are {first}..{last}; needed are first <= last within 0..{count - 1}")
