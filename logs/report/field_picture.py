"""The field with truth and one estimator's trajectory per panel, so that none hides another."""

from collections.abc import Mapping
from math import ceil

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fieldloc.field import FieldMap
from logs.report.style import ELLIPSE, FIELD_LINE, INK, TRUTH, WIDTH_IN
from logs.results import ScoredLog, ScoredRun
from logs.thinning import breaks, path
from logs.trajectory import Trajectory

Bounds = tuple[float, float, float, float]  # xmin, ymin, xmax, ymax

_ELLIPSES = 90
_LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 0.6, 0.1, 0.55, 0.45
_GAP_X_IN, _GAP_Y_IN = 0.4, 0.55
_TALLEST_IN = 11.0
_MARGIN_SHARE = 0.04  # of the shown size, around field and truth
_ASTRAY_SHARE = 0.25  # an estimate further outside does not shrink the picture
_FLATTEST, _SMALLEST_M = 0.4, 1.0  # height per width or width per height, and size, of what is shown
_WIDE_SHARE, _WIDE_ELLIPSES = 0.1, 8  # of the shown size: of larger ellipses only a few outlines, not to hide the rest


def field_picture(scored: ScoredLog, colours: Mapping[str, str]) -> Figure:
    """One panel per run: map, truth, estimate, and the 3-sigma ellipses of some of its positions."""
    log = scored.log
    bounds = _bounds(scored)
    figure, panels = _panels(len(scored.runs), bounds)
    cell_m = max(bounds[2] - bounds[0], bounds[3] - bounds[1]) / 1500  # below a pixel
    for panel, run in zip(panels, scored.runs, strict=True):
        if log.field is not None:
            _draw_map(panel, log.field)
        if log.truth is not None:
            _draw_path(panel, log.truth, cell_m, TRUTH, 1.8)
        _draw_ellipses(panel, run.run.trajectory, colours[run.run.name])
        _draw_path(panel, run.run.trajectory, cell_m, colours[run.run.name], 0.8)
        panel.set_title(_title(run), loc="left")
    figure.text(_LEFT_IN / WIDTH_IN, 1 - 0.12 / figure.get_figheight(), log.log_name, va="top", fontsize=10.5)
    legend = _legend(scored)
    figure.legend(list(legend.values()), list(legend), loc="upper right", ncols=len(legend), handlelength=1.6)
    return figure


def _bounds(scored: ScoredLog) -> Bounds:
    """Field and truth with a margin, and as much of the estimates as lies not too far outside."""
    log = scored.log
    known = [log.truth.poses[:, :2]] if log.truth is not None else []
    if log.field is not None:
        known.append(np.array(log.field.bounds).reshape(2, 2))
    estimated = [run.run.trajectory.poses[:, :2] for run in scored.runs]
    everything = np.concatenate([*known, *estimated, np.zeros((0, 2))])
    core = np.concatenate(known) if known else everything
    if len(core) == 0:
        return (-1.0, -1.0, 1.0, 1.0)
    low, high = core.min(axis=0), core.max(axis=0)
    size = max(float(np.max(high - low)), _SMALLEST_M)
    low = np.maximum(everything.min(axis=0), low - _ASTRAY_SHARE * size) - _MARGIN_SHARE * size
    high = np.minimum(everything.max(axis=0), high + _ASTRAY_SHARE * size) + _MARGIN_SHARE * size
    lacking = np.maximum(_FLATTEST * max(float(np.max(high - low)), _SMALLEST_M) - (high - low), 0.0)
    low, high = low - 0.5 * lacking, high + 0.5 * lacking
    return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def _panels(count: int, bounds: Bounds) -> tuple[Figure, list[Axes]]:
    """Panels of equal scale in x and y, as large as the figure's width and a bearable height allow."""
    height_per_width = (bounds[3] - bounds[1]) / (bounds[2] - bounds[0])
    for columns in range(1, count + 1):
        rows = ceil(count / columns)
        width_in = (WIDTH_IN - _LEFT_IN - _RIGHT_IN - (columns - 1) * _GAP_X_IN) / columns
        height_in = width_in * height_per_width
        total_in = _TOP_IN + _BOTTOM_IN + rows * height_in + (rows - 1) * _GAP_Y_IN
        if total_in <= _TALLEST_IN:
            break
    figure = Figure(figsize=(WIDTH_IN, total_in))
    panels = []
    for index in range(count):
        row, column = divmod(index, columns)
        left_in = _LEFT_IN + column * (width_in + _GAP_X_IN)
        bottom_in = total_in - _TOP_IN - (row + 1) * height_in - row * _GAP_Y_IN
        rectangle = (left_in / WIDTH_IN, bottom_in / total_in, width_in / WIDTH_IN, height_in / total_in)
        axes = figure.add_axes(rectangle, xlim=(bounds[0], bounds[2]), ylim=(bounds[1], bounds[3]), aspect="equal")
        if index + columns >= count:
            axes.set_xlabel("x [m]")
        if column == 0:
            axes.set_ylabel("y [m]")
        panels.append(axes)
    return figure, panels


def _draw_map(axes: Axes, field: FieldMap) -> None:
    axes.add_collection(LineCollection(list(field.lines), colors=FIELD_LINE, linewidths=1.6), autolim=False)
    for x, y, radius in field.circles.tolist():
        angle = np.linspace(0, 2 * np.pi, 90)
        axes.plot(x + radius * np.cos(angle), y + radius * np.sin(angle), color=FIELD_LINE, lw=1.6)
    if len(field.landmarks):
        diameters = np.array([mark.diameter_m for mark in field.landmarks])
        axes.add_collection(
            EllipseCollection(
                diameters, diameters, np.zeros(len(diameters)),
                units="xy", offsets=field.positions, offset_transform=axes.transData, fc=INK, ec=INK, zorder=3,
            ),
            autolim=False,
        )  # fmt: skip
        axes.plot(*field.positions.T, "o", ms=3.2, color=INK, mew=0, zorder=3)  # seen also where the cylinder is thin


def _draw_path(axes: Axes, trajectory: Trajectory, cell_m: float, colour: str, width: float) -> None:
    for part in np.split(np.arange(len(trajectory)), breaks(trajectory.stamps_ns)):
        positions = trajectory.poses[part, :2]
        axes.plot(*positions[path(positions, cell_m)].T, color=colour, lw=width, solid_joinstyle="round")


def _draw_ellipses(axes: Axes, trajectory: Trajectory, colour: str) -> None:
    """Of poses evenly spread over the trajectory; a covariance that is not positive definite has none."""
    if trajectory.covariances is None:
        return
    chosen = _spread(np.arange(len(trajectory)), _ELLIPSES)
    chosen = chosen[np.isfinite(trajectory.covariances[chosen, :2, :2]).all(axis=(1, 2))]
    variances, directions = np.linalg.eigh(trajectory.covariances[chosen, :2, :2])
    proper = variances[:, 0] > 0
    half_axes = 3.0 * np.sqrt(variances[proper])[:, None, :] * directions[proper]  # (k, 2, 2), an axis a column
    angle = np.linspace(0, 2 * np.pi, 40)
    outlines = half_axes @ np.stack([np.cos(angle), np.sin(angle)])
    outlines = np.swapaxes(outlines, 1, 2) + trajectory.poses[chosen[proper], None, :2]
    is_wide = 3.0 * np.sqrt(variances[proper, 1]) > _WIDE_SHARE * (axes.get_xlim()[1] - axes.get_xlim()[0])
    for drawn, fill in ((np.flatnonzero(~is_wide), 0.3), (_spread(np.flatnonzero(is_wide), _WIDE_ELLIPSES), 0.0)):
        axes.add_collection(
            PolyCollection(list(outlines[drawn]), fc=(colour, fill), ec=(colour, 0.7), linewidths=0.5), autolim=False
        )


def _spread(indices: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Up to `count` of them, the first and the last among them."""
    return indices[np.unique(np.linspace(0, len(indices) - 1, count).astype(np.intp))] if len(indices) else indices


def _title(run: ScoredRun) -> str:
    if len(run.run.trajectory) == 0:
        return f"{run.run.name}: no estimate"
    return f"{run.run.name}: ATE RMSE {run.metrics.ate_m.rmse:.3f} m" if run.metrics else run.run.name


def _legend(scored: ScoredLog) -> dict[str, Artist]:
    out: dict[str, Artist] = {}
    if scored.log.truth is not None:
        out["truth"] = Line2D([], [], color=TRUTH, lw=1.8)
    out["estimate"] = Line2D([], [], color=INK, lw=0.8)
    out["3σ ellipse of the position"] = Patch(facecolor=ELLIPSE, edgecolor=INK, linewidth=0.5)
    if scored.log.field is not None and scored.log.field.landmarks:
        out["landmark"] = Line2D([], [], color=INK, marker="o", ms=4, lw=0)
    return out
