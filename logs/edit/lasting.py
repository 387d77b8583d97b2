"""What is said once and holds from then on: lost by a cut that starts later, unless it is carried over.

| what | how it is known | carried |
|---|---|---|
| static transforms | a topic named tf_static | every different message: each adds its own |
| the field's map, the camera | fieldloc.FieldMap, fieldloc.Camera | the last |
| a camera's calibration | sensor_msgs CameraInfo, foxglove.CameraCalibration | the last |
| what ROS keeps for who comes late | QoS transient local (ROS 2), latching (ROS 1) | the last |

A topic of the last two kinds that speaks again within a second of the start needs no help: most cameras send their
calibration with every image. /initial_pose is not among them: it was true at its own time only.
"""

from collections.abc import Collection

from logs.source import Container, RawMessage, is_latched

_SOON_NS = 10**9
_MOST = 1000  # different static transforms that are remembered
_OURS = ("fieldloc.FieldMap.", "fieldloc.Camera.")
_CALIBRATIONS = ("sensor_msgs/CameraInfo", "sensor_msgs/msg/CameraInfo", "foxglove.CameraCalibration")


def carried(
    container: Container, channels: Collection[int], start_ns: int, end_ns: int | None = None
) -> list[RawMessage]:
    """Messages from before the start that still hold there, in their order, with the start as their log time."""
    sources = container.sources
    static = {i for i in channels if sources[i].topic.rpartition("/")[2] == "tf_static"}
    ours = {i for i in channels if sources[i].schema_name.startswith(_OURS)}
    others = {i for i in channels if sources[i].schema_name in _CALIBRATIONS or is_latched(sources[i])} - static
    soon_ns = start_ns + _SOON_NS if end_ns is None else min(start_ns + _SOON_NS, end_ns)
    lasting = ours - _speaking(container, ours, start_ns, start_ns + 1)
    lasting |= others - _speaking(container, others, start_ns, soon_ns)
    found: dict[int | bytes, RawMessage] = {}
    if not static | lasting:
        return []
    for message in container.messages(static | lasting, None, start_ns):
        key = message.data if message.channel in static else message.channel
        found.pop(key, None)  # so that the order is that of the last time each was said
        found[key] = message
        if len(found) > _MOST + len(lasting):
            del found[next(iter(found))]
    return [message._replace(log_time_ns=start_ns) for message in found.values()]


def _speaking(container: Container, channels: Collection[int], start_ns: int, end_ns: int) -> set[int]:
    """Those of the channels that have a message in this time."""
    if not channels:
        return set()
    return {message.channel for message in container.messages(channels, start_ns, end_ns)}
