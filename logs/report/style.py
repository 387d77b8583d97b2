"""How pictures look: colours that colour-blind readers tell apart (Okabe and Ito, 2008), small type, thin grey axes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import matplotlib as mpl

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
TRACKS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#7B61B5", "#C9BC2B")
"""Of hypotheses, one of logs.shares.COLOURS each."""
OTHERS = "#E3E6EA"
LOST = "#8A929C"
INK = "#1F2328"
SOFT_INK = "#57606A"
TRUTH = "#A3A8B0"
ELLIPSE = "#A3A8B055"
FIELD_LINE = "#D5D9DE"
UNKNOWN = "#F1F2F4"
WIDTH_IN = 9.6
DPI = 140


@contextmanager
def pictures_style() -> Iterator[None]:
    """The settings for everything drawn inside; matplotlib's own are restored afterwards."""
    with mpl.rc_context(
        {
            "font.size": 9.0,
            "axes.titlesize": 9.5,
            "axes.titlepad": 5.0,
            "axes.labelsize": 9.0,
            "axes.labelcolor": INK,
            "axes.edgecolor": "#6E7781",
            "axes.linewidth": 0.6,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "axes.axisbelow": True,
            "grid.color": "#E6E8EB",
            "grid.linewidth": 0.5,
            "xtick.color": SOFT_INK,
            "ytick.color": SOFT_INK,
            "xtick.labelsize": 8.0,
            "ytick.labelsize": 8.0,
            "xtick.major.width": 0.6,
            "ytick.major.width": 0.6,
            "text.color": INK,
            "legend.frameon": False,
            "legend.fontsize": 8.5,
            "lines.linewidth": 0.9,
            "path.simplify_threshold": 0.5,  # pixels a drawn line may be off
        }
    ):
        yield


def colours(names: Sequence[str]) -> dict[str, str]:
    """One colour per estimator, the same on every log of the report."""
    return {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(dict.fromkeys(names))}
