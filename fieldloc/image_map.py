"""What an image needs of a map again and again."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fieldloc.field import FieldMap
from fieldloc.pose import FloatArray
from fieldloc.regions import anywhere


@dataclass(frozen=True, slots=True, eq=False)
class ImageMap:
    """landmarks: (m, 2), surveyed: (m, 2, 2) or None where they are exact, radius_m of all of them or 0 where that
    differs or is unknown. box: (4,) x_min, y_min, x_max, y_max of where a robot can be; area_m2 of that.
    symmetries: (s, 3)."""

    landmarks: FloatArray
    surveyed: FloatArray | None
    radius_m: float
    box: FloatArray
    area_m2: float
    symmetries: FloatArray


@lru_cache(maxsize=16)
def image_map(field: FieldMap) -> ImageMap:
    """Of a map that is compared by identity."""
    region = anywhere(field)
    diameters = {mark.diameter_m for mark in field.landmarks}
    return ImageMap(
        landmarks=field.positions,
        surveyed=field.positions_covariance if field.positions_covariance.any() else None,
        radius_m=0.5 * diameters.pop() if len(diameters) == 1 else 0.0,
        box=region.boxes[0],
        area_m2=float(np.exp(region.log_volume)) / (2.0 * np.pi),
        symmetries=field.symmetries,
    )
