"""From one picture to everything that is seen in it."""

import cv2
import numpy as np

from fieldloc.camera import Camera
from fieldloc.colours import FieldColours
from fieldloc.pose import FloatArray
from fieldloc.vision.arcs import ellipse_of
from fieldloc.vision.chains import chains_of, parts
from fieldloc.vision.circle import find_ellipse, points_on
from fieldloc.vision.corners import find_corners
from fieldloc.vision.detections import Detections
from fieldloc.vision.edge_pairs import edge_pairs
from fieldloc.vision.lines import fit_lines
from fieldloc.vision.marks import find_marks
from fieldloc.vision.picture import UInt8Array
from fieldloc.vision.posts import find_posts
from fieldloc.vision.rim import trace
from fieldloc.vision.segments import merged, straight_pieces
from fieldloc.vision.settings import VisionSettings
from fieldloc.vision.sorting import sort_out
from fieldloc.vision.straight import Plane
from fieldloc.vision.stubs import find_stubs
from fieldloc.vision.turf import Mask, Turf, find_turf
from fieldloc.vision.white import find_runs

_COLOURS = FieldColours()
_DEFAULTS = VisionSettings()
_LEAST_CHAIN = 4  # runs of a piece of a line; what has fewer may be a mark


def detect(
    picture: UInt8Array,
    colours: FieldColours = _COLOURS,
    camera: Camera | None = None,
    settings: VisionSettings = _DEFAULTS,
) -> Detections:
    """What is seen in a picture (h, w, 3), blue first. camera: straight lines are sought through its lens."""
    height, width = picture.shape[:2]
    turf = find_turf(picture, colours)
    if turf.boundary_px is None:
        return Detections(width, height)
    plane = Plane(camera)
    patches, across = chains_of(find_runs(picture, turf, settings))
    chains = plane.chains([chain for chain in patches + across if len(chain) >= _LEAST_CHAIN])

    def view(points: FloatArray) -> tuple[Mask, Mask]:
        return _view(plane.to_picture(points), turf, width, height)

    found = find_ellipse(chains, view)
    # Brightness, as cameras and JPEG keep colours at half the resolution.
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    circle = None
    if found:
        circle = trace(grey, found[0], _on(chains, found[1]), plane, turf, settings, bent=False)
    posts = find_posts(picture, turf, colours, camera)
    if settings.finder == "runs":
        rest = parts(chains, found[1], False) if found and circle else chains
        pieces = straight_pieces(rest, 0.6 * settings.least_length_px)
    else:
        pieces = edge_pairs(grey, turf, found[0] if found and circle else None, plane, settings)
    lines, arcs = fit_lines(grey, merged(pieces), plane, turf, settings)
    if not circle and (ellipse := ellipse_of(arcs, view)):
        circle = trace(grey, ellipse, _on(chains, points_on(ellipse, chains)), plane, turf, settings, bent=True)
    lines = sort_out(lines, circle, posts, grey, turf, settings)
    lines += find_stubs(grey, lines, plane, turf, settings)
    return Detections(
        width,
        height,
        lines=lines,
        posts=posts,
        circles=(circle,) if circle else (),
        corners=find_corners(lines, plane),
        marks=find_marks(patches, grey, turf),
        boundary_px=turf.boundary_px,
    )


def _on(chains: list[FloatArray], masks: list[Mask]) -> FloatArray:
    return np.concatenate([chain[mask] for chain, mask in zip(chains, masks, strict=True)])


def _view(pixels: FloatArray, turf: Turf, width: int, height: int) -> tuple[Mask, Mask]:
    """Whether points are in the picture, and below the field's border."""
    inside = np.asarray(((pixels > 3.0) & (pixels < (width - 4.0, height - 4.0))).all(axis=1))
    return inside, turf.below_px(np.nan_to_num(pixels)) > -2.0
