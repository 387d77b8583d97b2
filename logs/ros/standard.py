"""The definitions of standard types as text, for bags and messages that come without."""

from functools import cache


@cache
def standard_text(name: str) -> tuple[str, bytes]:
    """Schema encoding and data of a ROS 2 type, with all it is made of; two empties for a type of someone's own."""
    from rosbags.typesys import Stores, TypesysError, get_typestore

    try:
        return "ros2msg", get_typestore(Stores.LATEST).generate_msgdef(name, ros_version=2)[0].encode()
    except (TypesysError, KeyError):
        return "", b""
