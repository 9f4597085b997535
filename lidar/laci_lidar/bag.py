"""Scans from a ROS 1 bag, a ROS 2 bag or an MCAP file; requires the extra ``bag``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from laci_lidar.errors import ScanError
from laci_lidar.pointcloud2 import POINT_CLOUD, header_stamp_ns, is_known, read_message
from laci_lidar.scan import Scan, scan_of
from laci_lidar.sequence import counted
from laci_stereo.core.frames import IntArray
from laci_stereo.io.ahead import map_ahead
from laci_stereo.io.bag.files import Bag, open_bag
from laci_stereo.io.bag.records import CutOffError, Message, Topic
from laci_stereo.io.text_file import listed, quoted, shortened

EARLIEST_NS = 10**17
"""March 1973: earlier stamps were never set, or count from the start of the sensor."""

_LATEST_NS = 1 << 63


@dataclass(frozen=True)
class BagScans:
    """The scans of one topic, decoded only on demand (implements `ScanSequence`).

    Attributes
    ----------
    path : Path
    topic : Topic
    stamps_ns : ndarray of int64, shape (n,)
        Stamps of the scans, Unix time, nanoseconds, strictly ascending.
    recorded_ns : ndarray of int64, shape (n,)
        Times at which the messages were recorded.
    by_header : bool
        The stamps are those of the message headers; otherwise they are the times of recording.
    skipped : dict of str to str
        The messages that could not be used so far, each with a one-line reason.
    notes : tuple of str
    """

    path: Path
    topic: Topic
    bag: Bag
    stamps_ns: IntArray
    recorded_ns: IntArray
    by_header: bool
    skipped: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @classmethod
    def open(cls, path: Path, topic: str | None = None) -> BagScans:
        """List the point clouds of a topic.

        Parameters
        ----------
        path : Path
            A ROS 1 bag, a folder with a ROS 2 bag, or one MCAP or SQLite file of it.
        topic : str or None
            None: the only topic with point clouds.

        Raises
        ------
        ScanError
            If the path is no bag; or the topic is missing, one of several, of another type or with an unknown
            definition, or contains no scan.
        """
        bag = open_bag(path, ScanError)
        chosen = _choose(bag.topics(), topic, path)
        if not is_known(chosen.ros1, chosen.definition, chosen.digest):
            raise ScanError(
                f"{path}: the topic {chosen.shown} has a definition of {chosen.type_name} of its own; needed is "
                "that of sensor_msgs/PointCloud2"
            )
        return _listed(path, bag, chosen)

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:
        """Yield the scans at ascending indices; None if a scan is unreadable.

        Raises
        ------
        ScanError
            At the end, if more than a fifth of them were unreadable; or if the bag has changed.
        """
        return counted(map_ahead(self._attempt, self._messages(indices), threads), self.skipped)

    def _messages(self, indices: Sequence[int]) -> Iterator[tuple[int, Message]]:
        """Yield the messages of the scans at ascending indices."""
        some = 2 * len(indices) < len(self)
        messages = self.bag.messages(self.topic.name, self.recorded_ns[list(indices)].tolist() if some else None)
        try:
            for index in indices:
                # The first message with this stamp after the previous one; several may have the same recording time.
                found = next((message for message in messages if self._stamp(message) == self.stamps_ns[index]), None)
                if found is None:
                    raise ScanError(f"{self.path}: the message of scan {index} is missing; the bag has changed")
                yield index, found
        except CutOffError as problem:
            raise ScanError(f"{self.path} cannot be read any more: {problem}") from problem

    def _stamp(self, message: Message) -> int | None:
        return header_stamp_ns(message.data, self.topic.ros1) if self.by_header else message.recorded_ns

    def _attempt(self, item: tuple[int, Message]) -> tuple[str, Scan | ScanError]:
        index, message = item
        name = f"scan {index}"
        what = f"{self.path}, {self.topic.shown}, {name}"
        try:
            return name, scan_of(read_message(message.data, self.topic.ros1, what), what, int(self.stamps_ns[index]))
        except ScanError as problem:
            return name, problem


def _choose(topics: Sequence[Topic], asked: str | None, path: Path) -> Topic:
    clouds = [topic for topic in topics if topic.type_name == POINT_CLOUD]
    described = [f"{topic.name} ({topic.type_name})" for topic in topics]
    if asked is not None:
        found = next((topic for topic in topics if topic.name.strip("/") == asked.strip("/")), None)
        if found is None:
            raise ScanError(f"{path} has no topic {quoted(asked)}; it has {listed(described) or 'none'}")
        if found not in clouds:
            raise ScanError(
                f"{path}: the topic {found.shown} is of type {shortened(found.type_name)}; needed is "
                "sensor_msgs/PointCloud2"
            )
        return found
    if not clouds:
        raise ScanError(f"{path} has no topic of type sensor_msgs/PointCloud2; it has {listed(described) or 'none'}")
    if len(clouds) > 1:
        names = listed([topic.name for topic in clouds])
        raise ScanError(f"{path} has {len(clouds)} topics with point clouds; needed is --topic with one of {names}")
    return clouds[0]


def _listed(path: Path, bag: Bag, topic: Topic) -> BagScans:
    """Read the times of all messages of a topic."""
    times: list[tuple[int, int]] = []
    skipped: dict[str, str] = {}
    notes: list[str] = []
    try:
        for place, message in enumerate(bag.messages(topic.name)):
            stamp = header_stamp_ns(message.data, topic.ros1)
            if stamp is not None and 0 <= message.recorded_ns < _LATEST_NS:
                times.append((stamp, message.recorded_ns))
            else:
                size = len(message.data)
                skipped[f"message {place}"] = f"{path}, {topic.shown}, message {place} of {size} bytes has no time"
                times.append((0, 0))
    except CutOffError as problem:
        promised = bag.count(topic.name)
        lost = f", {promised - len(times)} are lost" if promised is not None and promised > len(times) else ""
        notes.append(f"{path}: {problem}; the {len(times)} whole messages of {topic.shown} are used{lost}")
    if not times:
        raise ScanError(f"{path}: the topic {topic.shown} has 0 whole messages; needed are point clouds")
    stamps, recorded = np.array(times, dtype=np.int64).T
    by_header = bool((stamps >= EARLIEST_NS).mean() > 0.5)
    if not by_header:
        stamps = recorded
        notes.append(f"{path}: the headers of {topic.shown} hold no time; the times of recording are used")
    places = np.flatnonzero((stamps >= EARLIEST_NS) & (stamps > np.maximum.accumulate(np.append(0, stamps[:-1]))))
    unordered = len(times) - len(skipped) - len(places)
    if unordered:
        notes.append(
            f"{path}: {unordered} messages of {topic.shown} are left out, whose time is not after those before"
        )
    if len(places) <= len(times) / 2:
        raise ScanError(
            f"{path}: {len(places)} of {len(times)} messages of {topic.shown} have a time after those before; needed "
            "are ascending Unix times"
        )
    return BagScans(path, topic, bag, stamps[places], recorded[places], by_header, skipped, tuple(notes))
