"""Which frames of a recording a user says to be without moving objects."""

from __future__ import annotations

from laci_stereo.core.errors import SettingError


def check_frames(first: int, last: int, count: int, noun: str) -> None:
    """Check that a recording has the background frames that it is said to have.

    Parameters
    ----------
    first, last : int
        As the user says them.
    count : int
        How many frames the recording has.
    noun : str
        What a frame is called, in the plural.

    Raises
    ------
    SettingError
        If they are not in the recording, or there is none between them.
    """
    if not 0 <= first <= last < count:
        raise SettingError(f"background {noun} are {first}..{last}; needed are first <= last within 0..{count - 1}")
