"""A camera's inside: pixel <-> ray, exact to rounding, with Jacobians. Its place on the robot is in `CameraMount`.

Pixel centres are at integers, as in OpenCV: the image reaches from -0.5 to width - 0.5. Rays are in the camera frame (z
forward, x right, y down) and point away from the camera. The lens formulas are in `fieldloc.lens`.
"""

import math
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from fieldloc import lens
from fieldloc.errors import FieldlocError
from fieldloc.pose import FloatArray

Across = Literal["horizontal", "vertical", "diagonal"]

_COEFFICIENTS = {"pinhole": (0, 4, 5, 8, 12, 14), "fisheye": (0, 4)}
_OPTIONAL = ("distortion",)


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics. ValueError where they make no camera.

    distortion: OpenCV's coefficients in OpenCV's order. pinhole: none, k1 k2 p1 p2, + k3, + k4 k5 k6, + s1 s2 s3 s4
    (and OpenCV's 14, if the tilt of the sensor is zero). fisheye: none or k1 k2 k3 k4.
    """

    model: lens.Model
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: lens.Distortion = ()

    def __post_init__(self) -> None:
        if self.model not in get_args(lens.Model):
            raise ValueError(f"model is {self.model!r}, must be one of: {', '.join(get_args(lens.Model))}")
        for name in ("width_px", "height_px"):
            if type(getattr(self, name)) is not int or getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be a positive whole number")
        for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
            if not _is_number(getattr(self, name)):
                raise ValueError(f"{name} is {getattr(self, name)!r}, must be a number")
        if min(self.fx_px, self.fy_px) <= 0:
            raise ValueError(f"fx_px and fy_px are {self.fx_px} and {self.fy_px}, must be positive")
        if not _are_numbers(self.distortion):
            raise ValueError(f"distortion is {self.distortion!r}, must be a list of numbers")
        counts = _COEFFICIENTS[self.model]
        if len(self.distortion) not in counts:
            raise ValueError(f"distortion has {len(self.distortion)} coefficients, a {self.model} takes {counts}")
        if any(self.distortion[12:]):
            raise ValueError("distortion describes a tilted sensor (coefficients 13 and 14), which is not supported")

    def project(self, rays: FloatArray) -> tuple[FloatArray, lens.Mask]:
        """Pixels (..., 2) of rays (..., 3) of any length, and whether they fall on the image.

        A pixel beside the image is right although its mask is False; it is NaN where the lens has no image of the ray.
        """
        plane, _, exists = lens.project(self.model, self.distortion, np.asarray(rays, dtype=np.float64))
        pixels = plane * self._focal + self._centre
        return pixels, exists & self.contains(pixels)

    def project_jacobian(self, rays: FloatArray) -> FloatArray:
        """(..., 2, 3): the pixel's change with the ray; NaN where there is no image of it."""
        _, jacobian, _ = lens.project(self.model, self.distortion, np.asarray(rays, dtype=np.float64))
        return self._focal[:, None] * jacobian

    def ray(self, pixels: FloatArray) -> tuple[FloatArray, lens.Mask]:
        """Unit rays (..., 3) of pixels (..., 2), on the image or beside it, and where there is one; NaN elsewhere."""
        plane = (np.asarray(pixels, dtype=np.float64) - self._centre) / self._focal
        rays, _, exists = lens.unproject(self.model, self.distortion, plane)
        return rays, exists

    def ray_and_jacobian(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray, lens.Mask]:
        """As `ray`, with the unit rays' change with their pixels (..., 3, 2) in the middle."""
        focal = self._focal
        plane = (np.asarray(pixels, dtype=np.float64) - self._centre) / focal
        rays, jacobian, exists = lens.unproject(self.model, self.distortion, plane)
        return rays, jacobian / focal, exists

    def contains(self, pixels: FloatArray) -> lens.Mask:
        """Whether pixels (..., 2) are on the image."""
        u, v = pixels[..., 0], pixels[..., 1]
        return (u >= -0.5) & (u <= self.width_px - 0.5) & (v >= -0.5) & (v <= self.height_px - 0.5)

    @property
    def _focal(self) -> FloatArray:
        return np.array([self.fx_px, self.fy_px])

    @property
    def _centre(self) -> FloatArray:
        return np.array([self.cx_px, self.cy_px])


def load_camera(path: str | Path) -> Camera:
    """The camera of a TOML file whose keys are the fields of `Camera`; FieldlocError for anything else."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FieldlocError(f"{path}: no such camera file; give the path of a TOML file") from None
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a path with a zero byte
        raise FieldlocError(f"{path}: cannot be read as a camera file: {error}") from None
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: bad TOML, and integers of too many digits
        raise FieldlocError(f"{path}: not valid TOML: {error}") from None
    names = [field.name for field in fields(Camera)]
    if unknown := sorted(set(table) - set(names)):
        raise FieldlocError(f"{path}: {', '.join(unknown)}: unknown key; known in a camera file are {', '.join(names)}")
    if missing := [name for name in names if name not in table and name not in _OPTIONAL]:
        raise FieldlocError(f"{path}: {', '.join(missing)}: missing; a camera file needs it")
    distortion = table.pop("distortion", [])
    try:
        return Camera(**table, distortion=tuple(distortion) if isinstance(distortion, list) else distortion)
    except ValueError as error:
        raise FieldlocError(f"{path}: {error}") from None


def camera_to_toml(camera: Camera) -> str:
    """TOML text that `load_camera` reads as the same camera, digit by digit."""
    lines = [f'model = "{camera.model}"']
    lines += [f"{field.name} = {getattr(camera, field.name)!r}" for field in fields(Camera)[1:-1]]
    if camera.distortion:
        lines.append(f"distortion = {list(camera.distortion)!r}")
    return "\n".join(lines) + "\n"


def camera_of_view(width_px: int, height_px: int, fov_rad: float, across: Across = "horizontal") -> Camera:
    """The pinhole camera without distortion, with square pixels, that sees so much of the world.

    fov_rad: from the outer border of the picture to the one opposite, or from corner to corner. ValueError outside
    0 to pi.
    """
    if not 0.0 < fov_rad < math.pi:
        raise ValueError(f"a field of view of {math.degrees(fov_rad):g} degrees; a pinhole has one between 0 and 180")
    sizes = {"horizontal": width_px, "vertical": height_px, "diagonal": math.hypot(width_px, height_px)}
    focal_px = 0.5 * sizes[across] / math.tan(0.5 * fov_rad)
    return Camera("pinhole", width_px, height_px, focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2)


def _are_numbers(value: object) -> bool:
    return isinstance(value, tuple) and all(map(_is_number, value))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
