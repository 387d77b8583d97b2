"""From pictures to poses: how often right, how exact, how fast.

views: random rendered views of each field preset, with a prior of height (3 cm) and attitude (3 deg) that is off by a
draw of itself. Of views that show two posts or a crossing, whose point may be all that is in the picture; plain:
of those in which 20 px of either of the crossing's lines are, too.
speed: from JPEG bytes to the mixture on one core, beside OpenCV's line segment detector alone on the same pictures.
real: pictures of real fields, of which there is a truth; skipped where they are not beside the repository.
"""

import argparse

from benchmarks import vision_real, vision_speed, vision_views
from fieldloc.field import PRESETS

_WHAT = ("views", "speed", "real")


def run(options: list[str]) -> str:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks vision", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--what", choices=[*_WHAT, "all"], default="all", help="which of these (all)")
    parser.add_argument("--count", type=int, default=50, metavar="N", help="views of each field (50)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first view's seed (0)")
    parser.add_argument("--fields", default=",".join(PRESETS), metavar="NAME,..", help="of the views (%(default)s)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (1)")
    chosen = parser.parse_args(options)
    what = _WHAT if chosen.what == "all" else (chosen.what,)
    seeds = range(chosen.first, chosen.first + chosen.count)
    parts = {
        "views": lambda: vision_views.run(chosen.fields.split(","), seeds, chosen.jobs),
        "speed": lambda: vision_speed.run(chosen.first, min(chosen.count, 20)),
        "real": vision_real.run,
    }
    return "\n\n".join(f"{name}\n{parts[name]()}" for name in what)
