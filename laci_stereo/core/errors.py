"""The exceptions of the whole project, drawn once.

LaciError
├── InputError            it cannot be read or makes no sense      (exit code 2)
│   ├── ImageError        an image folder or a pair of folders
│   ├── RigError          a stereo calibration
│   ├── CamError          a log of Cooperative Awareness Messages
│   ├── MapError          a lane map
│   ├── DetectionError    a log of a detector's boxes
│   ├── ScanError         a LiDAR's scans (in `laci_lidar`)
│   ├── MaskError         a vehicle mask (in `laci_stereo.mask`)
│   ├── SettingError      an argument or a setting
│   ├── CalibrationFileError  a calibration.json
│   ├── EvidenceError     what a result keeps of its drive (evidence.npz)
│   └── OutputError       the place where the result should go
└── CalibrationError      it was read, but cannot be calibrated    (exit code 1)
    ├── GroundError       no ground plane
    ├── BackgroundError   no frame shows the scene at rest
    ├── BoxError          points that span no box
    ├── TrackError        no vehicle, or one that stands still
    ├── MatchError        the two tracks do not fit on each other
    ├── OpenError         the drive leaves a direction open
    ├── CombineError      several drives that contradict one another
    └── VerdictError      a result that is written, to be looked at, but must not be used

A message is one line: the file, the quantity, the value found and the value needed.
"""

from __future__ import annotations


class LaciError(Exception):
    """Root of everything that this project raises on purpose."""


class InputError(LaciError):
    """The input cannot be read or makes no sense."""


class ImageError(InputError):
    """An image, a folder of images, or a pair of folders is unusable."""


class RigError(InputError):
    """A stereo calibration is unusable."""


class CamError(InputError):
    """A log of Cooperative Awareness Messages is unusable."""


class MapError(InputError):
    """A lane map is unusable."""


class DetectionError(InputError):
    """A log of detections is unusable."""


class SettingError(InputError):
    """An argument or a setting is out of its range."""


class CalibrationFileError(InputError):
    """A calibration.json is unusable."""


class EvidenceError(InputError):
    """The evidence that a result keeps of its drive is unusable, or is not of the same sensor as the rest."""


class OutputError(InputError):
    """The result cannot be written to its destination."""


class CalibrationError(LaciError):
    """The input was read, but does not determine a calibration."""


class GroundError(CalibrationError):
    """No ground plane was found."""


class BackgroundError(CalibrationError):
    """The static background could not be learned."""


class BoxError(CalibrationError):
    """The points do not span a box."""


class TrackError(CalibrationError):
    """No vehicle was found that could be the sender."""


class MatchError(CalibrationError):
    """The vehicle's track in the sensor does not fit its track in the world.

    Parameters
    ----------
    message : str
    nearer_per_m : float
        The correction of all inverse distances, 1/m, with which the tracks certainly would fit; 0 if there is none.
    """

    def __init__(self, message: str, nearer_per_m: float = 0.0) -> None:
        super().__init__(message)
        self.nearer_per_m = nearer_per_m


class OpenError(CalibrationError):
    """The drive leaves a direction undetermined, so that there is no number to give."""


class CombineError(CalibrationError):
    """Several drives contradict one another."""


class VerdictError(CalibrationError):
    """The result's verdict is that it must not be used."""
