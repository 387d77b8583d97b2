"""What detectors say about one image, on one topic or several, to one ImageFeatures.

Whatever comes from one image shares the errors of its camera's mount, so it must not be counted twice: messages with
the same stamp are put together. Boxes become posts: their sides at half height are the edges, the middle of their
lower side is the foot. Lines on the ground in metres go back to the pixels that they came from.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from fieldloc.camera import Camera
from fieldloc.ground import project_points, robot_from_camera
from fieldloc.measurements import CameraMount, ImageFeatures, LineObservation, PostObservation
from fieldloc.pose import FloatArray
from logs.foreign.notes import complaint
from logs.foreign.parts import ImageDetectionsPart, Part, SpaceDetectionsPart
from logs.foreign.rotations import Motion, matrix
from logs.foreign.settings import DetectionNoise
from logs.foreign.surroundings import Surroundings, Unusable

_WAIT_NS = 500_000_000  # for what another topic says about an image
_AT_BORDER_PX = 2.0
_ASIDE = 0.25  # how far beyond the image, in images, a line may end that comes back from the ground
_NARROWEST = 0.25  # of its box, a post that leans in it
_STEEPEST = 0.5  # lean of a post in the image, as a slope
_NO_CAMERA = "no camera intrinsics: the log has none; give them with camera = FILE in a --mapping"

_Detections = ImageDetectionsPart | SpaceDetectionsPart
_Image = dict[str, _Detections]  # by topic


class ImageAdapter:
    """All topics whose messages tell of the same images."""

    def __init__(self, surroundings: Surroundings, topics: Sequence[str]) -> None:
        self._around = surroundings
        self._newest_ns = dict.fromkeys(topics, -1)
        self._waiting: dict[int, _Image] = {}

    def take(self, topic: str, stamp_ns: int, part: Part) -> Iterator[ImageFeatures]:
        if not isinstance(part, ImageDetectionsPart | SpaceDetectionsPart):
            return
        _check(part)
        self._waiting.setdefault(stamp_ns, {})[topic] = part
        self._newest_ns[topic] = max(self._newest_ns[topic], stamp_ns)
        yield from self._ready()

    def finish(self) -> Iterator[ImageFeatures]:
        for stamp_ns in sorted(self._waiting):
            yield from self._features(stamp_ns, self._waiting.pop(stamp_ns))

    def _ready(self) -> Iterator[ImageFeatures]:
        """Images of which every topic has spoken, or something newer, or which are old."""
        newest_ns = max(self._newest_ns.values())
        for stamp_ns in sorted(self._waiting):
            image = self._waiting[stamp_ns]
            silent = [topic for topic, seen_ns in self._newest_ns.items() if seen_ns < stamp_ns]
            if not silent or newest_ns - stamp_ns > _WAIT_NS:
                del self._waiting[stamp_ns]
                yield from self._features(stamp_ns, image)

    def _features(self, stamp_ns: int, image: _Image) -> Iterator[ImageFeatures]:
        if not any(len(part.lines) or len(_posts(part)) for part in image.values()):
            return
        around = self._around
        try:
            if around.camera is None:
                raise Unusable(_NO_CAMERA)
            frames = [part.frame for part in image.values() if isinstance(part, ImageDetectionsPart)]
            mount = around.mount(frames[0] if frames else "", stamp_ns)
            posts: list[PostObservation] = []
            lines: list[LineObservation] = []
            noise = around.mapping.detections
            for part in image.values():
                ends = part.lines[~(part.line_confidences < noise.min_confidence)]
                if isinstance(part, ImageDetectionsPart):
                    posts += posts_of_boxes(part, around.camera, mount, noise)
                else:
                    ends = _in_image(ends, around.robot_from(part.frame, stamp_ns), around.camera, mount)
                lines += [LineObservation(pair, noise.line_sigma_px**2 * np.eye(4)) for pair in ends]
        except Unusable as error:
            for topic in image:
                around.notes.leave_out(topic, complaint(topic, stamp_ns, str(error)))
            return
        if posts or lines:
            yield ImageFeatures(stamp_ns, mount, tuple(posts), tuple(lines))


def posts_of_boxes(
    part: ImageDetectionsPart, camera: Camera, mount: CameraMount, noise: DetectionNoise
) -> list[PostObservation]:
    """Boxes cut off at the left or right are no posts; one cut off below has no foot."""
    out = []
    for (u, v, width, height), confidence in zip(part.boxes.tolist(), part.box_confidences.tolist(), strict=True):
        left, right, bottom = u - width / 2, u + width / 2, v + height / 2
        cut = left < _AT_BORDER_PX or right > camera.width_px - 1 - _AT_BORDER_PX
        if cut or width <= 0.0 or height <= 0.0 or confidence < noise.min_confidence:
            continue
        # a post that leans in the image has a box wider than itself, and its foot is not under the box's middle
        lean = _lean(camera, mount, np.array([u, v]))
        half = max(width - abs(lean) * height, _NARROWEST * width) / 2
        has_foot = bottom < camera.height_px - 1 - _AT_BORDER_PX
        out.append(
            PostObservation(
                np.array([[u - half, v], [u + half, v]]),
                noise.edge_sigma_px**2 * np.eye(4),
                np.array([u + lean * height / 2, bottom]) if has_foot else None,
                noise.foot_sigma_px**2 * np.eye(2) if has_foot else None,
            )
        )
    return out


def _lean(camera: Camera, mount: CameraMount, pixel: FloatArray) -> float:
    """Change of u with v along something upright that is seen at the pixel."""
    ray, exists = camera.ray(pixel)
    if not exists:
        return 0.0
    down = robot_from_camera(mount).T @ np.array([0.0, 0.0, -1.0])
    du, dv = (camera.project_jacobian(ray) @ down).tolist()
    return float(np.clip(du / dv, -_STEEPEST, _STEEPEST)) if dv > 0.0 else 0.0


def _in_image(lines: FloatArray, robot_from_frame: Motion, camera: Camera, mount: CameraMount) -> FloatArray:
    """Pixels (k, 2, 2) of lines (n, 2, 3), without those that the camera cannot have seen."""
    if not len(lines):
        return np.zeros((0, 2, 2))
    in_robot = lines @ matrix(robot_from_frame.rotation).T + np.array(robot_from_frame.translation)
    pixels, _ = project_points(camera, mount, in_robot)
    size = np.array([camera.width_px, camera.height_px])
    near = ((pixels > -_ASIDE * size) & (pixels < (1.0 + _ASIDE) * size)).all(axis=(-1, -2))
    return pixels[near]


def _posts(part: _Detections) -> FloatArray:
    """Of a part in metres posts are a scan's business."""
    return part.boxes if isinstance(part, ImageDetectionsPart) else part.lines


def _check(part: _Detections) -> None:
    if not (np.isfinite(_posts(part)).all() and np.isfinite(part.lines).all()):
        raise Unusable("a detection holds a value that is not finite")
