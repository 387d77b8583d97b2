"""What was seen in one image, and from where, as JSON."""

from collections.abc import Sequence
from itertools import chain, islice

from msgspec import Raw

from fieldloc.measurements import CameraMount, ImageFeatures, LineObservation, PostObservation
from fieldloc.pose import FloatArray
from logs.messages import batch
from logs.messages.fields import (
    STAMP,
    BadField,
    JsonObject,
    covariance,
    fixed,
    fixed_array,
    list_of,
    many,
    maybe,
    number,
    numeric,
    object_schema,
    one,
    or_null,
    stamp,
    string,
    text_or_none,
)

_MOUNT_SCHEMA = object_schema(
    "Where the camera sits on the robot and how it is turned",
    x_m=numeric("Camera's centre ahead of the robot's origin"),
    y_m=numeric("Camera's centre to the left of the robot's origin"),
    height_m=numeric("Camera's centre above the ground, above 0"),
    pan_rad=numeric("Turned to the left of the robot's forward axis"),
    tilt_rad=numeric("Looking down is positive"),
    roll_rad=numeric("About the optical axis, the camera's right side down is positive"),
    covariance=fixed("Covariance of (height_m, pan_rad, tilt_rad, roll_rad), common to the whole image", 4, 4),
)
_POST_SCHEMA = object_schema(
    "A goal post",
    label=or_null(string("Its name on the map; null: identity unknown")),
    edges_px=fixed("[u, v] of a point on its left edge and of one on its right edge", 2, 2),
    covariance_px2=fixed("Covariance of (left u, left v, right u, right v)", 4, 4),
    foot_px=or_null(fixed("[u, v] of the middle of where it meets the ground; null: not seen", 2)),
    foot_covariance_px2=or_null(fixed("Covariance of foot_px; null with it", 2, 2)),
)
_LINE_SCHEMA = object_schema(
    "The visible part of a white line's middle",
    ends_px=fixed("[u, v] of both ends", 2, 2),
    covariance_px2=fixed("Covariance of (u0, v0, u1, v1)", 4, 4),
)
IMAGE_FEATURES_SCHEMA = object_schema(
    "Posts and lines of one image",
    stamp_ns=STAMP,
    mount=_MOUNT_SCHEMA,
    posts=list_of(_POST_SCHEMA, "Goal posts"),
    lines=list_of(_LINE_SCHEMA, "White lines"),
)


def image_features_to_json(record: ImageFeatures) -> JsonObject:
    return {
        "stamp_ns": int(record.stamp_ns),
        "mount": _mount_to_json(record.mount),
        "posts": [_post_to_json(post) for post in record.posts],
        "lines": [
            {"ends_px": line.ends_px.tolist(), "covariance_px2": line.covariance_px2.tolist()} for line in record.lines
        ],
    }


def image_features_from_json(data: JsonObject) -> ImageFeatures:
    posts, lines = many(data, "posts", _post_from_json), many(data, "lines", _line_from_json)
    return ImageFeatures(stamp(data), one(data, "mount", _mount_from_json), tuple(posts), tuple(lines))


def _mount_to_json(mount: CameraMount) -> JsonObject:
    return {
        "x_m": float(mount.x_m),
        "y_m": float(mount.y_m),
        "height_m": float(mount.height_m),
        "pan_rad": float(mount.pan_rad),
        "tilt_rad": float(mount.tilt_rad),
        "roll_rad": float(mount.roll_rad),
        "covariance": mount.covariance.tolist(),
    }


def _mount_from_json(data: JsonObject) -> CameraMount:
    return CameraMount(
        height_m=number(data, "height_m", above=0.0),
        pan_rad=number(data, "pan_rad"),
        tilt_rad=number(data, "tilt_rad"),
        roll_rad=number(data, "roll_rad"),
        covariance=covariance(data, "covariance", 4),
        x_m=number(data, "x_m"),
        y_m=number(data, "y_m"),
    )


def _post_to_json(post: PostObservation) -> JsonObject:
    return {
        "label": post.label,
        "edges_px": post.edges_px.tolist(),
        "covariance_px2": post.covariance_px2.tolist(),
        "foot_px": None if post.foot_px is None else post.foot_px.tolist(),
        "foot_covariance_px2": None if post.foot_covariance_px2 is None else post.foot_covariance_px2.tolist(),
    }


def _post_from_json(data: JsonObject) -> PostObservation:
    foot = maybe(data, "foot_px", fixed_array, 2)
    foot_covariance = maybe(data, "foot_covariance_px2", covariance, 2)
    if (foot is None) != (foot_covariance is None):
        raise BadField("foot_covariance_px2", "must be null exactly when foot_px is")
    return PostObservation(
        edges_px=fixed_array(data, "edges_px", 2, 2),
        covariance_px2=covariance(data, "covariance_px2", 4),
        foot_px=foot,
        foot_covariance_px2=foot_covariance,
        label=text_or_none(data, "label"),
    )


def _line_from_json(data: JsonObject) -> LineObservation:
    return LineObservation(fixed_array(data, "ends_px", 2, 2), covariance(data, "covariance_px2", 4))


class _MountMessage(batch.Message):
    x_m: float
    y_m: float
    height_m: float
    pan_rad: float
    tilt_rad: float
    roll_rad: float
    covariance: Raw


class _PostMessage(batch.Message):
    label: str | None
    edges_px: tuple[batch.Pair, batch.Pair]
    covariance_px2: Raw
    foot_px: batch.Pair | None
    foot_covariance_px2: Raw


class _LineMessage(batch.Message):
    ends_px: tuple[batch.Pair, batch.Pair]
    covariance_px2: Raw


class _ImageMessage(batch.Message):
    stamp_ns: object
    mount: _MountMessage
    posts: list[_PostMessage]
    lines: list[_LineMessage]


_read_images = batch.reader(_ImageMessage)


def image_features_batch(datas: Sequence[bytes]) -> list[ImageFeatures]:
    read = _read_images(datas)
    mounts = [m.mount for m in read]
    seen_posts = [post for m in read for post in m.posts]
    seen_lines = [line for m in read for line in m.lines]
    stated = [m.covariance for m in mounts]
    stated += [m.covariance_px2 for m in seen_posts]
    stated += [m.covariance_px2 for m in seen_lines]
    matrices = iter(batch.covariances(stated, 4))  # all at once: a check's price is mostly that of asking
    mount_records = _mounts(mounts, [*islice(matrices, len(mounts))])
    posts = iter(_posts(seen_posts, [*islice(matrices, len(seen_posts))]))
    lines = iter(_lines(seen_lines, [*matrices]))
    return batch.records(
        ImageFeatures,
        batch.stamps([m.stamp_ns for m in read]),
        mount_records,
        [tuple(islice(posts, len(m.posts))) for m in read],
        [tuple(islice(lines, len(m.lines))) for m in read],
    )


def _mounts(read: Sequence[_MountMessage], covariances: list[FloatArray]) -> list[CameraMount]:
    batch.positive([m.height_m for m in read])
    return batch.records(
        CameraMount,
        [m.height_m for m in read],
        [m.pan_rad for m in read],
        [m.tilt_rad for m in read],
        [m.roll_rad for m in read],
        covariances,
        [m.x_m for m in read],
        [m.y_m for m in read],
    )


def _posts(read: Sequence[_PostMessage], covariances: list[FloatArray]) -> list[PostObservation]:
    edges = batch.arrays(chain.from_iterable(chain.from_iterable([m.edges_px for m in read])), 2, 2)
    feet = iter(batch.arrays(chain.from_iterable([m.foot_px for m in read if m.foot_px is not None]), 2))
    foot_covariances = batch.covariances_or_none([m.foot_covariance_px2 for m in read], 2)
    if any((m.foot_px is None) != (matrix is None) for m, matrix in zip(read, foot_covariances, strict=True)):
        raise batch.Odd
    return batch.records(
        PostObservation,
        edges,
        covariances,
        [None if m.foot_px is None else next(feet) for m in read],
        foot_covariances,
        [m.label for m in read],
    )


def _lines(read: Sequence[_LineMessage], covariances: list[FloatArray]) -> list[LineObservation]:
    ends = batch.arrays(chain.from_iterable(chain.from_iterable([m.ends_px for m in read])), 2, 2)
    return batch.records(LineObservation, ends, covariances)
