"""What the camera of a simulated robot sees in a game: posts and lines, image by image, with all that goes wrong."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures, LineObservation, PostObservation
from fieldloc.pose import FloatArray
from logs.simulate.course import Course
from logs.simulate.cylinders import cylinders_of, people_around
from logs.simulate.line_detector import FoundLines, find_lines
from logs.simulate.post_detector import FoundPosts, find_posts
from logs.simulate.segments import segments_of
from logs.simulate.shots import Shots, take_shots
from logs.simulate.view import view_of
from logs.simulate.vision_settings import VisionSettings

_BLOCK = 500  # images at once: fast, and some megabytes only
_Record = TypeVar("_Record")


class SimulatedCamera:
    """A camera with its errors, drawn once; everything after it is fixed by the draw, however often it is asked for."""

    def __init__(self, settings: VisionSettings, random: np.random.Generator) -> None:
        self._settings = settings
        mount = settings.mount
        sigma = [mount.error_height_m, mount.error_pan_rad, mount.error_tilt_rad, mount.error_roll_rad]
        self._mount_error = np.array(sigma) * random.standard_normal(4)
        self._shot_seed, self._sight_seed = (int(seed) for seed in random.integers(2**62, size=2))

    @property
    def truth(self) -> Mapping[str, float]:
        """What no estimator is told: what to add to the logged mount, and how late the stamps are."""
        height_m, pan_rad, tilt_rad, roll_rad = self._mount_error.tolist()
        return {
            "mount_error_height_m": height_m,
            "mount_error_pan_rad": pan_rad,
            "mount_error_tilt_rad": tilt_rad,
            "mount_error_roll_rad": roll_rad,
            "stamp_delay_s": self._settings.timing.stamp_delay_s,
        }

    def shots(self, course: Course) -> Shots:
        """When its pictures are taken, and from where: what a renderer needs to make them."""
        return take_shots(course, self._settings, self._mount_error, np.random.default_rng(self._shot_seed))

    def people(self, field: FieldMap) -> FloatArray:
        """(p, 2) who stands beside the field."""
        return people_around(field, self._settings.posts.people, np.random.default_rng(self._sight_seed))

    def images(self, course: Course, field: FieldMap) -> Iterator[tuple[int, ImageFeatures]]:
        """(log time, features) of each of the shots, in their order."""
        settings, shots = self._settings, self.shots(course)
        random = np.random.default_rng(self._sight_seed)
        people = people_around(field, settings.posts.people, random)
        covariance = self._claimed_covariance()
        mounts, log_times = shots.believed.records(covariance), shots.log_times_ns.tolist()
        stamps = shots.stamps_ns.tolist()
        for first in range(0, len(shots), _BLOCK):
            block = slice(first, min(first + _BLOCK, len(shots)))
            view = view_of(shots, block, settings.camera, settings.noise.exposure_s)
            cylinders = cylinders_of(field, people, view.others, settings)
            posts = _posts_by_image(find_posts(view, cylinders, settings, random), len(view))
            segments = segments_of(field, settings.lines, len(view), random)
            lines = _lines_by_image(find_lines(view, segments, settings, random), len(view))
            for row, (seen_posts, seen_lines) in enumerate(zip(posts, lines, strict=True), first):
                yield log_times[row], ImageFeatures(stamps[row], mounts[row], seen_posts, seen_lines)

    def _claimed_covariance(self) -> FloatArray:
        mount = self._settings.mount
        sigma = [mount.claimed_height_m, mount.claimed_pan_rad, mount.claimed_tilt_rad, mount.claimed_roll_rad]
        covariance = np.diag(np.square(sigma))
        covariance.flags.writeable = False  # all images share it
        return covariance


def _posts_by_image(found: FoundPosts, count: int) -> list[tuple[PostObservation, ...]]:
    with_foot = np.isfinite(found.feet_px[:, 0]).tolist()
    columns = (found.edges_px, found.covariance_px2, found.feet_px, found.foot_covariance_px2, with_foot)
    records = [
        PostObservation(edges, covariance, foot if seen else None, foot_covariance if seen else None)
        for edges, covariance, foot, foot_covariance, seen in zip(*columns, strict=True)
    ]
    return _by_image(records, found.images, count)


def _lines_by_image(found: FoundLines, count: int) -> list[tuple[LineObservation, ...]]:
    return _by_image(list(map(LineObservation, found.ends_px, found.covariance_px2)), found.images, count)


def _by_image(records: Sequence[_Record], images: NDArray[np.intp], count: int) -> list[tuple[_Record, ...]]:
    """The records of each of `count` images; `images` (m,) says whose each is, in order."""
    edges = np.searchsorted(images, np.arange(count + 1)).tolist()
    return [tuple(records[first:end]) for first, end in pairwise(edges)]
