"""Messages in bags: intact bags are read by rosbags, damaged ones record by record. Requires the extra ``bag``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from laci_stereo.core.errors import InputError
from laci_stereo.io.bag.records import ROS1_MAGIC, CutOffError, Message, Topic, begins, walk
from laci_stereo.io.text_file import quoted


class Bag(Protocol):
    """The messages of a bag, which can be iterated repeatedly."""

    def topics(self) -> list[Topic]:
        """Return the topics, each once."""

    def count(self, topic: str) -> int | None:
        """Return how many messages a topic should have, or None if the bag does not state it."""

    def messages(self, topic: str, times_ns: Sequence[int] | None = None) -> Iterator[Message]:
        """Yield a topic's messages in the order of recording: all, or those recorded at the given times.

        Raises
        ------
        CutOffError
            Where the bag is damaged, after the intact messages.
        """


def open_bag(path: Path, error: type[InputError]) -> Bag:
    """Open a ROS 1 bag, a folder that ROS 2 recorded, or one of its files.

    Raises
    ------
    InputError
        Of the class ``error``.
    """
    try:
        whole = WholeBag(path)
        try:
            whole.topics()
        except CutOffError:
            files = _storage_files(path)
        else:
            return whole
    except OSError as problem:
        raise error(f"{path} cannot be read: {problem.strerror}; needed is a bag") from problem
    if not files:
        raise error(f"{path} holds no .mcap or .db3 file; needed is a folder that ROS 2 recorded")
    return DamagedBag(path, files)


class WholeBag:
    """An intact bag, read by rosbags."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ros1 = path.is_file() and begins(path, ROS1_MAGIC)

    def topics(self) -> list[Topic]:
        """Return the topics, each once."""
        return list({topic.name: topic for topic, _ in self._connections()}.values())

    def count(self, topic: str) -> int | None:
        """Return how many messages a topic has."""
        return sum(count for found, count in self._connections() if found.name == topic)

    def messages(self, topic: str, times_ns: Sequence[int] | None = None) -> Iterator[Message]:
        """Yield a topic's messages, see `Bag`."""
        windows = [(None, None)] if times_ns is None else [(time, time + 1) for time in times_ns]
        try:
            with self._reader() as reader:
                wanted = [connection for connection in reader.connections if connection.topic == topic]
                found = {connection.id: _topic(connection, self._ros1) for connection in wanted}
                for start, stop in windows:
                    for connection, recorded_ns, data in reader.messages(wanted, start, stop):
                        yield Message(found[connection.id], recorded_ns, bytes(data))
        except Exception as problem:  # of many kinds: the bytes may be anything
            raise CutOffError(_in_a_line(problem)) from problem

    def _connections(self) -> list[tuple[Topic, int]]:
        try:
            with self._reader() as reader:
                return [(_topic(connection, self._ros1), connection.msgcount) for connection in reader.connections]
        except Exception as problem:  # of many kinds: the bytes may be anything
            raise CutOffError(_in_a_line(problem)) from problem

    def _reader(self) -> Reader1 | Reader2:
        return Reader1(self._path) if self._ros1 else Reader2(self._path)


def _topic(connection: Connection, ros1: bool) -> Topic:
    return Topic(connection.topic, connection.msgtype, ros1, connection.msgdef.data, connection.digest)


def _in_a_line(problem: Exception) -> str:
    return quoted(str(problem) or type(problem).__name__)


class DamagedBag:
    """A bag whose index or end is missing, read record by record from the start."""

    def __init__(self, path: Path, files: Sequence[Path]) -> None:
        self._path = path
        self._files = files

    def topics(self) -> list[Topic]:
        """Return the topics that have an intact message, each once."""
        found: dict[str, Topic] = {}
        with suppress(CutOffError):
            for message in self._all():
                found.setdefault(message.topic.name, message.topic)
        return list(found.values())

    def count(self, topic: str) -> int | None:
        """Return how many messages a topic should have by ``metadata.yaml``, or None without that, as in ROS 1."""
        try:
            metadata = YAML(typ="safe").load((self._path / "metadata.yaml").read_text())
            topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
            return sum(int(told["message_count"]) for told in topics if told["topic_metadata"]["name"] == topic)
        except (OSError, UnicodeDecodeError, YAMLError, TypeError, KeyError, ValueError):
            return None

    def messages(self, topic: str, times_ns: Sequence[int] | None = None) -> Iterator[Message]:
        """Yield a topic's messages, see `Bag`."""
        times = None if times_ns is None else set(times_ns)
        for message in self._all():
            if message.topic.name == topic and (times is None or message.recorded_ns in times):
                yield message

    def _all(self) -> Iterator[Message]:
        for file in self._files:
            try:
                yield from walk(file)
            except CutOffError as problem:
                raise CutOffError(f"{file.name} is damaged or cut off: {problem}") from problem
            except Exception as problem:  # of many kinds: the bytes may be anything
                raise CutOffError(f"{file.name} is damaged or cut off: {_in_a_line(problem)}") from problem


def _storage_files(path: Path) -> list[Path]:
    """Return the storage files of a bag in the order in which they were written."""
    if path.is_file():
        return [path]
    files = [file for file in path.iterdir() if file.suffix in (".mcap", ".db3") and file.is_file()]
    return sorted(
        files, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
    )
