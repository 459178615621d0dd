"""Bags of ROS 1 and ROS 2, read by rosbags: a folder of SQLite or MCAP, one .db3, .mcap or .bag."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidarcfg.errors import ConversionError, missing
from lidarcfg.io.ros_messages import ros_store

SUFFIXES = (".bag", ".mcap", ".db3")
METADATA = "metadata.yaml"  # of a folder that is a bag of ROS 2


def is_bag(path: Path) -> bool:
    """Whether a path is a bag's by its suffix, or a folder with a bag's metadata."""
    return path.suffix.lower() in SUFFIXES or (path / METADATA).is_file()


@dataclass(frozen=True)
class Message:
    """A message of a bag."""

    topic: str
    kind: str  # its type, such as std_msgs/msg/String
    time_ns: int  # when it was recorded
    value: Any


@dataclass(frozen=True)
class OpenBag:
    """A bag that is being read."""

    path: Path
    reader: Any  # rosbags' AnyReader

    @property
    def topics(self) -> dict[str, str]:
        """The type of each topic's messages."""
        return {connection.topic: connection.msgtype for connection in self.reader.connections}

    def messages(self, *topics: str) -> Iterator[Message]:
        """The messages of some topics, in the order of their recording. Raises ConversionError for damaged ones."""
        from rosbags.highlevel import AnyReaderError

        some = [one for one in self.reader.connections if one.topic in topics]
        for connection, time_ns, raw in self.reader.messages(connections=some) if some else ():
            try:
                value = self.reader.deserialize(raw, connection.msgtype)
            except (AnyReaderError, ValueError, IndexError, KeyError) as error:
                raise ConversionError.damaged(self.path, error, "bag") from None
            yield Message(connection.topic, connection.msgtype, time_ns, value)


@contextmanager
def open_bag(path: Path) -> Iterator[OpenBag]:
    """Open a bag. Types that it does not describe are ROS's own and those of LiDAR drivers. Raises ConversionError."""
    try:
        import rosbags.highlevel
    except ImportError:
        raise missing("rosbags") from None
    version = 1 if path.suffix.lower() == ".bag" else 2
    if not path.exists():
        raise ConversionError(f"{path}: no such file or directory")
    try:
        reader = rosbags.highlevel.AnyReader([path], default_typestore=ros_store(version))
        reader.open()
    except (rosbags.highlevel.AnyReaderError, ValueError, KeyError, IndexError, AssertionError) as error:
        raise ConversionError.damaged(path, error, "bag") from None
    try:
        yield OpenBag(path, reader)
    finally:
        reader.close()
