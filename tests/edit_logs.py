"""Logs for the tests of edits, and everything that can be told of one."""

from dataclasses import dataclass, field

from logs.reader.container import open_container
from logs.source import Attachment, RawMessage, Source
from logs.writer import LogWriter

IMU = Source("/imu", "cdr", "sensor_msgs/msg/Imu", "ros2msg", b"float64 x", {"offered_qos_profiles": "- depth: 10"})
TF = Source("/tf", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", b"tf")
TF_STATIC = Source("/tf_static", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", b"tf")
INFO = Source("/camera/camera_info", "cdr", "sensor_msgs/msg/CameraInfo", "ros2msg", b"info")
ROBOT = Source(
    "/robot_description",
    "cdr",
    "std_msgs/msg/String",
    "ros2msg",
    b"string data",
    {"offered_qos_profiles": "- history: 1\n  depth: 1\n  durability: 1\n  liveliness: 1\n"},
)
LATCHED = Source("/map", "ros1", "nav_msgs/OccupancyGrid", "ros1msg", b"map", {"latching": "1"})
PLAIN = Source("/anything", "")
S = 10**9


def write(path, messages, metadata=(), attachments=(), **options):
    """messages: (source, log time, data[, publish time, sequence])."""
    with LogWriter(path, signed=False, **options) as log:
        for name, mapping in metadata:
            log.add_metadata(name, mapping)
        for attachment in attachments:
            log.attach(attachment)
        for message in messages:
            log.write_raw(*message)
    return path


def imu(n=100, step_ns=S // 10, source=IMU, first=0):
    return [(source, first + i * step_ns, b"%d" % i, first + i * step_ns - 7 if i else 0, 1000 + i) for i in range(n)]


def contents(path):
    """All messages with all that belongs to them, in order."""
    container = open_container(path) if not hasattr(path, "messages") else path
    sources = container.sources
    return [
        (key(sources[m.channel]), m.log_time_ns, m.publish_time_ns, m.sequence, m.data)
        for m in container.messages(sources.keys())
    ]


def key(source):
    schema = source.schema_name, source.schema_encoding, source.schema_data
    return source.topic, source.message_encoding, *schema, tuple(sorted(source.metadata.items()))


def times(path, topic):
    return [m[1] for m in contents(path) if m[0][0] == topic]


def datas(path, topic):
    return [m[4] for m in contents(path) if m[0][0] == topic]


@dataclass
class Fake:
    """A recording that no file holds."""

    path: object
    told: list[tuple[Source, RawMessage]]
    damage: tuple[str, ...] = ()
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    promised: dict[int, int] = field(default_factory=dict)
    silent: dict[int, Source] = field(default_factory=dict)

    @property
    def sources(self):
        return {message.channel: source for source, message in self.told} | self.silent

    @property
    def counts(self):
        found = dict.fromkeys(self.sources, 0)
        for _, message in self.told:
            found[message.channel] += 1
        return found | self.promised

    @property
    def span_ns(self):
        times = [message.log_time_ns for _, message in self.told]
        return (min(times), max(times)) if times else None

    def messages(self, channels, start_ns=None, end_ns=None):
        for _, m in sorted(self.told, key=lambda pair: pair[1].log_time_ns):
            late = end_ns is not None and m.log_time_ns >= end_ns
            if m.channel in channels and not late and (start_ns is None or m.log_time_ns >= start_ns):
                yield m

    def attachments(self):
        yield Attachment("fake.txt", "text/plain", 1, 2, b"fake")
