"""Other people's words for a camera's intrinsics."""

from collections.abc import Iterator

import numpy as np

from fieldloc.camera import Camera
from fieldloc.lens import Model
from logs.foreign.parts import CameraPart, Part
from logs.foreign.surroundings import Surroundings, Unusable

_PINHOLE = ("plumb_bob", "rational_polynomial", "radial_tangential", "radtan", "opencv", "")
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4", "kannalabrandt4")
_NONE = ("none", "no_distortion", "pinhole", "perspective")
_COUNTS = {"pinhole": (0, 4, 5, 8, 12, 14), "fisheye": (0, 4)}


class CameraAdapter:
    """A camera when it is first told and whenever it changes; drivers repeat it with every image."""

    def __init__(self, surroundings: Surroundings) -> None:
        self._rectified = surroundings.mapping.rectified
        self._last: CameraPart | None = None

    def take(self, topic: str, stamp_ns: int, part: Part) -> Iterator[Camera]:
        if isinstance(part, CameraPart) and not (self._last is not None and _same(self._last, part)):
            camera = camera_of(part, self._rectified)
            self._last = part
            yield camera

    def finish(self) -> Iterator[Camera]:
        return iter(())


def camera_of(part: CameraPart, rectified: bool = False) -> Camera:
    """Unusable where it is no camera, or one with a lens that is not known here.

    rectified: the pictures that the rest of the log speaks of are free of distortion.
    """
    k = part.matrix
    if not np.isfinite(k).all() or k[0, 0] <= 0.0 or k[1, 1] <= 0.0:
        raise Unusable("the camera is not calibrated: its matrix K has no focal length")
    if part.width_px <= 0 or part.height_px <= 0:
        raise Unusable("the camera does not say how large its pictures are")
    model: Model = "pinhole"
    name = part.distortion_model.strip().lower()
    coefficients = [] if rectified or name in _NONE else part.distortion.tolist()
    if any(coefficients) and name not in (*_PINHOLE, *_FISHEYE):
        known = ", ".join(name for name in (*_PINHOLE, *_FISHEYE) if name)
        raise Unusable(f"distortion model '{part.distortion_model}' is not known; known are {known}")
    if name in _FISHEYE and not rectified:
        model = "fisheye"  # also where all coefficients are zero: that is no pinhole
    while coefficients and coefficients[-1] == 0.0:
        coefficients.pop()
    counts = _COUNTS[model]
    length = next((count for count in counts if count >= len(coefficients)), len(coefficients))
    try:
        return Camera(
            model=model,
            width_px=part.width_px,
            height_px=part.height_px,
            fx_px=float(k[0, 0]),
            fy_px=float(k[1, 1]),
            cx_px=float(k[0, 2]),
            cy_px=float(k[1, 2]),
            distortion=(*coefficients, *[0.0] * (length - len(coefficients))),
        )
    except ValueError as error:
        raise Unusable(f"the camera is refused: {error}") from None


def _same(a: CameraPart, b: CameraPart) -> bool:
    return (
        a.matrix.tobytes() == b.matrix.tobytes()
        and a.distortion.tobytes() == b.distortion.tobytes()
        and (a.width_px, a.height_px, a.distortion_model) == (b.width_px, b.height_px, b.distortion_model)
    )
