"""A goal's net: thin threads on a box behind the posts, through which one sees what is behind it."""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.render.flat import Quad
from fieldloc.render.solid import Bar

_DEPTH_M = 0.5  # behind the goal line
_MESH_M, _THREAD_M = 0.08, 0.004
_LEAST = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Threads along both sides of a rectangle."""

    frame: Quad

    @property
    def fills_cone(self) -> bool:
        return False

    def normals(self, eye: FloatArray) -> FloatArray | None:
        return self.frame.normals(eye)

    def coverage(self, eye: FloatArray, rays: FloatArray, steps: FloatArray, blur_px: float) -> FloatArray:
        """The mean over about a pixel and its blur of what threads cover."""
        places = self._places(eye, rays)
        moved = [np.abs(self._places(eye, rays + steps[:, k]) - places) for k in (0, 1)]
        reach = np.maximum((moved[0] + moved[1]) * np.hypot(1.0, 2.0 * blur_px), _LEAST)
        threads = (_threads(places + 0.5 * reach) - _threads(places - 0.5 * reach)) / reach
        covered = 1.0 - (1.0 - threads[:, 0]) * (1.0 - threads[:, 1])
        return np.asarray(np.clip(covered, 0.0, 1.0) * self.frame.coverage(eye, rays, steps, blur_px))

    def _places(self, eye: FloatArray, rays: FloatArray) -> FloatArray:
        """(m, 2) metres along two of its sides."""
        origin, along, _, aside = self.frame.corners
        axes = np.array([along - origin, aside - origin])
        axes /= np.linalg.norm(axes, axis=-1)[:, None]
        normal = np.cross(axes[0], axes[1])
        toward = rays @ normal
        reach = ((origin - eye) @ normal) / np.where(np.abs(toward) < _LEAST, _LEAST, toward)
        return np.asarray((eye - origin + reach[:, None] * rays) @ axes.T)


def net_of(bar: Bar, top_m: float) -> list[Mesh]:
    """Back, sides and top of the net behind a crossbar; behind is away from the field's centre."""
    along = (bar.end - bar.start)[:2]
    back = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    back *= _DEPTH_M * (np.sign(back @ (bar.start + bar.end)[:2]) or 1.0)
    front = bar.start[:2], bar.end[:2]
    rear = front[0] + back, front[1] + back
    upright = [(rear[0], rear[1]), (front[0], rear[0]), (front[1], rear[1])]
    quads = [[(*a, 0.0), (*b, 0.0), (*b, top_m), (*a, top_m)] for a, b in upright]
    quads.append([(*place, top_m) for place in (front[0], front[1], rear[1], rear[0])])
    return [Mesh(Quad(np.array(corners))) for corners in quads]


def _threads(metres: FloatArray) -> FloatArray:
    """How much of the way from 0 is covered by threads."""
    whole = np.floor(metres / _MESH_M)
    return np.asarray(whole * _THREAD_M + np.minimum(metres - whole * _MESH_M, _THREAD_M))
