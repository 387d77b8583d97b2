"""Entities of a Foxglove scene: each has an id under which its topic replaces or removes it."""

from collections.abc import Sequence

from foxglove.messages import (
    ArrowPrimitive,
    CylinderPrimitive,
    Duration,
    LinePrimitive,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    TextPrimitive,
    TriangleListPrimitive,
)

from logs.foxglove.shapes import timestamp


def entity(
    name: str,
    stamp_ns: int,
    frame: str,
    life_s: int = 0,
    *,
    arrows: Sequence[ArrowPrimitive] = (),
    cylinders: Sequence[CylinderPrimitive] = (),
    lines: Sequence[LinePrimitive] = (),
    triangles: Sequence[TriangleListPrimitive] = (),
    texts: Sequence[TextPrimitive] = (),
) -> SceneEntity:
    """life_s: 0 is until replaced. It moves with its frame."""
    return SceneEntity(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        id=name,
        lifetime=Duration(life_s),
        frame_locked=True,
        arrows=list(arrows),
        cylinders=list(cylinders),
        lines=list(lines),
        triangles=list(triangles),
        texts=list(texts),
    )


def removal(name: str, stamp_ns: int) -> SceneUpdate:
    """Nothing is there any more under this name."""
    gone = SceneEntityDeletion(timestamp=timestamp(stamp_ns), type=SceneEntityDeletionType.MatchingId, id=name)
    return SceneUpdate(deletions=[gone])


def replacement(stamp_ns: int, entities: Sequence[SceneEntity]) -> SceneUpdate:
    """These in place of all that the topic showed before."""
    gone = SceneEntityDeletion(timestamp=timestamp(stamp_ns), type=SceneEntityDeletionType.All)
    return SceneUpdate(deletions=[gone], entities=list(entities))
