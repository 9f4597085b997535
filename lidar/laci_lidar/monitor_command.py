"""``laci-lidar monitor``: counts where the objects of a long LiDAR recording drive on the map."""

from __future__ import annotations

from pathlib import Path

import click

from laci_lidar.monitor import LidarFrames, stored_settings
from laci_lidar.settings import LidarSettings
from laci_stereo.commands.monitor import Watch, Watched, monitoring
from laci_stereo.commands.options import PATH
from laci_stereo.io.result.stored_calibration import StoredCalibration


@click.command()
@monitoring("lidar")
@click.argument("scans", type=PATH)
@click.option("--topic", help="Topic with the point clouds, where a bag has several.")
def monitor(asked: Watch, stored: StoredCalibration, scans: Path, topic: str | None) -> Watched:
    """Count where the objects of a long LiDAR recording drive on the map.

    CALIBRATION is a result folder or its calibration.json, SCANS a recording as in calibrate; it is read as the
    calibration's was, after an import with x forward and z up. What was interrupted goes on where it was when the same
    command is given again.

    Exit codes: 0 done; 2 the input cannot be read or makes no sense; 130 interrupted.
    """
    if stored.claims:
        settings = stored_settings(stored.path, asked.workers)
    else:
        settings = LidarSettings(workers=asked.workers)
        click.echo(
            f"note: {stored.path} was imported and does not say how scans are read; taken is x forward, z up, and "
            "times only where the points have them",
            err=True,
        )
    return Watched(LidarFrames(scans, topic, settings, follow=asked.follow), scans, {})
