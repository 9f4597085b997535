"""Every setting of the core, its default, and why it has that value. The command line only overrides."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from laci_stereo.core.errors import SettingError

UNKNOWN_CLOCK_S = 1.0
"""Standard deviation of the offset between clocks of which nothing is known but that people set them."""

EVEN_CELLS = 12
"""So many cells at least: nine beyond a plane's three numbers tell how uneven it is to within a quarter."""


@dataclass(frozen=True)
class GroundSettings:
    """How the ground plane is found.

    Attributes
    ----------
    max_tilt_deg : float
        Largest angle between the plane's normal and the sensor's own up axis. Sensors are pitched by up to 35 deg
        and rolled by a few; a wall that faces a sensor pitched by 35 deg appears 55 deg from up.
    min_height_m, max_height_m : float
        Between these the sensor hangs over the ground.
    unevenness_m : float
        Largest standard deviation of a road about its plane (crown, ruts). The fit estimates what it really is; what
        is farther away, such as a pavement behind its kerb of 10 to 15 cm, is not the ground.
    min_points : int
        Fewer points than this are no cloud.
    min_cells : int
        Cells of bearing (0.05 rad wide) that must support the plane: as many as a patch of 0.3 rad square has.
    min_support_share : float
        Of the cells with a free view of the plane so many must support it; else what lies low is mostly something else,
        such as hills. Of less than both it takes a road where the sender drives to know that the plane is the ground.
    max_tilt_sigma_deg : float
        Where the normal is known less well than this, the points do not span a plane.
    shared_noise_share : float
        Of each point's standard deviation along its line of sight, the part that errs for all points alike, and on the
        road as much again for all of one laser of a scanner. No residual shows it, but it moves the plane. A matcher
        and a rectification leave a bias of 0.03 to 0.05 px where a pixel is known to 0.1 to 0.2 px; of a LiDAR's offset
        of range makers only promise that it is no larger than the scatter of its points, and this is a quarter of that.
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
        """The same, but by them a plane may be the ground that hardly more supports than tells how even it is."""
        return replace(self, min_support_share=0.0, min_cells=min(self.min_cells, EVEN_CELLS))


@dataclass(frozen=True)
class BoxSettings:
    """The paper's box fit (section III-C).

    Attributes
    ----------
    light_bin_m : float
        Width dx of the bins of the light beams. The shortest side, 1.6 m, gets five beams when it is lit in full, and a
        beam is hit by some points of the near sides even where a vehicle has only 60.
    bar_bin_m : float
        Width of the bins of the histogram along the line, whose densest is the bar P. Never narrower than the
        tolerance, or noise would spread a bar over several bins.
    line_tolerance_m : float
        theta_thresh: points this near to the line are its points Q. It must cover the noise, and the error of a line
        through few lit points; it widens to two standard deviations where the noise is larger.
    max_tolerance_m : float
        Where that widening ends: at half the width of a narrow car, where one line takes up two parallel sides.
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
        Side of the cells in which points are counted; well below `reach_m`, so that it does not matter.
    reach_m : float
        Points nearer than this belong together: more than the gap that a car's windows or an eight-layer scanner's
        beams leave, less than the 1 m that traffic keeps at least.
    min_points : int
        Points within reach that make a cluster rather than noise.
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
        theta_g: what is higher above the ground plane is not ground.
    max_height_m : float
        What is higher hangs above the traffic (EU directive 96/53/EC: vehicles are at most 4 m high).
    cell_m : float
        Side of the cells in which frames are compared.
    tight_share : float
        A box is split in two while points cover less than this share of it: the box of an L-shaped building would
        cover the street before it.
    smallest_box_m : float
        Boxes no longer than this are not split.
    margin_m : float
        Boxes are grown by this much before they are tested against, for foliage and the noise of their outline.
    """

    min_height_m: float = 0.5
    max_height_m: float = 4.0
    cell_m: float = 0.5
    tight_share: float = 0.5
    smallest_box_m: float = 2.0
    margin_m: float = 0.3


@dataclass(frozen=True)
class VehicleSettings:
    """Which clusters can be a vehicle, and which frames of it are used.

    Attributes
    ----------
    min_height_m : float
        Points higher above the ground plane are the vehicle's: above kerbs (up to 0.15 m) and lawns, and below the
        bumpers, where a car is longest.
    ground_sigmas : float
        A point must also be above the plane by this many of its own standard deviations.
    max_sigma_m : float
        Points whose noise along the line of sight is larger are too far away: a quarter of a lane (3.5 m), beyond which
        a vehicle would be in the next one at two sigma.
    min_points : int
        A cluster with fewer is too thin for a box.
    min_extent_m : float
        A cluster whose box is shorter is too small: the narrowest side of a car that can be seen is 1.4 m.
    density_cell_m : float
        Side of the cells in which the density of a cluster is counted.
    density_share : float
        Points where the cluster is thinner than this share of its median density are noise.
    max_edge_share : float
        A cluster with more of its points at the border of the field of view is cut off there.
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
        Of a vehicle whose speed is not known yet.
    max_acceleration_mps2 : float
        Emergency braking on dry asphalt is 9 m/s^2.
    jitter_m : float
        By how much the middle of what is visible of a vehicle jumps from frame to frame.
    max_lost_s : float
        A track that was not seen for longer is over: what hides a car at 8 m/s is a lorry of 16 m.
    fixture_share : float
        What is seen at one place in this share of the frames of each third of a recording stands there. At a lane's
        capacity a vehicle passes every 2 s, and its middle is within three cells of half a metre for 0.3 s at 5 m/s.
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
        theta_beta: shorter location vectors, relative to the last point of the trace, are left out. A box's centre may
        be off by half a car's width, which turns a vector of this length by 5 deg.
    min_frames : int
        Frames in which the vehicle must be seen and its position be known.
    min_path_m : float
        The vehicle must move by this much while it is seen, a car's length: what stands wanders by less.
    min_explained : float
        Of the frames of a track that is the vehicle's, at least this share is explained; what else moves is explained
        where the tracks happen to cross.
    clear_log_odds : float
        By less than this over the second hypothesis, or over chance, there is a warning: of a hundred that are chosen
        without one, at most one may be wrong.
    least_log_odds : float
        By less than this over the second hypothesis nothing is chosen: of the matches that are just taken, all with a
        warning, one in ten is another vehicle.
    least_seen_log_odds : float
        By less than this over chance, if senders are seen as usual, which is nineteen of twenty times, nothing is
        chosen either: were they seen as often as not, it would rather be a stranger.
    clock_sigma_s : float
        Standard deviation of the offset between the sensor's clock and the CAMs': 10 ms where both are synchronised
        (by NTP or GNSS), 1 s where nothing is known. Searched is up to three times that.
    position_sigma_m : float
        Of a position relative to those around it: GNSS wanders by 0.2 to 0.3 m during a passage, and a complete box is
        known as well.
    stretch_m : float
        A vehicle must drive so far until its sightings err independently: at 20 m from the sensor it has then turned by
        30 deg, and shows another side.
    """

    min_vector_m: float = 10.0
    min_frames: int = 10
    min_path_m: float = 5.0
    min_explained: float = 0.5
    clear_log_odds: float = math.log(100.0)
    least_log_odds: float = math.log(10.0)
    least_seen_log_odds: float = math.log(20.0)
    clock_sigma_s: float = 0.010
    position_sigma_m: float = 0.3
    stretch_m: float = 10.0

    @property
    def any_fit(self) -> MatchSettings:
        """The same, but by them whatever fits best is chosen, however likely others are."""
        return replace(self, least_log_odds=-math.inf, least_seen_log_odds=-math.inf)


def above_zero(option: str, value: float, unit: str) -> float:
    """Return what an option says.

    Raises
    ------
    SettingError
        If it is not a positive number.
    """
    if not 0 < value < math.inf:
        raise SettingError(f"{option} is {value} {unit}; needed is a number above 0")
    return value


def with_turn(clock_sigma_s: float, turn_s: float) -> float:
    """Return how well the clocks' offset is known where a scanner turns and does not tell the points' times.

    It stamps a scan at any moment of a turn, and sees the vehicle at any other: two uniform distributions add to the
    offset, with a variance of a twelfth of a turn's square each.
    """
    return math.hypot(clock_sigma_s, turn_s / math.sqrt(6.0))


@dataclass(frozen=True)
class JointSettings:
    """What the joint estimate takes as known beforehand, each as one standard deviation.

    Attributes
    ----------
    clock_sigma_s : float
        Of the offset between the sensor's clock and the messages': both follow a GNSS or NTP.
    heading_sigma_deg : float
        Of the messages' heading against the vehicle's body, constant over a drive: how a receiver is fitted into a car.
    lever_sigma_m : float
        Of the reference point's place on the vehicle: it was measured by hand, to 5 cm.
    size_sigma_m : float
        Of length and width: messages round to 0.1 m, some senders upwards, and some count the mirrors.
    position_sigma_m : float
        Of positions whose accuracy the messages do not tell: that of a receiver with carrier-phase corrections, the
        only kind that a calibration is worth being made with.
    bias_time_s : float
        Time over which a receiver's error decays, moving or not: satellites move on, and with them what reaches an
        antenna through the air and by way of walls, in minutes (Rankin, ION GPS-94).
    bias_way_m : float
        Way over which what walls reflect is another thing: 10 s in a town's traffic, as receivers' filters hold it.
    shared_variance_share : float
        Of the variance of points, what those on one side in one frame have in common: half of the standard deviation,
        more than on the road (`GroundSettings`), of which more windows of a matcher or more layers tell.
    bias_noise_share : float
        Of each point's standard deviation, the part that errs alike all the way: the rectification's or the scanner's,
        which is the same on the road.
    optics_sigma : float
        Of a stereo camera's focal length and of its baseline, as a share: these are taken for exact, unless the points
        contradict them. What boards leave, 0.1 to 0.2 %, moves what is seen 10 m from the middle of a drive by 2 cm,
        while left free it looks like an offset of all disparities, and is known no better than that.
    block_s : float
        What so many seconds of frames say is one statement when the scatter of the residuals is weighed.
    """

    clock_sigma_s: float = 0.010
    heading_sigma_deg: float = 0.3
    lever_sigma_m: float = 0.05
    size_sigma_m: float = 0.05
    position_sigma_m: float = 0.02
    bias_time_s: float = 300.0
    bias_way_m: float = 100.0
    shared_variance_share: float = 0.25
    bias_noise_share: float = GroundSettings.shared_noise_share
    optics_sigma: float = 1e-5
    block_s: float = 1.0


@dataclass(frozen=True)
class QualitySettings:
    """The published thresholds of the verdict.

    Attributes
    ----------
    max_sigma_m : float
        Up to this standard deviation along the track the verdict is a pass: half a lane's width would put a vehicle
        into the wrong lane, and three sigma must stay below it.
    max_sigma_deg : float
        The same for the yaw: three sigma shift an object 60 m away by half a lane. A tilt may be known half as well: it
        lifts objects, and moves them by its share of the sensor's height only.
    fail_factor : float
        Beyond this multiple of a limit the verdict is a fail, in between a warning.
    open_m : float
        A direction that is known no better than this is open, and no result is given: one side of a car could be taken
        for the other. Where the messages tell that their positions are worse than a third of it, three times what they
        tell is the limit.
    """

    max_sigma_m: float = 0.5
    max_sigma_deg: float = 0.5
    fail_factor: float = 3.0
    open_m: float = 1.0


Method = Literal["joint", "paper"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True)
class Settings:
    """All settings of the core; ``method`` is the estimator: the joint one, or the paper's."""

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
