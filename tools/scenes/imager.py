"""From light to the pixel values of an image file: exposure, vignetting, noise, Bayer mosaic, and gamma."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from laci_stereo.core.frames import Raster
from laci_stereo.io.rig.stereo_rig import Lens

GREY = np.array([0.3, 0.6, 0.1], np.float32)
"""Weights of red, green and blue in a grey sensor."""


@dataclass(frozen=True)
class Sensor:
    """How light becomes pixel values, the same for both cameras except for the gain.

    Attributes
    ----------
    full_well_e, read_noise_e : float
        Electrons. The defaults are the Sony IMX174's as measured by EMVA 1288 (32.7 ke and 6.8 e: Point Grey, "Sony
        Pregius Global Shutter CMOS Imaging Performance", 2015), a common global-shutter sensor.
    exposure : float
        Fraction of the full well that the brightest twentieth of the left image's surfaces exceeds.
    right_gain : float
        Gain of the right image relative to the left.
    vignetting : float
        Fraction of light lost in the corners.
    gamma : float
        Output is input to the power of 1 / gamma.
    bits : int
        8 or 16.
    colour : bool
        With a Bayer mosaic (red, green / green, blue).
    """

    full_well_e: float = 32_700.0
    read_noise_e: float = 6.8
    exposure: float = 0.6
    right_gain: float = 1.0
    vignetting: float = 0.2
    gamma: float = 2.2
    bits: int = 8
    colour: bool = True


def develop(radiance: Raster, lens: Lens, sensor: Sensor, scale: float, rng: np.random.Generator) -> Raster:
    """Turn light into the pixel values of an image file.

    Parameters
    ----------
    radiance : ndarray, shape (height, width, 3)
        Red-green-blue.
    lens : Lens
    sensor : Sensor
    scale : float
        Fraction of the full well for a unit of radiance.
    rng : Generator
        Draws the noise.

    Returns
    -------
    ndarray of uint8 or uint16, shape (height, width) or (height, width, 3)
        Blue-green-red if in colour.
    """
    light = _mosaic(radiance) if sensor.colour else radiance @ GREY
    electrons = light * _vignette(lens, sensor.vignetting) * np.float32(scale * sensor.full_well_e)
    # Photons arrive independently: variance equals mean; the amplifier adds its own noise.
    sigma = np.sqrt(electrons + np.float32(sensor.read_noise_e**2))
    electrons += sigma * rng.standard_normal(electrons.shape, dtype=np.float32)
    share = np.clip(electrons / np.float32(sensor.full_well_e), 0.0, 1.0) ** np.float32(1.0 / sensor.gamma)
    # The converter has 12 bits, as those of these sensors do; 16-bit files contain its numbers shifted.
    raw = np.rint(share * 4095.0).astype(np.uint16) << 4 if sensor.bits == 16 else np.rint(share * 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BayerRGGB2BGR)) if sensor.colour else raw


def _mosaic(radiance: Raster) -> Raster:
    mosaic: Raster = radiance[:, :, 1].copy()
    mosaic[::2, ::2] = radiance[::2, ::2, 0]
    mosaic[1::2, 1::2] = radiance[1::2, 1::2, 2]
    return mosaic


def _vignette(lens: Lens, lost: float) -> Raster:
    width, height = lens.size
    u, v = np.meshgrid(np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32))
    fall: Raster = 1.0 - np.float32(lost / 2) * (u**2 + v**2)
    return fall
