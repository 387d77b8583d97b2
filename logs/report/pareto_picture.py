"""What accuracy costs: error against cost of each estimator, at several sizes of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from fieldloc.errors import FieldlocError
from logs.report.style import DPI, WIDTH_IN, colours, pictures_style


class CostPoint(NamedTuple):
    """label: what size it is."""

    label: str
    cost_us: float
    error_m: float


def write_pareto_picture(path: Path, logs: Mapping[str, Mapping[str, Sequence[CostPoint]]]) -> None:
    """A panel per log, a line per estimator through its sizes. FieldlocError where the file cannot be written."""
    try:
        with pictures_style():
            pareto_picture(logs).savefig(path, format="png", dpi=DPI)
    except OSError as error:
        raise FieldlocError(f"cannot write {path}: {error.strerror}") from error


def pareto_picture(logs: Mapping[str, Mapping[str, Sequence[CostPoint]]]) -> Figure:
    """Both axes are logarithmic; below and to the left is better."""
    figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
    panels = figure.subplots(1, len(logs), squeeze=False)[0]
    colour_of = colours([name for series in logs.values() for name in series])
    for panel, (log, series) in zip(panels, logs.items(), strict=True):
        for name, points in series.items():
            colour, costs_ms = colour_of[name], [point.cost_us / 1e3 for point in points]
            panel.plot(costs_ms, [point.error_m for point in points], "o-", color=colour, ms=4, label=name)
            for cost_ms, point in zip(costs_ms, points, strict=True):
                where = (cost_ms, point.error_m)
                panel.annotate(
                    point.label, where, xytext=(4, 4), textcoords="offset points", fontsize=7.5, color=colour
                )
        everything = [point for points in series.values() for point in points]
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlim(*_limits([point.cost_us / 1e3 for point in everything]))
        panel.set_ylim(*_limits([point.error_m for point in everything]))
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_locator(NullLocator())
        panel.set_title(log, loc="left")
        panel.set_xlabel("processor time an observation [ms]")
    panels[0].set_ylabel("position error, RMSE [m]")
    panels[0].legend(loc="best")
    return figure


def _limits(values: Sequence[float]) -> tuple[float, float]:
    """At least from half to double of the middle, so that nothing small looks large."""
    low, high = min(values, default=1.0), max(values, default=1.0)
    middle = (low * high) ** 0.5
    return min(low / 1.2, middle / 2.0), max(high * 1.3, middle * 2.0)
