"""Bags as others write them, by rosbags."""

from pathlib import Path

import numpy as np
import ros_messages
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from logs.source import Container

TYPES = ("nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/Imu")
Logged = tuple[str, int, bytes]
"""Topic, time, bytes."""


def contents(count: int, ros1: bool = False, start: int = 0) -> list[Logged]:
    """Three topics in turn. Times repeat and go back, as they do where a recorder is busy."""
    random = np.random.default_rng(6)
    out = []
    for i in range(start, start + count):
        name = TYPES[i % 3]
        data = ros_messages.packed(ros_messages.random_message(name, random, ros1), name, ros1)
        out.append((topic(name), 1_000_000_000 + 1_000_000 * (i - i % 5), data))
    return out


def topic(name: str) -> str:
    return "/" + name.split("/")[-1].lower()


def write_ros1(path: Path, messages: list[Logged], compression: str = "", chunk_bytes: int = 1500) -> Path:
    writer = Writer1(path)
    writer.chunk_threshold = chunk_bytes
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        connections = {
            topic(name): writer.add_connection(topic(name), name, typestore=ros_messages.store(ros1=True))
            for name in TYPES
        }
        for name, time, data in messages:
            writer.write(connections[name], time, data)
    return path


def write_ros2(path: Path, messages: list[Logged], mcap: bool = False, compression: str = "", version: int = 9) -> Path:
    writer = Writer2(path, version=version, storage_plugin=StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3)
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic(name): writer.add_connection(topic(name), name, typestore=ros_messages.store()) for name in TYPES
        }
        for name, time, data in messages:
            writer.write(connections[name], time, data)
    return path


def read(container: Container, start_ns: int | None = None, end_ns: int | None = None, *topics: str) -> list[Logged]:
    channels = [number for number, source in container.sources.items() if not topics or source.topic in topics]
    out = []
    for message in container.messages(channels, start_ns, end_ns):
        assert message.publish_time_ns == message.log_time_ns
        out.append((container.sources[message.channel].topic, message.log_time_ns, message.data))
    return out


def in_time_order(messages: list[Logged]) -> list[Logged]:
    return sorted(messages, key=lambda message: message[1])
