"""`fieldloc smooth` on logs, reading and writing included, beside what gtsam itself takes for the problem found in it.

gtsam's is the time of one whole solution of the log's chain, with all choices made: graph, search from the filter's
poses, optimum and marginal covariances.
"""

import argparse
import tempfile
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.timing import table
from estimators import chain_engine, graph
from estimators.config import Config
from estimators.smoother import Smoother
from logs.estimates import write_estimates
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import Replay, Run
from logs.samples import sample_path

_HEAD = ("log", "lasts s", "nodes", "read s", "ahead s", "back s", "write s", "all s", "gtsam s", "times")


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks smoothing", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("logs", nargs="*", type=Path, metavar="LOG", help="logs (the sample)")
    chosen = parser.parse_args(options)
    chain_engine.prepare()
    return table(_HEAD, [_row(path) for path in chosen.logs or [sample_path("woods")]])


def _row(path: Path) -> tuple[str, ...]:
    config, marks = Config(), [process_time()]
    recording = load_recording(LogFile(path))
    marks.append(process_time())
    smoother = Smoother(config)
    steps = Run(recording, smoother, None, config)
    update_s = [step.update_s for step in steps.steps() if step.update_s is not None]
    marks.append(process_time())
    estimates = steps.trajectory() or ()
    done = Replay(estimates, np.array(update_s), marks[-1] - marks[0], (), smoother.ambiguities(), ())
    marks.append(process_time())
    with tempfile.TemporaryDirectory() as folder:
        write_estimates(Path(folder) / "smooth.mcap", recording, done, {"estimator": "smooth"})
    marks.append(process_time())
    if smoother.resolution is None:
        return (path.stem, f"{recording.duration_s:.0f}", *(len(_HEAD) - 2) * ("-",))
    graph.solve(smoother.resolution.candidates[0].chain, config)
    marks.append(process_time())
    *parts, peer_s = np.diff(marks).tolist()
    whole_s = sum(parts)
    return (
        path.stem,
        f"{recording.duration_s:.0f}",
        str(len(estimates)),
        *(f"{part:.1f}" for part in (*parts, whole_s, peer_s)),
        f"{whole_s / peer_s:.1f}",
    )
