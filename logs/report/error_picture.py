"""One run's errors over time inside the 3-sigma bands that the estimator claimed, and its NEES below them."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fieldloc.pose import FloatArray
from logs.evaluate import THREE_SIGMA_SHARE, Errors, chi_square_quantile
from logs.metrics import Metrics
from logs.report.style import INK, SOFT_INK, UNKNOWN, WIDTH_IN
from logs.thinning import breaks, extremes
from logs.trajectory import Trajectory

_BINS = 700  # stretches of time across a panel, a lowest and a highest value drawn for each
_PANEL_IN, _GAP_IN = 1.3, 0.26
_LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 0.75, 0.1, 0.33, 0.45
_NEES_FLOOR = 0.02
_AXES = (("x error [m]", 1.0), ("y error [m]", 1.0), ("heading error [°]", float(np.degrees(1.0))))


def error_picture(name: str, errors: Errors, metrics: Metrics, truth: Trajectory, colour: str) -> Figure:
    """Panels of x, y and heading error, and of NEES where there are covariances; grey where none can be told."""
    figure, panels = _panels(len(_AXES) + (metrics.consistency is not None))
    start_ns = int(truth.stamps_ns[0])
    t_s = (errors.stamps_ns - start_ns) / 1e9
    end_s = max(int(truth.stamps_ns[-1]) - start_ns, 1) / 1e9
    parts = np.split(np.arange(len(t_s)), breaks(errors.stamps_ns))
    for axis, (label, scale) in enumerate(_AXES):
        panels[axis].set_ylabel(label)
        _draw_error(panels[axis], t_s, scale * errors.error[:, axis], parts, colour)
        if errors.covariances is not None:
            _draw_band(panels[axis], t_s, 3.0 * scale * _sigma(errors.covariances[:, axis, axis]), parts, colour)
        if metrics.consistency is not None:
            _remark(panels[axis], f"{100 * metrics.consistency.within_3sigma_axes[axis]:.1f} % within ±3σ")
    if metrics.consistency is not None and errors.nees is not None:
        _draw_nees(panels[-1], t_s, errors.nees, parts, colour)
        _remark(panels[-1], f"{100 * metrics.consistency.within_3sigma:.1f} % below the 99.73 % quantile")
    known = [(t_s[part[0]], t_s[part[-1]]) for part in parts]
    for panel in panels:
        panel.set_xlim(0.0, end_s)
        for before, after in zip([(0.0, 0.0), *known], [*known, (end_s, end_s)], strict=True):
            panel.axvspan(before[1], max(after[0], before[1]), color=UNKNOWN, lw=0, zorder=0)
    panels[0].set_title(_title(name, metrics), loc="left")
    panels[-1].set_xlabel("time since the first true pose [s]")
    panels[-1].tick_params(labelbottom=True)
    return figure


def _title(name: str, metrics: Metrics) -> str:
    parts = [f"ATE RMSE {metrics.ate_m.rmse:.3f} m", f"heading RMSE {np.degrees(metrics.heading_rad.rmse):.2f}°"]
    if metrics.consistency is not None:
        parts.append(f"ANEES {metrics.consistency.anees:.3g}")
    return f"{name}: {', '.join(parts)}"


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """Stacked, of equal size, time shared."""
    total_in = _TOP_IN + _BOTTOM_IN + count * _PANEL_IN + (count - 1) * _GAP_IN
    figure = Figure(figsize=(WIDTH_IN, total_in))
    panels: list[Axes] = []
    for index in range(count):
        bottom_in = total_in - _TOP_IN - (index + 1) * _PANEL_IN - index * _GAP_IN
        width = (WIDTH_IN - _LEFT_IN - _RIGHT_IN) / WIDTH_IN
        axes = figure.add_axes((_LEFT_IN / WIDTH_IN, bottom_in / total_in, width, _PANEL_IN / total_in))
        axes.tick_params(labelbottom=False)
        axes.yaxis.set_label_coords(-0.55 / (WIDTH_IN - _LEFT_IN - _RIGHT_IN), 0.5)  # all labels in one line
        panels.append(axes)
    return figure, panels


def _draw_error(axes: Axes, t_s: FloatArray, error: FloatArray, parts: list[NDArray[np.intp]], colour: str) -> None:
    axes.axhline(0.0, color=INK, lw=0.5)
    for part in parts:
        shown = part[extremes(error[part], _BINS)]
        axes.plot(t_s[shown], error[shown], color=colour, lw=0.8)
    limit = 1.12 * max(float(np.abs(error).max()), 1e-6)
    axes.set_ylim(-limit, limit)


def _draw_band(axes: Axes, t_s: FloatArray, bound: FloatArray, parts: list[NDArray[np.intp]], colour: str) -> None:
    """+- bound (m,), whole where it is not far wider than the errors: a start in the dark may leave the panel."""
    for part in parts:
        shown = part[extremes(bound[part], _BINS)]
        axes.fill_between(t_s[shown], -bound[shown], bound[shown], color=colour, alpha=0.18, lw=0)
    limit = max(axes.get_ylim()[1], min(1.12 * float(np.quantile(bound, 0.98)), 5 * axes.get_ylim()[1]))
    axes.set_ylim(-limit, limit)


def _draw_nees(axes: Axes, t_s: FloatArray, nees: FloatArray, parts: list[NDArray[np.intp]], colour: str) -> None:
    axes.set_ylabel("NEES")
    axes.set_yscale("log")
    shown_nees = np.clip(np.where(np.isfinite(nees), nees, np.nanmax(nees[np.isfinite(nees)])), _NEES_FLOOR, None)
    for part in parts:
        shown = part[extremes(shown_nees[part], _BINS)]
        axes.plot(t_s[shown], shown_nees[shown], color=colour, lw=0.6)
    line = chi_square_quantile(THREE_SIGMA_SHARE, 3)
    axes.axhline(line, color=INK, lw=0.8, ls=(0, (5, 3)))
    axes.set_ylim(_NEES_FLOOR, 4.0 * max(line, float(shown_nees.max())))


def _sigma(variance: FloatArray) -> FloatArray:
    """Standard deviations (m,); 0, no band, where the variance is none."""
    return np.sqrt(np.where(np.isfinite(variance) & (variance > 0), variance, 0.0))


def _remark(axes: Axes, text: str) -> None:
    axes.text(1.0, 1.02, text, transform=axes.transAxes, ha="right", va="bottom", fontsize=8, color=SOFT_INK)
