"""From two folders of images to a result: what ``laci-stereo calibrate`` runs, as a Python interface."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from laci_stereo.check.images import Checked, check_images
from laci_stereo.check.result import placed_by
from laci_stereo.check.rig_turn import MOST_LOOKS, RightTurn, find_turn
from laci_stereo.core.errors import CalibrationError, MatchError
from laci_stereo.core.frames import Raster
from laci_stereo.core.result import Calibration
from laci_stereo.io.background import check_frames
from laci_stereo.io.images import ImageFolder, Pairs, StereoPair, first_size, pair_images
from laci_stereo.io.maps.lane_map import find_lane_map
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.io.rig.stereo_calibration import calibration_files, read_stereo_calibration
from laci_stereo.io.rig.stereo_rig import RAW_FRAME, RECTIFIED_FRAME, StereoRig
from laci_stereo.io.stamp_errors import PASSING_MPS, StampErrors
from laci_stereo.job import DriveOptions, Job, Result, read_drive, sha256
from laci_stereo.mask.contract import contract_beside
from laci_stereo.mask.network import MaskOptions
from laci_stereo.mask.stage import VehicleMask
from laci_stereo.report.overlay import draw_overlay, overlay_stamps
from laci_stereo.report.page import MOMENTS, Photograph, Photographs
from laci_stereo.stereo.recording import StereoRecording
from laci_stereo.stereo.rectify import already_rectified
from laci_stereo.stereo.settings import StereoSettings

SIMULTANEOUS_S = 0.001
"""Left and right times that differ by more are reported: at 15 m/s a vehicle drives 1.5 cm meanwhile, which is half a
pixel at 30 m with a focal length of 1000, where the matcher errs by 0.2."""

TRIGGERED_S = 0.010
"""Times that differ by more are not those of one trigger: synchronised clocks differ by this much."""


@dataclass(frozen=True, kw_only=True)
class Options(DriveOptions):
    """The settings that the calibration of a stereo camera offers to a user.

    A recording given as ``background`` is a folder with images in ``left`` and ``right``.

    Attributes
    ----------
    stereo : Path, or tuple of Path
        The stereo calibration: one file or two, or a folder that contains them; () looks beside the left images.
    camera : StereoSettings
    mask : MaskOptions or None
        A network that determines which moving points belong to vehicles.
    """

    stereo: Path | tuple[Path, ...] = ()
    camera: StereoSettings = field(default_factory=StereoSettings)
    mask: MaskOptions | None = None

    def config(self) -> dict[str, object]:
        """Return every effective setting except the paths, which are among the inputs."""
        provider = {} if self.mask is None else {"mask": {"provider": self.mask.provider}}
        return {**super().config(), "stereo": asdict(self.camera), **provider}


@dataclass(frozen=True, kw_only=True)
class StereoJob(Job):
    """A task for a stereo camera.

    Attributes
    ----------
    recording : StereoRecording
    turn : RightTurn
        Rotation of the right camera since the stereo calibration, as far as it is known.
    turned : callable
        Prepares this task anew with another rotation.
    """

    recording: StereoRecording
    turn: RightTurn
    turned: Callable[[RightTurn], StereoJob]

    def again(self, found: Calibration | CalibrationError, /) -> StereoJob | None:
        """Return the task with the right camera's yaw as the drive determines it; None if that is known already.

        The yaw is estimated from the drive if the rows show that the camera has rotated at all, and repeatedly until
        the estimate agrees with the previous one; also if the vehicle is not found, but would be with such a yaw.
        """
        turn = self.turn
        if not turn.off_px or turn.looks == MOST_LOOKS:
            return None
        if isinstance(found, CalibrationError):
            per_m, after_per_m = found.nearer_per_m if isinstance(found, MatchError) else 0.0, 0.0
            known = per_m == 0.0
        else:
            per_m, after_per_m = (0.0, 0.0) if found.nearer is None else (found.nearer.value, found.nearer.after)
            known = found.nearer is None or (turn.left_px > 0.0 and abs(per_m) < after_per_m)
        if known:
            return None
        return self.turned(turn.sideways(self.recording.rectification, per_m, after_per_m))

    def check(self, calibration: Calibration, /) -> Checked | None:
        """Check whether the map's lines lie on the road's."""
        if self.lane_map is None:
            return None
        recording, files = self.recording, [pair.left for pair in self.recording.pairs]
        return check_images(files, recording.reader, recording.rig.left, placed_by(calibration), self.lane_map)

    def draw(self, calibration: Calibration, /) -> Iterator[tuple[str, Raster]]:
        """Draw the map, the vehicle and its track into some left images."""
        recording = self.recording
        for number, stamp_s in enumerate(overlay_stamps(calibration), start=1):
            image = recording.reader.colour(_pair_at(recording, stamp_s).left)
            yield f"overlay_{number}.png", draw_overlay(image, recording.rig.left, calibration, stamp_s, self.lane_map)

    def photograph(self, calibration: Calibration, /) -> Photographs:
        """Return some left images of the drive."""
        recording, shots = self.recording, []
        for stamp_s in overlay_stamps(calibration, MOMENTS):
            pair = _pair_at(recording, stamp_s)
            shots.append(Photograph(stamp_s, recording.reader.colour(pair.left), recording.mask_rays(pair.stamp_ns)))
        return Photographs(recording.rig.left, tuple(shots))

    def remarks(self) -> tuple[str, ...]:
        """Return which images are brighter than the range that was learnt, and what a vehicle mask did."""
        recording = self.recording
        told = () if recording.mask is None else recording.mask.tally.sentences()
        return (*recording.reader.remarks(), *(f"vehicle mask: {sentence}" for sentence in told))


def calibrate(left: Path | str, right: Path | str, cam: Path | str, options: Options | None = None) -> Result:
    """Calibrate a stereo camera from two folders of images and a log of Cooperative Awareness Messages.

    Parameters
    ----------
    left, right : path
        Folders of images whose times are in their names, or in a ``timestamps.txt`` among them.
    cam : path
        The log, in any format that `read_cam_log` reads.
    options : Options

    Raises
    ------
    InputError
        If something cannot be read or makes no sense.
    CalibrationError
        If it was read but does not determine a transform.
    """
    return prepare(Path(left), Path(right), Path(cam), options).run()


def prepare(
    left: Path, right: Path, cam: Path, options: Options | None = None, turn: RightTurn | None = None
) -> StereoJob:
    """Read and check the inputs; of the images, a few pairs only, to find whether the right camera has rotated.

    Parameters
    ----------
    left, right, cam, options
        As for `calibrate`.
    turn : RightTurn or None
        Rotation of the right camera since the stereo calibration; None takes it from the options, or else from the
        images.

    Raises
    ------
    InputError
    """
    options = options or Options()
    pairs = pair_images(ImageFolder.open(left), ImageFolder.open(right))
    stereo = calibration_files(options.stereo, left)
    size = first_size(pair.left for pair in pairs.pairs)
    rig = read_stereo_calibration(stereo, size, left, options.camera.baseline_m, right)
    span_ns = pairs.pairs[0].stamp_ns, pairs.pairs[-1].stamp_ns
    drive = read_drive(cam, options.lane_map or find_lane_map(left), span_ns, options)
    mask = None if options.mask is None else VehicleMask.load(options.mask)
    if turn is None:  # last, since matching takes seconds and inputs are refused before it
        told = options.camera.turn_deg
        images = already_rectified(rig) if options.camera.rectified else rig
        turn = find_turn(images, pairs.pairs) if told is None else RightTurn(told)
    asked, options = options, _knowing(options, turn, pairs)
    recording = _recording(left, pairs, rig, options, mask)
    unpaired = pairs.unpaired_left + pairs.unpaired_right
    apart = _apart(pairs, recording.rectification.baseline_m)
    stamps = StampErrors.of("images", np.array([pair.stamp_ns for pair in pairs.pairs]))
    of_pairs = _notes(pairs) + apart + stamps.notes
    return StereoJob(
        recording=recording,
        drive=drive,
        options=options,
        provenance=Provenance(
            name=recording.name,
            kind=recording.kind,
            frame=RECTIFIED_FRAME if options.camera.rectified else RAW_FRAME,
            inputs={
                str(left): len(pairs),
                str(right): len(pairs),
                **{str(path): sha256(path) for path in stereo},
                **_mask_files(options.mask),
                **drive.files,
            },
            config=options.config(),
            notes=of_pairs + _understood(recording) + turn.notes + _assumed(recording) + drive.notes,
            T_sensor_rectified=recording.rectification.T_sensor_rectified,
        ),
        inputs=f"{len(pairs)} image pairs ({unpaired} unpaired), {len(drive.messages)} CAMs",
        turn=turn,
        turned=partial(prepare, left, right, cam, asked),
        failures=turn.failures,
        doubts=turn.doubts
        + (apart if np.median(pairs.apart_ns) > 1e9 * TRIGGERED_S else ())
        + stamps.doubts(options.core.match),
    )


def _knowing(options: Options, turn: RightTurn, pairs: Pairs) -> Options:
    """Return options with the right camera's rotation, and how far apart left and right images may be.

    The yaw, unknown so far, may be as large as the other angles. The resulting shift of all disparities is an error
    that all points share, on the vehicle and, as far as the vehicle has left it undetermined, on the road. Times of
    left and right images that differ may be those of the exposures, or of the images' arrival.
    """
    camera, core = replace(options.camera, turn_deg=turn.turn_deg), options.core
    bias, shared = (
        float(np.hypot(share, off_px / camera.disparity_floor_px))
        for share, off_px in (
            (core.joint.bias_noise_share, turn.off_px),
            (core.ground.shared_noise_share, turn.left_px),
        )
    )
    apart_s = float(np.sqrt(np.mean((pairs.apart_ns / 1e9) ** 2)))
    joint = replace(core.joint, bias_noise_share=bias, apart_sigma_s=max(core.joint.apart_sigma_s, apart_s))
    ground = replace(core.ground, shared_noise_share=shared)
    return replace(options, camera=camera, core=replace(core, joint=joint, ground=ground))


def _recording(left: Path, pairs: Pairs, rig: StereoRig, options: Options, mask: VehicleMask | None) -> StereoRecording:
    return StereoRecording(
        pairs.pairs,
        rig,
        options.camera,
        options.core.ground,
        _background(pairs, options.background),
        options.name or left.absolute().parent.name,
        mask,
    )


def _understood(recording: StereoRecording) -> tuple[str, ...]:
    """Return how the stereo calibration was interpreted."""
    return tuple(f"stereo calibration: {note}" for note in recording.rig.notes)


def _assumed(recording: StereoRecording) -> tuple[str, ...]:
    """Return what was assumed about a vehicle mask without a contract."""
    mask = recording.mask
    return () if mask is None or not mask.tally.assumed else (f"{mask.tally.name}: {mask.tally.assumed}",)


def _mask_files(options: MaskOptions | None) -> dict[str, str]:
    if options is None:
        return {}
    contract = options.contract or contract_beside(options.model)
    return {str(path): sha256(path) for path in (options.model, contract) if path is not None}


def _pair_at(recording: StereoRecording, stamp_s: float) -> StereoPair:
    """Return the image pair that is nearest to a time after the recording's first stamp."""
    epoch_ns = recording.span_ns[0]
    return min(recording.pairs, key=lambda pair: abs((pair.stamp_ns - epoch_ns) / 1e9 - stamp_s))


def _background(pairs: Pairs, asked: tuple[int, int] | Path | None) -> Sequence[StereoPair] | None:
    if asked is None:
        return None
    if isinstance(asked, Path):
        return pair_images(ImageFolder.open(asked / "left"), ImageFolder.open(asked / "right")).pairs
    first, last = asked
    check_frames(first, last, len(pairs), "frames")
    return pairs.pairs[first : last + 1]


def _notes(pairs: Pairs) -> tuple[str, ...]:
    unpaired = (("left", pairs.unpaired_left), ("right", pairs.unpaired_right))
    return tuple(f"{count} {side} images without a partner" for side, count in unpaired if count)


def _apart(pairs: Pairs, baseline_m: float) -> tuple[str, ...]:
    """Return how far apart the times of left and right images are, if it is enough to be reported."""
    median_s, largest_s = np.median(pairs.apart_ns) / 1e9, pairs.apart_ns.max() / 1e9
    if largest_s <= SIMULTANEOUS_S:
        return ()
    words = (
        f"left and right images are {1e3 * median_s:.1f} ms apart by their times (median; {1e3 * largest_s:.1f} ms at "
        f"most): a vehicle at {PASSING_MPS:g} m/s drives {PASSING_MPS * largest_s:.2f} m from one to the other, which "
        f"counts as disparity, where the baseline is {baseline_m:.2f} m; give both one time if one trigger releases "
        "both"
    )
    return (words,)
