"""Rendered views of a field: is the pose among the hypotheses, and can covariance and probability be believed."""

import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.timing import table
from benchmarks.vision_found import Found, found_in, shares
from fieldloc import pose as se2
from fieldloc.field import load_field
from fieldloc.pose import FloatArray
from fieldloc.render.truth import CrossingTruth, Truth

NEAR_M, NEAR_RAD = 0.25, math.radians(5.0)
_HEIGHT_SIGMA_M, _ATTITUDE_SIGMA_RAD = 0.03, math.radians(3.0)
_FAR_M = 0.5
_SURE = 0.9
_PLAIN_PX = 20.0  # of either line at a crossing, for it to be more than a spot at the picture's border


class Outcome(NamedTuple):
    """telling: the view shows two posts or a crossing. plain: two posts, or a crossing with a piece of either line.
    rank: of the first hypothesis that is near the truth, counted without twins, -1 for none; off_m, off_rad, nees: of
    that one. sure_wrong: a place with its twins has a probability above 0.9 and is not near."""

    seed: int
    telling: bool
    plain: bool
    rank: int
    off_m: float
    off_rad: float
    nees: float
    answered: bool
    sure_wrong: bool
    found: Found


def run(fields: Sequence[str], seeds: Sequence[int], jobs: int) -> str:
    rows, failures = [], []
    for name in fields:
        outcomes = outcomes_of(name, seeds, jobs)
        rows.append(_row(name, outcomes))
        telling = [one for one in outcomes if one.telling]
        for what, seeds_of in (
            ("not among", [one.seed for one in telling if one.rank < 0]),
            ("wrong above 0.9", [one.seed for one in outcomes if one.sure_wrong]),
        ):
            if seeds_of:
                failures.append(f"{name}, {what}: {' '.join(map(str, seeds_of))}")
    head = (
        f"{len(seeds)} views each", "telling", "among", "plain", "among", "first", "median m", "deg", "ANEES",
        "no answer", "wrong > 0.9", "lines recall", "precision", "posts recall", "precision",
    )  # fmt: skip
    return "\n".join([table(head, rows), *failures])


def outcomes_of(field_name: str, seeds: Sequence[int], jobs: int = 1) -> list[Outcome]:
    one = partial(look, field_name)
    if jobs == 1:
        return [one(seed) for seed in seeds]
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(one, seeds))


def look(field_name: str, seed: int) -> Outcome:
    """One view: drawn, rendered, detected, located, compared. In whatever process."""
    from fieldloc.locate import CameraPrior, locate
    from fieldloc.render import render_with_truth
    from fieldloc.render.random_views import random_view
    from fieldloc.vision.detect import detect

    field, random = load_field(field_name), np.random.default_rng([seed, *field_name.encode()])
    view = random_view(field, random)
    picture, truth = render_with_truth(view.scene, view.camera, field, view.mount, view.pose, random)
    sigmas = np.array([_HEIGHT_SIGMA_M, _ATTITUDE_SIGMA_RAD, _ATTITUDE_SIGMA_RAD])
    mount = np.array([view.mount.height_m, view.mount.tilt_rad, view.mount.roll_rad])
    prior = CameraPrior(mount + sigmas * random.standard_normal(3), np.diag(sigmas**2))
    detections = detect(picture, field.colours, view.camera)
    located = locate(detections, view.camera, field, prior)
    whole = [post for post in truth.posts if post.left_px is not None and post.right_px is not None]
    true = se2.compose(view.pose, np.array([0.0, 0.0, view.mount.pan_rad]))
    places = [
        (one.pose, one.covariance, one.probability) for one in located.hypotheses
    ]  # a place and its twins are one answer: the sum of their probabilities
    twins = 1 + len(field.symmetries)
    rank, off, nees, sure_wrong = -1, np.full(3, np.nan), np.nan, False
    for i, (pose, covariance, probability) in enumerate(places):
        now = off_truth(pose, true, field.symmetries)
        near = math.hypot(now[0], now[1]) <= NEAR_M and abs(now[2]) <= NEAR_RAD
        if probability * twins > _SURE and math.hypot(now[0], now[1]) > _FAR_M:
            sure_wrong = True
        if near and rank < 0:
            # the twin of the pose that is nearest: its covariance is that of this one turned, and so is what it is off
            rank, off, nees = i // twins, now, float(now @ np.linalg.solve(covariance, now))
    return Outcome(
        seed,
        len(whole) >= 2 or len(truth.crossings) > 0,
        len(whole) >= 2 or any(is_plain(crossing, truth) for crossing in truth.crossings),
        rank,
        math.hypot(off[0], off[1]),
        abs(float(off[2])),
        nees,
        len(places) > 0,
        sure_wrong,
        found_in(detections, truth),
    )


def is_plain(crossing: CrossingTruth, truth: Truth) -> bool:
    """Whether of both of its lines a piece is visible that begins, ends or goes through there."""
    lengths = dict.fromkeys(crossing.lines, 0.0)
    for line in truth.lines:
        way = line.ends_px[1] - line.ends_px[0]
        length = float(np.hypot(*way))
        if line.line in lengths and length > 0.0:
            place = float((crossing.point_px - line.ends_px[0]) @ way) / length
            if -1.0 <= place <= length + 1.0:
                lengths[line.line] = max(lengths[line.line], length)
    return min(lengths.values()) >= _PLAIN_PX


def off_truth(pose: FloatArray, truth: FloatArray, symmetries: FloatArray) -> FloatArray:
    """(3,) in field axes, of the nearest of the truth's twins."""
    offs = [pose - truth, *(pose - se2.compose(twin, truth) for twin in symmetries)]
    for off in offs:
        off[2] = se2.wrap(off[2])
    return np.asarray(min(offs, key=lambda off: float(np.hypot(off[0], off[1]) + abs(off[2]))))


def _row(name: str, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    telling = [one for one in outcomes if one.telling]
    plain = [one for one in telling if one.plain]
    right = [one for one in telling if one.rank >= 0]
    line_recall, line_precision, post_recall, post_precision = shares([one.found for one in outcomes])
    return (
        name,
        str(len(telling)),
        _percent(len(right), len(telling)),
        str(len(plain)),
        _percent(sum(one.rank >= 0 for one in plain), len(plain)),
        _percent(sum(one.rank == 0 for one in right), len(telling)),
        f"{np.median([one.off_m for one in right] or [np.nan]):.3f}",
        f"{math.degrees(np.median([one.off_rad for one in right] or [np.nan])):.2f}",
        f"{np.mean([one.nees for one in right] or [np.nan]) / 3.0:.2f}",
        _percent(sum(not one.answered for one in telling), len(telling)),
        str(sum(one.sure_wrong for one in outcomes)),
        f"{line_recall:.3f}",
        f"{line_precision:.3f}",
        f"{post_recall:.3f}",
        f"{post_precision:.3f}",
    )


def _percent(count: int, of: int) -> str:
    return f"{100.0 * count / of:.1f} %" if of else "-"
