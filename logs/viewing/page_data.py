"""What a page knows: a result and what was seen, as JSON with long arrays in base64, thinned to what a page bears."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from logs.evaluate import THREE_SIGMA_SHARE, Errors, chi_square_quantile
from logs.results import Json, LogResult, ScoredRun, score
from logs.thinning import extremes
from logs.trajectory import Trajectory
from logs.viewing.arrays import array
from logs.viewing.hypotheses import hypotheses
from logs.viewing.observations import Seen

NEES_LINE = chi_square_quantile(THREE_SIGMA_SHARE, 3)


@dataclass(frozen=True, slots=True)
class Limits:
    """What a page holds at most: of twenty minutes ten poses a second and five megabytes in all.

    poses: of one trajectory; total_poses: of all. errors: per run. segments: of what was seen. hypotheses: of all runs
    at all times.
    """

    poses: int = 12_000
    total_poses: int = 54_000
    errors: int = 4_000
    segments: int = 60_000
    hypotheses: int = 24_000


def page_document(result: LogResult, seen: Seen | None, colours: Sequence[str], limits: Limits) -> dict[str, Json]:
    """Times are seconds since origin_ns, in 64 bits; all other numbers in 32.

    An array is {"type": "f4" | "f8" | "u4" | "u1", "data": base64 of its little-endian numbers, row by row}.
    """
    scored = score(result)
    origin_ns, end_ns = _span_ns(result, seen)
    trajectories = [run.trajectory for run in result.runs] + ([result.truth] if result.truth is not None else [])
    most = max(2, min(limits.poses, limits.total_poses // max(1, len(trajectories))))
    truth = result.truth if result.truth is not None and len(result.truth) else None
    unsure = max(1, sum(bool(run.ambiguities) for run in result.runs))
    return {
        "log": result.log_name,
        "origin_ns": str(origin_ns),  # more than a JavaScript number holds
        "duration_s": (end_ns - origin_ns) / 1e9,
        "nees_line": NEES_LINE,
        "field": None if result.field is None else _field(result.field),
        "truth": None if truth is None else _trajectory(truth, origin_ns, most),
        "runs": [
            {
                "name": run.run.name,
                "colour": colour,
                "trajectory": _trajectory(run.run.trajectory, origin_ns, most),
                "errors": None if run.errors is None else _errors(run.errors, origin_ns, limits.errors),
                "summary": _summary(run),
                "hypotheses": hypotheses(run.run, origin_ns, limits.hypotheses // unsure),
            }
            for run, colour in zip(scored.runs, colours, strict=True)
        ],
        "seen": None if seen is None or not len(seen) else _seen(seen, origin_ns),
    }


def _span_ns(result: LogResult, seen: Seen | None) -> tuple[int, int]:
    """Of the estimates; of all there is where there are none. Truth before and after is of no use to watch."""
    stamps = [run.trajectory.stamps_ns for run in result.runs if len(run.trajectory)]
    if not stamps:
        stamps = [result.truth.stamps_ns] if result.truth is not None and len(result.truth) else []
        stamps += [seen.stamps_ns] if seen is not None and len(seen) else []
    if not stamps:
        return (0, 0)
    return (min(int(s[0]) for s in stamps), max(int(s[-1]) for s in stamps))


def _field(field: FieldMap) -> Json:
    return {
        "name": field.name,
        "line_width_m": field.line_width_m,
        "lines": field.lines.reshape(-1, 4).tolist(),
        "circles": field.circles.tolist(),
        "landmarks": [[*mark.position.tolist(), mark.diameter_m, mark.label] for mark in field.landmarks],
        "symmetric": len(field.symmetries) > 0,
    }


def _trajectory(trajectory: Trajectory, origin_ns: int, most: int) -> Json:
    """covariance: xx, xy, yy in m^2 and the heading's in rad^2; NaN where one is not finite."""
    kept = _every(len(trajectory), most)
    out: dict[str, Json] = {
        "t": array(_since(trajectory.stamps_ns[kept], origin_ns), "f8"),
        "pose": array(trajectory.poses[kept], "f4"),
        "all": len(trajectory),
    }
    if trajectory.covariances is not None:
        covariances = trajectory.covariances[kept]
        finite = np.isfinite(covariances).all(axis=(1, 2), keepdims=True)
        rows = np.where(finite, covariances, np.nan)[:, [0, 0, 1, 2], [0, 1, 1, 2]]
        out["covariance"] = array(rows, "f4")
    return out


def _errors(errors: Errors, origin_ns: int, most: int) -> Json:
    """Position error in metres, heading error in radians, NEES and the two sigmas; every spike stays."""
    position = np.hypot(errors.error[:, 0], errors.error[:, 1])
    heading = np.abs(errors.error[:, 2])
    columns = [position, heading]
    if errors.nees is not None and errors.covariances is not None:
        nees = np.minimum(errors.nees, np.finfo(np.float32).max)
        columns += [nees, *_sigmas(errors.covariances)]
    bins = max(1, most // 6)  # a lowest and a highest of each of three
    kept = np.unique(np.concatenate([extremes(column, bins) for column in columns[:3]]))
    return {
        "t": array(_since(errors.stamps_ns[kept], origin_ns), "f8"),
        "columns": array(np.stack(columns, axis=-1)[kept], "f4"),
        "width": len(columns),
    }


def _sigmas(covariances: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Of the position in its worst direction, and of the heading; NaN where there is none."""
    finite = np.isfinite(covariances).all(axis=(1, 2), keepdims=True)
    proper = np.where(finite, covariances, 0.0)
    half = 0.5 * (proper[:, 0, 0] - proper[:, 1, 1])
    variance = 0.5 * (proper[:, 0, 0] + proper[:, 1, 1]) + np.hypot(half, proper[:, 0, 1])
    return [np.sqrt(np.where(v > 0, v, np.nan)) for v in (variance, proper[:, 2, 2])]


def _seen(seen: Seen, origin_ns: int) -> Json:
    return {
        "t": array(_since(seen.stamps_ns, origin_ns), "f8"),
        "ends": array(seen.ends, "u4"),
        "segments": array(seen.segments, "f4"),
        "kinds": array(seen.kinds, "u1"),
    }


def _summary(run: ScoredRun) -> str:
    if len(run.run.trajectory) == 0:
        return "no estimate"
    if run.metrics is None:
        return ""
    parts = [f"ATE {run.metrics.ate_m.rmse:.3f} m", f"{np.degrees(run.metrics.heading_rad.rmse):.1f}°"]
    if run.metrics.consistency is not None:
        anees = run.metrics.consistency.anees
        parts.append(f"ANEES {anees:.0f}" if 100 <= anees < 1e6 else f"ANEES {anees:.3g}")
    return " · ".join(parts)


def _every(count: int, most: int) -> NDArray[np.intp]:
    """Up to `most` of `count` indices, evenly spread, the first and the last among them."""
    if count <= most:
        return np.arange(count)
    return np.unique(np.linspace(0, count - 1, most).round().astype(np.intp))


def _since(stamps_ns: NDArray[np.int64], origin_ns: int) -> NDArray[np.float64]:
    return (stamps_ns - origin_ns) / 1e9
