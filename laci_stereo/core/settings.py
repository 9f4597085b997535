"""Every setting of the core with its default and the reason for it. The command line only overrides these."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from laci_stereo.core.errors import SettingError

SYNCHRONISED_S = 0.010
"""Standard deviation of the offset between two clocks that are synchronised by NTP or GNSS, seconds."""

UNKNOWN_CLOCK_S = 1.0
"""Standard deviation of the offset between clocks that people set by hand and about which nothing else is known."""

EVEN_CELLS = 12
"""Least number of cells of a ground plane: with nine degrees of freedom beyond the plane's three parameters, its
unevenness is estimated to within a quarter."""


@dataclass(frozen=True)
class GroundSettings:
    """How the ground plane is found.

    Attributes
    ----------
    max_tilt_deg : float
        Largest angle between the plane's normal and the sensor's own up axis. Sensors are pitched by up to 35 deg and
        rolled by a few degrees; a wall that faces a sensor pitched by 35 deg appears 55 deg from up.
    min_height_m, max_height_m : float
        Range of the sensor's mounting height above the ground.
    unevenness_m : float
        Largest standard deviation of a road about its plane (crown, ruts). The fit estimates the actual value; points
        farther from the plane, such as those of a pavement behind its kerb of 10 to 15 cm, are not ground.
    min_points : int
        A cloud with fewer points is rejected.
    min_cells : int
        Least number of cells of bearing (0.05 rad wide) that must support the plane: that of a patch of 0.3 rad square.
    min_support_share : float
        Least fraction of the cells with a free view of the plane that must support it; below it, most of the low points
        belong to something else, such as hills. A plane with less support than both limits is accepted as the ground
        only where a road that the sender drives on confirms it.
    max_tilt_sigma_deg : float
        Largest standard deviation of the normal; above it, the points do not span a plane.
    shared_noise_share : float
        Fraction of each point's standard deviation along its line of sight that is one error shared by all points; on
        the road, a second error of the same size is shared by all points of one laser of a scanner. No residual shows
        this error, but it moves the plane. A matcher and a rectification leave a bias of 0.03 to 0.05 px where the
        noise of a pixel is 0.1 to 0.2 px; for the range offset of a LiDAR, makers only promise that it is no larger
        than the noise of its points, and this is a quarter of that.
    """

    max_tilt_deg: float = 48.0
    min_height_m: float = 1.5
    max_height_m: float = 40.0
    unevenness_m: float = 0.02
    min_points: int = 50
    min_cells: int = 36
    min_support_share: float = 0.3
    max_tilt_sigma_deg: float = 1.0
    shared_noise_share: float = 0.25

    @property
    def any_support(self) -> GroundSettings:
        """These settings with the least support that still determines a plane and its unevenness (`EVEN_CELLS`)."""
        return replace(self, min_support_share=0.0, min_cells=min(self.min_cells, EVEN_CELLS))


@dataclass(frozen=True)
class BoxSettings:
    """The paper's box fit (section III-C).

    Attributes
    ----------
    light_bin_m : float
        Width dx of the bins of the light beams. The shortest side, 1.6 m, gets five beams when it is lit in full, and
        each beam holds some points of the near sides even if a vehicle has only 60 points.
    bar_bin_m : float
        Width of the bins of the histogram along the line, the densest of which is the bar P. The bins are never
        narrower than the tolerance, or noise would spread a bar over several bins.
    line_tolerance_m : float
        theta_thresh: points within this distance of the line are its points Q. It must cover the noise and the error of
        a line through few lit points; it widens to two standard deviations where the noise is larger.
    max_tolerance_m : float
        Largest tolerance after widening: half the width of a narrow car, beyond which one line covers two parallel
        sides.
    """

    light_bin_m: float = 0.3
    bar_bin_m: float = 0.2
    line_tolerance_m: float = 0.2
    max_tolerance_m: float = 0.8


@dataclass(frozen=True)
class ClusterSettings:
    """How points are grouped on the ground plan.

    Attributes
    ----------
    cell_m : float
        Side of the cells in which points are counted; well below `reach_m`, so that the discretisation has no effect.
    reach_m : float
        Points nearer to one another than this belong together: more than the gap that a car's windows or an eight-layer
        scanner's beams leave, less than the least distance of 1 m that traffic keeps.
    min_points : int
        Least number of points within reach that make a cluster rather than noise.
    """

    cell_m: float = 0.1
    reach_m: float = 0.7
    min_points: int = 5


@dataclass(frozen=True)
class BackgroundSettings:
    """How the static background is learnt (paper section III-B).

    Attributes
    ----------
    min_height_m : float
        theta_g: points higher above the ground plane are not ground.
    max_height_m : float
        Points higher than this hang above the traffic (EU directive 96/53/EC: vehicles are at most 4 m high).
    cell_m : float
        Side of the cells in which frames are compared.
    tight_share : float
        A box is split in two while points cover less than this fraction of it: the box of an L-shaped building would
        cover the street in front of it.
    smallest_box_m : float
        Boxes no longer than this are not split.
    margin_m : float
        Margin by which boxes are enlarged before points are tested against them, for foliage and the noise of their
        outline.
    """

    min_height_m: float = 0.5
    max_height_m: float = 4.0
    cell_m: float = 0.5
    tight_share: float = 0.5
    smallest_box_m: float = 2.0
    margin_m: float = 0.3


@dataclass(frozen=True)
class VehicleSettings:
    """Which clusters can be a vehicle, and which of their frames are used.

    Attributes
    ----------
    min_height_m : float
        Points higher above the ground plane belong to the vehicle: above kerbs (up to 0.15 m) and lawns, and below the
        bumpers, where a car is longest.
    ground_sigmas : float
        A point must also be above the plane by this many of its own standard deviations.
    max_sigma_m : float
        Points with larger noise along the line of sight are too far away: a quarter of a lane (3.5 m), beyond which two
        standard deviations would put a vehicle into the next lane.
    min_points : int
        A cluster with fewer points is too sparse for a box.
    min_extent_m : float
        A cluster whose box is shorter than this is too small: the narrowest visible side of a car is 1.4 m.
    density_cell_m : float
        Side of the cells in which the density of a cluster is counted.
    density_share : float
        Points at which the cluster's density is below this fraction of its median density are noise.
    max_edge_share : float
        A cluster with a larger fraction of its points at the border of the field of view is cut off there.
    """

    min_height_m: float = 0.25
    ground_sigmas: float = 3.0
    max_sigma_m: float = 0.875
    min_points: int = 10
    min_extent_m: float = 1.0
    density_cell_m: float = 0.2
    density_share: float = 0.35
    max_edge_share: float = 0.02


@dataclass(frozen=True)
class TrackSettings:
    """How clusters are linked into tracks.

    Attributes
    ----------
    max_speed_mps : float
        Largest speed of a vehicle whose speed is not known yet.
    max_acceleration_mps2 : float
        Largest acceleration: emergency braking on dry asphalt is 9 m/s^2.
    jitter_m : float
        Largest jump, from frame to frame, of the median of the visible points of a vehicle.
    max_lost_s : float
        A track that is not seen for longer than this has ended: a lorry of 16 m hides a car at 8 m/s for this time.
    fixture_share : float
        An object that is seen at one place in this fraction of the frames of each third of a recording is stationary.
        At a lane's capacity a vehicle passes every 2 s, and its middle is within three cells of half a metre for 0.3 s
        at 5 m/s.
    """

    max_speed_mps: float = 40.0
    max_acceleration_mps2: float = 9.0
    jitter_m: float = 1.0
    max_lost_s: float = 2.0
    fixture_share: float = 0.2


@dataclass(frozen=True)
class MatchSettings:
    """How the vehicle's two tracks are matched (paper section III-D).

    Attributes
    ----------
    min_vector_m : float
        theta_beta: location vectors relative to the last point of the trace are left out if they are shorter than this.
        A box's centre may be off by half a car's width, which rotates a vector of this length by 5 deg.
    min_frames : int
        Least number of frames in which the vehicle is seen and its position is known.
    min_path_m : float
        Least distance that the vehicle must travel while it is seen, a car's length: the measured position of a
        stationary object wanders by less.
    min_explained : float
        Least fraction of the frames of the vehicle's own track that a match must explain; for any other object, only
        those frames are explained in which the tracks happen to cross.
    clear_log_odds : float
        With smaller log odds against the second hypothesis, or against chance, a warning is given: of a hundred matches
        that are chosen without a warning, at most one may be wrong.
    least_log_odds : float
        With smaller log odds against the second hypothesis, no match is chosen: of the matches just above this limit,
        all of which have a warning, one in ten is another vehicle.
    least_seen_log_odds : float
        With smaller log odds against chance, no match is chosen either. The limit applies at the usual prior that a
        sender is seen, nineteen times in twenty; at even prior odds a match below it would more likely be a stranger.
    clock_sigma_s : float
        Standard deviation of the offset between the sensor's clock and that of the CAMs: 10 ms where both are
        synchronised (by NTP or GNSS), 1 s where nothing is known. The search covers three times this.
    position_sigma_m : float
        Standard deviation of a position relative to those around it: GNSS wanders by 0.2 to 0.3 m during a passage, and
        the position of a complete box is known equally well.
    stretch_m : float
        Distance that a vehicle must travel until the errors of its sightings are independent: at 20 m from the sensor
        its aspect has then turned by 30 deg, and it shows another side.
    """

    min_vector_m: float = 10.0
    min_frames: int = 10
    min_path_m: float = 5.0
    min_explained: float = 0.5
    clear_log_odds: float = math.log(100.0)
    least_log_odds: float = math.log(10.0)
    least_seen_log_odds: float = math.log(20.0)
    clock_sigma_s: float = SYNCHRONISED_S
    position_sigma_m: float = 0.3
    stretch_m: float = 10.0

    @property
    def any_fit(self) -> MatchSettings:
        """These settings with which the best match is chosen, however likely the other hypotheses are."""
        return replace(self, least_log_odds=-math.inf, least_seen_log_odds=-math.inf)


def above_zero(option: str, value: float, unit: str) -> float:
    """Return the value of an option unchanged.

    Raises
    ------
    SettingError
        If it is not a positive finite number.
    """
    if not 0 < value < math.inf:
        raise SettingError(f"{option} is {value} {unit}; needed is a number above 0")
    return value


def with_turn(clock_sigma_s: float, turn_s: float) -> float:
    """Return the standard deviation of the clock offset for a scanner that turns but does not report its points' times.

    The scanner stamps a scan at any moment of a turn and sees the vehicle at any other: two uniform distributions add
    to the offset, each with a variance of a twelfth of the square of a turn's duration.
    """
    return math.hypot(clock_sigma_s, turn_s / math.sqrt(6.0))


@dataclass(frozen=True)
class JointSettings:
    """The priors of the joint estimate, each as one standard deviation, and the correlation of its errors.

    Attributes
    ----------
    clock_sigma_s : float
        Standard deviation of the offset between the sensor's clock and that of the messages: both follow GNSS or NTP.
    heading_sigma_deg : float
        Standard deviation of the messages' heading relative to the vehicle's body, constant over a drive: the mounting
        error of the receiver in the car.
    heading_lag_s : float
        Standard deviation of the time by which the messages' headings lag behind their positions: both are those of the
        same moment (ETSI EN 302 637-2), whose time is given to 1 ms, unless the points contradict that.
    lever_sigma_m : float
        Standard deviation of the reference point's place on the vehicle (the lever arm), which was measured by hand to
        5 cm.
    size_sigma_m : float
        Standard deviation of length and width: messages round to 0.1 m, some senders round up, and some include the
        mirrors.
    position_sigma_m : float
        Standard deviation of positions for which the messages report no accuracy: that of a receiver with carrier-phase
        corrections, the only kind that is good enough for a calibration.
    bias_time_s : float
        Correlation time of a receiver's error, whether the vehicle moves or not: satellites move, and with them the
        atmospheric delays and the multipath from walls change within minutes (Rankin, ION GPS-94).
    bias_way_m : float
        Correlation length of the multipath error along the path: 10 s in town traffic, for which receivers' filters
        hold it.
    shared_variance_share : float
        Fraction of the points' variance that is one error shared by the points on one side in one frame: half of the
        standard deviation, more than on the road (`GroundSettings`), which more matching windows or more layers sample.
    bias_noise_share : float
        Fraction of each point's standard deviation that is one error shared over the whole drive: the rectification's
        or the scanner's, which is the same on the road.
    boxes_range_m : float
        Standard deviation of the range error that all boxes of a detector share: one that completes what it sees to the
        usual size of a car is off by half of what this car differs, 0.05 m for widths and 0.2 m for lengths.
    optics_sigma : float
        Relative standard deviation of a stereo camera's focal length and of its baseline: both are taken as exact
        unless the points contradict them. The error that a calibration with boards leaves, 0.1 to 0.2 %, moves objects
        10 m from the middle of a drive by 2 cm; as a free parameter it resembles an offset of all disparities and is
        known no better than that offset.
    apart_sigma_s : float
        Standard deviation of the time between a stereo camera's left and right images: one trigger exposes both, unless
        the points contradict that.
    block_s : float
        Frames within this time count as one independent sample when the dispersion of the residuals is estimated.
    """

    clock_sigma_s: float = SYNCHRONISED_S
    heading_sigma_deg: float = 0.3
    heading_lag_s: float = 0.001
    lever_sigma_m: float = 0.05
    size_sigma_m: float = 0.05
    position_sigma_m: float = 0.02
    bias_time_s: float = 300.0
    bias_way_m: float = 100.0
    shared_variance_share: float = 0.25
    bias_noise_share: float = GroundSettings.shared_noise_share
    boxes_range_m: float = 0.1
    optics_sigma: float = 1e-5
    apart_sigma_s: float = 1e-6
    block_s: float = 1.0


@dataclass(frozen=True)
class QualitySettings:
    """The published thresholds of the verdict.

    Attributes
    ----------
    max_sigma_m : float
        Largest standard deviation along the track for the verdict "pass": an error of half a lane's width would put a
        vehicle into the wrong lane, and three standard deviations must stay below it.
    max_sigma_deg : float
        Largest standard deviation of the yaw for the verdict "pass": three standard deviations shift an object 60 m
        away by half a lane. The limit of a tilt is twice as large: a tilt raises or lowers objects, and moves them
        horizontally only by the tilt times the sensor's height.
    fail_factor : float
        Beyond this multiple of a limit the verdict is "fail", between the limit and the multiple it is "warn".
    open_m : float
        A direction with a standard deviation of at least this is open, and no result is given: one side of a car could
        be mistaken for the other. Where the messages report a standard deviation of their positions above a third of
        this, the limit is three times the reported value.
    """

    max_sigma_m: float = 0.5
    max_sigma_deg: float = 0.5
    fail_factor: float = 3.0
    open_m: float = 1.0


Method = Literal["joint", "paper"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True)
class Settings:
    """All settings of the core; ``method`` is the estimator: the joint estimator or the paper's."""

    method: Method = "joint"
    ground: GroundSettings = field(default_factory=GroundSettings)
    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    cluster: ClusterSettings = field(default_factory=ClusterSettings)
    box: BoxSettings = field(default_factory=BoxSettings)
    vehicle: VehicleSettings = field(default_factory=VehicleSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    match: MatchSettings = field(default_factory=MatchSettings)
    joint: JointSettings = field(default_factory=JointSettings)
    quality: QualitySettings = field(default_factory=QualitySettings)

    def with_clock(self, sigma_s: float) -> Settings:
        """Return these settings with another standard deviation of the clock offset, seconds."""
        return replace(
            self,
            match=replace(self.match, clock_sigma_s=sigma_s),
            joint=replace(self.joint, clock_sigma_s=sigma_s),
        )
