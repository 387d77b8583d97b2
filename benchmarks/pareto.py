"""What accuracy costs: the mixture filter with several caps beside the particle filter with several counts.

Each log is localized from nothing by all of them, one after the other, in one process. Cost: the median over the
observations of the processor time since the one before, of everything (motion, mixtures from measurements, filter),
and of the filter alone. Error: RMSE of the position, of the nearest copy of the truth where the field looks the same
from several poses, as nothing but luck decides between them; from --after seconds on. Of several seeds of the particle
filter the mean cost, and the root of the mean squared error, in which a seed that got lost counts.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.timed import Timed
from benchmarks.timing import table
from estimators.base import Estimate, MixtureEstimator
from estimators.config import Config
from estimators.registry import ALL
from fieldloc import pose as se2
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap
from fieldloc.measurements import InitialPose, LandmarkScan, Truth
from logs.evaluate import match
from logs.reader import LogFile
from logs.recording import Recording, load_recording
from logs.replay import Run
from logs.report.pareto_picture import CostPoint, write_pareto_picture
from logs.samples import sample_path
from logs.simulate import load_scenario, simulate
from logs.trajectory import Trajectory, from_estimates, from_truth

_CAPS = (1, 2, 4, 8, 16, 32, 64)
_COUNTS = (100, 300, 1000, 3000, 10000)
_SAME = 1.05  # errors that differ by less are equal


@dataclass(frozen=True, slots=True)
class Outcome:
    """Seconds an observation, of everything and of the filter alone; the error; seconds to the first estimate."""

    whole_s: float
    alone_s: float
    error_m: float
    first_s: float


@dataclass(frozen=True, slots=True)
class Size:
    """An estimator at one size. configs: one per seed."""

    series: str
    label: str
    estimator: str
    configs: tuple[Config, ...]


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks pareto", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("logs", type=Path, nargs="*", metavar="LOG", help="with truth; none: the sample and a game")
    parser.add_argument("--named", action="store_true", help="leave the landmarks their names")
    parser.add_argument("--duration", type=float, default=60.0, metavar="S", help="so much of each log (60)")
    parser.add_argument("--after", type=float, default=10.0, metavar="S", help="errors count from here on (10)")
    parser.add_argument("--caps", type=_numbers, default=_CAPS, metavar="N,N,...", help="most hypotheses")
    parser.add_argument("--counts", type=_numbers, default=_COUNTS, metavar="N,N,...", help="particles")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="of the particle filter (3)")
    parser.add_argument("--out", type=Path, metavar="PICTURE.png", help="draw it")
    chosen = parser.parse_args(options)
    with tempfile.TemporaryDirectory() as folder:
        paths = chosen.logs or [sample_path("woods"), _game(Path(folder) / "game.mcap", chosen.duration)]
        sizes = all_sizes(chosen.caps, chosen.counts, chosen.seeds)
        texts, pictures = [], {}
        for path in paths:
            outcomes = measure(path, sizes, chosen.duration, chosen.after, chosen.named)
            texts.append(f"{path.stem}\n{told(sizes, outcomes)}")
            pictures[path.stem] = _points(sizes, outcomes)
    if chosen.out:
        write_pareto_picture(chosen.out, pictures)
    return "\n\n".join(texts)


def all_sizes(caps: Sequence[int], counts: Sequence[int], seeds: int) -> list[Size]:
    default = Config()
    out = [
        Size("mixture", str(cap), "mixture", (replace(default, mixture=replace(default.mixture, max_hypotheses=cap)),))
        for cap in caps
    ]
    ways: Mapping[str, Callable[[int], int]] = {"particles": lambda n: n, "particles, adaptive": lambda n: n // 10}
    for series, least in ways.items():
        for count in counts:
            particles = replace(default.particles, count=max(least(count), 1), max_count=count)
            configs = tuple(replace(default, particles=replace(particles, seed=seed)) for seed in range(1, seeds + 1))
            out.append(Size(series, str(count), "particles", configs))
    return out


def measure(path: Path, sizes: Sequence[Size], duration_s: float, after_s: float, named: bool) -> list[Outcome]:
    log = LogFile(path, end_s=duration_s)
    recording, truth = _from_nothing(load_recording(log), named), from_truth(log.records(Truth))
    if not len(truth):
        raise FieldlocError(f"{path}: holds no truth to compare with")
    out = []
    for i, size in enumerate(sizes):
        sys.stderr.write(f"\r{path.stem}: {i + 1} of {len(sizes)}: {size.series} {size.label}      ")
        out.append(_mean([_measure(recording, truth, size.estimator, config, after_s) for config in size.configs]))
    sys.stderr.write("\n")
    return out


def _measure(recording: Recording, truth: Trajectory, name: str, config: Config, after_s: float) -> Outcome:
    made = ALL[name](config)
    if not isinstance(made, MixtureEstimator):
        raise ValueError(f"{name} takes no mixtures, so it is not the same task")
    estimator = Timed(made)
    estimates: dict[int, Estimate] = {}
    whole_s, alone_s = [], []
    pending_s, spent_s, before_s = 0.0, 0.0, process_time()
    for step in Run(recording, estimator, None, config).steps():
        pending_s += process_time() - before_s
        if step.update_s is not None:
            whole_s.append(pending_s)
            alone_s.append(estimator.spent_s - spent_s)
            pending_s, spent_s = 0.0, estimator.spent_s
        if step.estimate is not None:
            estimates[step.estimate.stamp_ns] = step.estimate
        before_s = process_time()
    begin_ns = recording.measurements[0].stamp_ns
    late = truth.select(np.flatnonzero(truth.stamps_ns >= begin_ns + int(after_s * 1e9)))
    first_s = (min(estimates) - begin_ns) * 1e-9 if estimates else np.inf
    error = error_m(from_estimates(estimates.values()), late, recording.field)
    return Outcome(float(np.median(whole_s)), float(np.median(alone_s)), error, first_s)


def error_m(estimates: Trajectory, truth: Trajectory, field: FieldMap) -> float:
    """RMSE of the distance to the nearest copy of the truth; infinite where there is nothing to compare."""
    try:
        errors = match(estimates, truth)
    except FieldlocError:
        return np.inf
    copies = np.concatenate([np.zeros((1, 3)), field.symmetries])
    away = se2.compose(copies[:, None], errors.true)[..., :2] - errors.estimated[:, :2]
    return float(np.sqrt(np.square(away).sum(axis=-1).min(axis=0).mean()))


def _mean(outcomes: Sequence[Outcome]) -> Outcome:
    return Outcome(
        float(np.mean([one.whole_s for one in outcomes])),
        float(np.mean([one.alone_s for one in outcomes])),
        float(np.sqrt(np.mean([one.error_m**2 for one in outcomes]))),
        float(np.mean([one.first_s for one in outcomes])),
    )


def told(sizes: Sequence[Size], outcomes: Sequence[Outcome]) -> str:
    """A row per size; of the mixture how many times as much the cheapest particle filter costs that is as good."""
    rows = []
    particles = [one for size, one in zip(sizes, outcomes, strict=True) if size.estimator == "particles"]
    for size, one in zip(sizes, outcomes, strict=True):
        ratios = ("", "")
        if size.estimator == "mixture":
            ratios = (_ratio(one, particles, lambda o: o.whole_s), _ratio(one, particles, lambda o: o.alone_s))
        costs = (f"{1e6 * one.whole_s:.0f}", f"{1e6 * one.alone_s:.0f}")
        rows.append((f"{size.series} {size.label}", *costs, f"{one.error_m:.4f}", f"{one.first_s:.1f}", *ratios))
    head = ("estimator", "us", "filter us", "RMSE m", "first s", "particles / this", "filters alone")
    return table(head, rows)


def _ratio(mixture: Outcome, particles: Sequence[Outcome], cost: Callable[[Outcome], float]) -> str:
    equal = [cost(one) for one in particles if one.error_m <= _SAME * mixture.error_m]
    if equal:
        return f"{min(equal) / cost(mixture):.1f}"
    return f"> {max(map(cost, particles)) / cost(mixture):.1f}" if particles else "-"


def _points(sizes: Sequence[Size], outcomes: Sequence[Outcome]) -> dict[str, list[CostPoint]]:
    out: dict[str, list[CostPoint]] = {}
    for size, one in zip(sizes, outcomes, strict=True):
        if np.isfinite(one.error_m):
            out.setdefault(size.series, []).append(CostPoint(size.label, 1e6 * one.whole_s, one.error_m))
    return out


def _from_nothing(recording: Recording, named: bool) -> Recording:
    """Without what it is told of its pose, and without the landmarks' names."""
    kept = [one for one in recording.measurements if not isinstance(one, InitialPose)]
    if not named:
        kept = [
            replace(one, labels=(None,) * len(one.labels)) if isinstance(one, LandmarkScan) else one for one in kept
        ]
    return replace(recording, measurements=tuple(kept))


def _game(path: Path, duration_s: float) -> Path:
    simulate(path, load_scenario("no-compass"), seed=0, duration_s=duration_s)
    return path


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(one) for one in text.split(","))
