"""From what was detected in one picture to every pose of the camera that explains it.

sight (detections as rays) -> attitude (how the camera may be turned) -> candidates (where it may be, in closed form)
-> refine (all of the picture, in pixels, attitude and height with it) -> evidence (which of them, or none).
"""

from fieldloc.locate.hypotheses import Hypothesis, Located
from fieldloc.locate.mixture import mixture
from fieldloc.locate.pipeline import locate
from fieldloc.locate.prior import CameraPrior
from fieldloc.locate.settings import LocateSettings

__all__ = ["CameraPrior", "Hypothesis", "LocateSettings", "Located", "locate", "mixture"]
