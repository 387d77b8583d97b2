"""ROS 1 and ROS 2: what other people's robots log. The only room that knows rosbags; it is imported where needed."""

from collections.abc import Callable

from logs.foreign.parts import Part
from logs.ros.types import known_type
from logs.source import Source

__all__ = ["decoder", "known_type"]


def decoder(source: Source) -> Callable[[bytes], Part] | None:
    """What makes parts of this source's messages; None where it is not ROS or no type known here.

    It raises BadPart for a message that does not fit its definition, and for each where the definition itself is bad.
    """
    from logs.ros.decode import decoder

    return decoder(source)
