"""What locate takes for granted of pictures and of fields: noise beside the detector's own, and how often it errs."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """model_px: how far the lens model is off; map_m: how far what is painted and built is off the map; focal: how far
    the focal length is off, as a share of it; all are scaled by what the residuals of each picture show. false_line,
    false_post, false_circle: of a thing found, that it is none of the map's. seen_line, seen_post, seen_circle: of a
    thing in clear sight, that it is found. none_right: of a picture, that nothing in it is what it seems. trust: how
    much of the evidence counts: things that are found in one picture are not independent of each other. candidates,
    hypotheses: how many are refined, and kept.
    """

    model_px: float = 0.3
    map_m: float = 0.01
    focal: float = 0.012
    false_line: float = 0.2
    false_post: float = 0.3
    false_circle: float = 0.05
    seen_line: float = 0.5
    seen_post: float = 0.6
    seen_circle: float = 0.7
    none_right: float = 0.05
    trust: float = 0.5
    candidates: int = 24
    hypotheses: int = 80
