"""One picture's detections as rays of the camera: what every later step works with, in any lens.

Rays are unit vectors in the camera frame. `across` is how a ray changes when its pixel moves by one pixel across what
was seen there (a line, a post's edge), so a plane of normal n through the camera, n . ray off, passes that pixel at
(n . ray) / (n . across) pixels: first order in the lens, exact where it is zero.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldloc.camera import Camera
from fieldloc.lens import Mask
from fieldloc.pose import FloatArray
from fieldloc.vision.detections import Detections, SeenCircle, SeenLine

_MOST_LINES = 24
_MOST_POSTS = 8
_MOST_POINTS = 24  # of the circles: more say nothing that these do not
_SHORTEST_PX = 6.0
_LEAST_PX2 = 1e-6  # only so that no noise is none: who detects states what pixels err by


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """rays (n, 3), by_ray (n, 2, 3) change of the pixel with the ray, noise (n, 2, 2) px^2, known (n,) whether seen;
    out (n, 2) px from the camera's principal point."""

    rays: FloatArray
    out: FloatArray
    by_ray: FloatArray
    noise: FloatArray
    known: Mask

    def take(self, rows: Mask) -> "Points":
        return Points(self.rays[rows], self.out[rows], self.by_ray[rows], self.noise[rows], self.known[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """Lines: line_rays, line_across (l, 2, 3); line_noise (l, 2, 2) px^2 of both ends across it; line_lengths (l,) px;
    widths, width_sigmas (l, 2) px, NaN where not known. line_rows: (l,) of the detections.
    Posts: post_rays, post_across (p, 4, 3), post_out (p, 4) of left upper, left lower, right upper, right lower end;
    post_noise (p, 4, 4); post_widths: (p,) px. Their feet (p). post_rows: (p,).
    Circle, the largest: circle_rays (c, 3), circle_by_pixel (c, 3, 2), circle_out (c, 2), circle_sigmas (c,).
    """

    camera: Camera
    line_rays: FloatArray
    line_across: FloatArray
    line_out: FloatArray
    line_noise: FloatArray
    line_lengths: FloatArray
    widths: FloatArray
    width_sigmas: FloatArray
    line_rows: NDArray[np.intp]
    post_rays: FloatArray
    post_across: FloatArray
    post_out: FloatArray
    post_noise: FloatArray
    post_widths: FloatArray
    feet: Points
    post_rows: NDArray[np.intp]
    circle_rays: FloatArray
    circle_by_pixel: FloatArray
    circle_out: FloatArray
    circle_sigmas: FloatArray

    line_both: FloatArray
    """(l, 2, 2, 3): line_rays, line_across."""
    line_variances: FloatArray
    """(l, 2): the diagonals of line_noise."""
    line_by_focal: FloatArray
    """(l, 2, 2): change of both ends' errors, and of their widths' logarithms, with a longer focal length."""
    log_widths: FloatArray
    """(l, 2), zero where not known."""
    post_all: FloatArray
    """(p, 11, 3): post_rays, post_across, the foot's ray and the change of its pixel with it."""

    @property
    def focal_px(self) -> float:
        return 0.5 * (self.camera.fx_px + self.camera.fy_px)


def sight_of(detections: Detections, camera: Camera) -> Sight:
    """Of the longest lines and the largest posts, those that are finite and of which the lens has rays."""
    line_rows = _longest([_length(line.ends_px) for line in detections.lines], _MOST_LINES, _SHORTEST_PX)
    lines = [detections.lines[i] for i in line_rows]
    post_rows = _longest(
        [_length(post.left_px) + _length(post.right_px) for post in detections.posts], _MOST_POSTS, 2.0 * _SHORTEST_PX
    )
    posts = [detections.posts[i] for i in post_rows]
    ends = np.array([line.ends_px for line in lines], dtype=np.float64).reshape(-1, 2, 2)
    line_rays, line_across, line_out, line_noise, good = _edges(camera, ends, [line.covariance_px2 for line in lines])
    widths, width_sigmas = _widths(lines)
    of_posts = np.array([[post.left_px, post.right_px] for post in posts], dtype=np.float64).reshape(-1, 4, 2)
    post_rays, post_across, post_out, post_noise, stands = _edges(
        camera, of_posts, [post.covariance_px2 for post in posts]
    )
    feet = _points(camera, [(post.foot_px, post.foot_covariance_px2) for post in posts])
    circle = max(detections.circles, key=lambda one: len(one.points_px), default=None)
    circle_rays, circle_by_pixel, circle_out, circle_sigmas = _circle(camera, circle)
    lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    focal_px = 0.5 * (camera.fx_px + camera.fy_px)
    return Sight(
        camera,
        line_rays[good],
        line_across[good],
        line_out[good],
        line_noise[good],
        lengths[good],
        widths[good],
        width_sigmas[good],
        line_rows[good],
        post_rays[stands],
        post_across[stands],
        post_out[stands],
        post_noise[stands],
        focal_px * np.linalg.norm(post_rays[stands, :2].mean(axis=1) - post_rays[stands, 2:].mean(axis=1), axis=-1),
        feet.take(stands),
        post_rows[stands],
        circle_rays,
        circle_by_pixel,
        circle_out,
        circle_sigmas,
        np.stack([line_rays, line_across], axis=1)[good],
        line_noise[good].diagonal(axis1=1, axis2=2),
        np.stack([-line_out, -np.ones_like(line_out)], axis=1)[good],
        np.log(np.where(np.isfinite(widths), widths, 1.0))[good],
        np.concatenate([post_rays, post_across, feet.rays[:, None], feet.by_ray], axis=1)[stands],
    )


def _length(ends: FloatArray) -> float:
    return float(np.hypot(*(ends[1] - ends[0])))


def _longest(lengths: list[float], most: int, least: float) -> NDArray[np.intp]:
    values = np.array(lengths, dtype=np.float64)
    order = np.argsort(-values, kind="stable")[:most]
    return np.sort(order[values[order] >= least])


def _edges(
    camera: Camera, ends: FloatArray, covariances: list[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, Mask]:
    """Of segments with ends (n, e, 2), two and two: rays and their change across (n, e, 3); how far out from the
    principal point they are, across (n, e) px; noise (n, e, e); which are good (n,)."""
    count, size = ends.shape[:2]
    rays, by_pixel, exist = camera.ray_and_jacobian(ends)
    along = ends[:, 1::2] - ends[:, 0::2]
    length = np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-9)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1) / length[..., None]
    normal = np.repeat(normal, 2, axis=1)  # (n, e, 2)
    across = (by_pixel @ normal[..., None])[..., 0]
    full = np.array(covariances, dtype=np.float64).reshape(count, size, 2, size, 2)
    noise = np.einsum("nei,neifj,nfj->nef", normal, full, normal)
    noise = noise + _LEAST_PX2 * np.eye(size)
    good = exist.all(axis=1) & np.isfinite(noise).all(axis=(1, 2)) & np.isfinite(across).all(axis=(1, 2))
    good[good] = np.linalg.eigvalsh(noise[good])[:, 0] > 0.0
    out = np.sum((ends - _centre(camera)) * normal, axis=-1)
    return rays, across, out, noise, good


def _widths(lines: list[SeenLine]) -> tuple[FloatArray, FloatArray]:
    widths = np.array([line.width_px for line in lines], dtype=np.float64).reshape(-1, 2)
    sigmas = np.array([line.width_sigma_px for line in lines], dtype=np.float64).reshape(-1, 2)
    known = np.isfinite(widths) & np.isfinite(sigmas) & (widths > 0.0)
    return np.where(known, widths, np.nan), np.where(known, sigmas, np.nan)


def _points(camera: Camera, points: list[tuple[FloatArray | None, FloatArray | None]]) -> Points:
    count = len(points)
    pixels, noise = np.zeros((count, 2)), np.tile(np.eye(2), (count, 1, 1))
    known = np.zeros(count, dtype=np.bool_)
    for i, (pixel, covariance) in enumerate(points):
        if pixel is not None and covariance is not None and np.isfinite(pixel).all() and np.isfinite(covariance).all():
            pixels[i], noise[i], known[i] = pixel, covariance + _LEAST_PX2 * np.eye(2), True
    if not known.any():
        ahead = np.tile([0.0, 0.0, 1.0], (count, 1))
        return Points(ahead, np.zeros((count, 2)), np.zeros((count, 2, 3)), noise, known)
    rays, exist = camera.ray(pixels)
    by_ray = camera.project_jacobian(rays)
    known &= exist & np.isfinite(by_ray).all(axis=(1, 2))
    return Points(rays, pixels - _centre(camera), by_ray, noise, known)


def _circle(camera: Camera, circle: SeenCircle | None) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    if circle is None or not len(circle.points_px):
        return np.zeros((0, 3)), np.zeros((0, 3, 2)), np.zeros((0, 2)), np.zeros(0)
    count = len(circle.points_px)
    rows = np.unique(np.linspace(0, count - 1, min(count, _MOST_POINTS)).round().astype(np.intp))
    rays, by_pixel, exist = camera.ray_and_jacobian(circle.points_px[rows])
    sigmas = np.asarray(circle.sigma_px, dtype=np.float64)[rows]
    good = exist & np.isfinite(sigmas) & (sigmas > 0.0)
    return rays[good], by_pixel[good], (circle.points_px[rows] - _centre(camera))[good], sigmas[good]


def _centre(camera: Camera) -> FloatArray:
    return np.array([camera.cx_px, camera.cy_px])
