"""Every setting of the stereo camera, its default, and why it has that value."""

from __future__ import annotations

from dataclasses import dataclass

from laci_stereo.core.errors import SettingError


@dataclass(frozen=True)
class StereoSettings:
    """How image pairs become point clouds.

    Attributes
    ----------
    rectified : bool
        The images are rectified already, and the calibration's left matrix is that of both.
    baseline_m : float or None
        How far apart the cameras stand, where the calibration's lengths are in an unknown unit; None: as it says.
    turn_deg : tuple of float or None
        How far the right camera has turned since it was calibrated, a rotation vector about its x, y and z axis; None:
        not at all. Up and about its line of sight, as rows of the images tell, and sideways, as a drive does.
    disparities : tuple of int or None
        Smallest and largest disparity to search, pixels. None: from the baseline, the focal length and the mounting
        height, which a coarse look at the scene gives, for every part of an image by itself.
    block_size : int
        Side of the matched block, pixels, odd.
    uniqueness_percent : int
        The best match must be better than the second by this much, or the pixel is dropped.
    left_right_px : int
        Largest difference between the match from left to right and the one back.
    speckle_px : int
        Smaller islands of disparity are dropped.
    refine_window_px : int
        Side of the window over which the sub-pixel shift is estimated, odd.
    max_disparity_sigma_px : float
        A pixel whose texture cannot fix its disparity better than this is dropped: a whole-pixel disparity has
        1 / sqrt(12) = 0.29 px, so beyond it the sub-pixel estimate adds nothing.
    disparity_floor_px : float
        Noise of the disparity that does not come from the image's noise: windows across slanted and curved surfaces,
        imperfect rectification. A tenth of a pixel is what carefully calibrated rigs keep over their life.
    workers : int
        Frames decoded and matched at the same time; 0 takes the number of processors, at most 8.
    """

    rectified: bool = False
    baseline_m: float | None = None
    turn_deg: tuple[float, float, float] | None = None
    disparities: tuple[int, int] | None = None
    block_size: int = 5
    uniqueness_percent: int = 10
    left_right_px: int = 1
    speckle_px: int = 100
    refine_window_px: int = 11
    max_disparity_sigma_px: float = 0.25
    disparity_floor_px: float = 0.1
    workers: int = 0

    def __post_init__(self) -> None:
        for name in ("block_size", "refine_window_px"):
            value = getattr(self, name)
            if value < 1 or value % 2 == 0:
                raise SettingError(f"{name} is {value}; needed is an odd number of 1 or more")
        if self.disparities is not None and not 0 <= self.disparities[0] < self.disparities[1]:
            raise SettingError(
                f"disparities are {self.disparities[0]}..{self.disparities[1]}; needed is 0 <= smallest < largest"
            )
