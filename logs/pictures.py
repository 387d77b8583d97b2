"""The pictures of a log to what is seen in them, on all cores."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import CameraMount, ImageFeatures, LineObservation, PostObservation
from logs.foreign.parts import ImagePart
from logs.progress import Progress, unwatched
from logs.reader import LogFile
from logs.schema import TOPICS

Seen = tuple[tuple[PostObservation, ...], tuple[LineObservation, ...]]
Looking = Callable[[ImagePart], Seen | str]
"""Posts and lines of a picture, or why it cannot be looked at."""

_QUEUED = 8  # pictures in memory for each core
_FEW = 4  # pictures that are not worth a second process


def has_pictures(log: LogFile) -> bool:
    return any(count and "image" in log.plays(source) for source, count in log.sources)


def picture_features(
    log: LogFile, field: FieldMap, progress: Progress = unwatched, processes: int | None = None
) -> Iterator[ImageFeatures]:
    """Of each picture of the log, in order, with the camera's mount at its stamp. `field` says what colour posts are.

    processes: one a core unless told otherwise; 1 stays in this one. What cannot be decoded, and pictures of which the
    log does not say where the camera was, are left out and counted in the log's warnings. FieldlocError where there are
    no pictures or no camera.
    """
    camera = next(log.records(Camera), None)
    if camera is None:
        raise FieldlocError(
            f"{log.path}: pictures need the camera's intrinsics, which the log does not hold: give them with "
            "camera = FILE in a --mapping"
        )
    mounts = _own_mounts(log)
    total = sum(count for source, count in log.sources if "image" in log.plays(source))
    look = partial(_look, field=field, camera=camera)
    done = 0
    for part, seen in _in_order(log.images(), look, processes or os.cpu_count() or 1):
        done += 1
        progress(done, total, "pictures")
        if isinstance(seen, str):
            log.leave_out(part, seen)
            continue
        mount = mounts.get(part.stamp_ns) or log.mount(part)
        if mount is not None:
            yield ImageFeatures(part.stamp_ns, mount, *seen)


def _own_mounts(log: LogFile) -> dict[int, CameraMount]:
    """By stamp, of a log whose image features are fieldloc's own; they name the mount at each picture."""
    topic = TOPICS["image_features"]
    if not any(count and source.topic == topic for source, count in log.sources):
        return {}
    return {
        message.record.stamp_ns: message.record.mount
        for message in log.messages([topic])
        if isinstance(message.record, ImageFeatures)
    }


def _in_order(parts: Iterator[ImagePart], look: Looking, processes: int) -> Iterator[tuple[ImagePart, Seen | str]]:
    first = [part for _, part in zip(range(_FEW), parts, strict=False)]
    if processes == 1 or len(first) < _FEW:
        for one in (*first, *parts):
            yield one, look(one)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        waiting: deque[tuple[ImagePart, Future[Seen | str]]] = deque()
        try:
            for one in (*first, *parts):
                waiting.append((one, pool.submit(look, one)))
                if len(waiting) > _QUEUED * processes:
                    part, future = waiting.popleft()
                    yield part, future.result()
            while waiting:
                part, future = waiting.popleft()
                yield part, future.result()
        finally:
            _abandon(pool)


def _abandon(pool: Executor) -> None:
    """What is not wanted any more is not begun."""
    pool.shutdown(wait=True, cancel_futures=True)


def _look(part: ImagePart, field: FieldMap, camera: Camera) -> Seen | str:
    """In whatever process."""
    from fieldloc.vision.detect import detect
    from fieldloc.vision.picture import decode
    from fieldloc.vision.raw_picture import from_pixels

    try:
        if part.width_px:
            picture = from_pixels(part.data, part.format, part.width_px, part.height_px, part.step)
        else:
            picture = decode(part.data, part.frame or "picture")
    except (FieldlocError, ValueError) as error:
        return str(error)
    height_px, width_px = picture.shape[:2]
    if (width_px, height_px) != (camera.width_px, camera.height_px):
        return f"it is {width_px} by {height_px}, the camera's pictures are {camera.width_px} by {camera.height_px}"
    found = detect(picture, field.colours, camera)
    return tuple(post.observation() for post in found.posts), tuple(line.observation() for line in found.lines)
