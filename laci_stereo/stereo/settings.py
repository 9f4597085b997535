"""All settings of the stereo camera, with their defaults and the reasons for these."""

from __future__ import annotations

from dataclasses import dataclass

from laci_stereo.core.errors import SettingError


@dataclass(frozen=True)
class StereoSettings:
    """Settings of the conversion from image pairs to point clouds.

    Attributes
    ----------
    rectified : bool
        The images are rectified already, and the left camera matrix of the calibration applies to both.
    baseline_m : float or None
        Distance between the cameras, metres, if the calibration's unit of length is unknown; None: the calibration's.
    turn_deg : tuple of float or None
        Rotation of the right camera since its calibration, as a rotation vector about its x, y and z axes, degrees;
        None: no rotation. The rows of the images determine pitch and roll, a drive determines yaw.
    disparities : tuple of int or None
        Smallest and largest disparity to search, pixels. None: derived for each part of an image from the baseline, the
        focal length and the mounting height, which is estimated from a coarse match of the scene.
    block_size : int
        Side of the matching block, pixels, odd.
    uniqueness_percent : int
        Least difference in cost between the best and the second-best match, percent; ambiguous pixels are dropped.
    left_right_px : int
        Largest difference between the left-to-right and the right-to-left match.
    speckle_px : int
        Connected disparity areas with fewer pixels than this are dropped.
    refine_window_px : int
        Side of the window over which the sub-pixel shift is estimated, pixels, odd.
    max_disparity_sigma_px : float
        A pixel whose texture does not determine its disparity more precisely than this is dropped: a whole-pixel
        disparity has 1 / sqrt(12) = 0.29 px, so above this the sub-pixel estimate adds nothing.
    disparity_floor_px : float
        Standard deviation of the disparity from other causes than image noise: windows across slanted and curved
        surfaces, imperfect rectification. Carefully calibrated rigs stay within a tenth of a pixel over their life.
    workers : int
        Number of frames decoded and matched concurrently; 0: the number of processors, at most 8.
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
