"""locate: from photographs to the poses of the camera that took them."""

import argparse
import json
import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from fieldloc.camera import Camera, load_camera
from fieldloc.cli.commands import Commands, positive
from fieldloc.cli.terminal import bar, say, warn
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, load_field

if TYPE_CHECKING:
    from fieldloc.locate import CameraPrior, Located
    from fieldloc.vision.detections import Detections


def add_commands(commands: Commands) -> None:
    """locate."""
    what, example = "Where a photograph was taken: every pose that explains it", "locate photo.jpg --field spl"
    sub = commands.add("locate", _locate, what, f"{example} --camera camera.toml --overlay seen.png")
    sub.add_argument("images", type=Path, nargs="+", metavar="IMAGE", help="JPEG, PNG, ..; several are told one by one")
    sub.add_argument("--field", required=True, metavar="NAME|FILE", help="a map by name or TOML file")
    sub.add_argument("--camera", type=Path, required=True, metavar="FILE.toml", help="see 'fieldloc camera --help'")
    unknown = "found from the picture if not given"
    sub.add_argument("--height-m", type=positive, metavar="H", help=f"the camera's height above the ground; {unknown}")
    sub.add_argument(
        "--pitch-deg", type=finite, metavar="P", help=f"how far the camera looks down: down is positive; {unknown}"
    )
    sub.add_argument(
        "--roll-deg", type=finite, metavar="R", help=f"how it leans: its right side down is positive; {unknown}"
    )
    sigma = "standard deviation; default: %(default)s"
    sub.add_argument("--sigma-height-m", type=positive, default=0.03, metavar="S", help=f"of --height-m: {sigma}")
    sub.add_argument(
        "--sigma-attitude-deg", type=positive, default=3.0, metavar="S", help=f"of --pitch-deg and --roll-deg: {sigma}"
    )
    sub.add_argument(
        "--json",
        action="store_true",
        help="all hypotheses, with what was detected; x_m, y_m are below the camera, heading_rad is where it looks",
    )
    sub.add_argument(
        "--detections",
        type=Path,
        metavar="FILE.jsonl",
        help="what another detector found, a line of JSON for each image, instead of looking (docs/pictures.md)",
    )
    sub.add_argument(
        "--overlay",
        type=Path,
        metavar="OUT.png",
        help="the map drawn over the picture, and the hypotheses on a plan; of several images OUT-FOLDER-NAME.png each",
    )


def _locate(options: argparse.Namespace) -> None:
    from fieldloc.locate import CameraPrior

    field, camera = load_field(options.field), load_camera(options.camera)
    prior = CameraPrior.told(
        options.height_m,
        None if options.pitch_deg is None else math.radians(options.pitch_deg),
        None if options.roll_deg is None else math.radians(options.roll_deg),
        options.sigma_height_m,
        math.radians(options.sigma_attitude_deg),
    )
    plugged = None
    if options.detections is not None:
        from fieldloc.vision.plugged import load_detections

        plugged = load_detections(options.detections)
    told: list[dict[str, object]] = []
    failures: list[str] = []
    with bar(options, "locating") as progress:
        for i, path in enumerate(options.images):
            progress(i, len(options.images), path.name)
            try:
                detections, located = _one(path, field, camera, prior, plugged, _overlay_path(options, path))
            except FieldlocError as error:
                failures.append(str(error))
                told.append({"image": str(path), "error": str(error)})
                continue
            told.append(_record(path, detections, located))
            if not options.json:
                _say(options, path, located)
        progress(len(options.images), len(options.images))
    if options.json:
        print(json.dumps(told[0] if len(told) == 1 else told, indent=1))
    if len(failures) == len(options.images):
        raise FieldlocError(failures[0] if len(failures) == 1 else f"none of the images can be used; {failures[0]}")
    warn(failures)


def _one(
    path: Path,
    field: FieldMap,
    camera: Camera,
    prior: "CameraPrior",
    plugged: "Mapping[str, Detections] | None",
    overlay: Path | None,
) -> "tuple[Detections, Located]":
    from fieldloc.locate import locate
    from fieldloc.vision.detect import detect
    from fieldloc.vision.overlay import draw
    from fieldloc.vision.picture import encode, load_picture
    from logs.atomic import write_atomic

    picture = load_picture(path)
    height, width = picture.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        raise FieldlocError(
            f"{path}: is {width} x {height} pixels, the camera {camera.width_px} x {camera.height_px}; "
            "give the camera file of that size"
        )
    if plugged is None:
        detections = detect(picture, field.colours, camera)
    elif (found := plugged.get(str(path), plugged.get(path.name))) is not None:
        detections = found
    else:
        raise FieldlocError(f"{path}: the detections given say nothing of it")
    located = locate(detections, camera, field, prior)
    if overlay is not None:
        data = encode(draw(picture, detections, located, camera, field), overlay.suffix or ".png")
        write_atomic(overlay, data)
    return detections, located


def _overlay_path(options: argparse.Namespace, image: Path) -> Path | None:
    out: Path | None = options.overlay
    if out is None or len(options.images) == 1:
        return out
    return out.with_name(f"{out.stem}-{image.parent.name}-{image.stem}{out.suffix}")


def _say(options: argparse.Namespace, path: Path, located: "Located") -> None:
    if not located.hypotheses:
        say(options, f"{path}: no pose explains what is seen")
        return
    say(options, f"{path}:")
    for one in located.hypotheses[:8]:
        x_m, y_m, heading_rad = one.pose
        sigma = [math.sqrt(one.covariance[i, i]) for i in range(3)]
        say(
            options,
            f"  {100 * one.probability:5.1f} %  x {x_m:.2f} +- {sigma[0]:.2f} m, y {y_m:.2f} +- {sigma[1]:.2f} m, "
            f"heading {math.degrees(heading_rad):.1f} +- {math.degrees(sigma[2]):.1f} deg; "
            f"camera {one.height_m:.2f} m high, pitch {math.degrees(one.pitch_rad):.1f}, "
            f"roll {math.degrees(one.roll_rad):.1f} deg",
        )
    say(options, f"  {100 * located.none:5.1f} %  none of these")


def _record(path: Path, detections: "Detections", located: "Located") -> dict[str, object]:
    return {
        "image": str(path),
        "hypotheses": [
            {
                "x_m": float(one.pose[0]),
                "y_m": float(one.pose[1]),
                "heading_rad": float(one.pose[2]),
                "covariance": one.covariance.tolist(),
                "probability": one.probability,
                "camera": {
                    "x_m": float(one.pose[0]),
                    "y_m": float(one.pose[1]),
                    "height_m": one.height_m,
                    "heading_rad": float(one.pose[2]),
                    "pitch_rad": one.pitch_rad,
                    "roll_rad": one.roll_rad,
                    "covariance": one.full_covariance.tolist(),
                },
                "lines": one.lines.tolist(),
                "posts": one.posts.tolist(),
                "circle": one.circle,
            }
            for one in located.hypotheses
        ],
        "none_probability": located.none,
        "detections": {
            "lines": [
                {
                    "ends_px": line.ends_px.tolist(),
                    "covariance_px2": line.covariance_px2.tolist(),
                    "width_px": [_number(w) for w in line.width_px],
                }
                for line in detections.lines
            ],
            "posts": [
                {
                    "left_px": post.left_px.tolist(),
                    "right_px": post.right_px.tolist(),
                    "covariance_px2": post.covariance_px2.tolist(),
                    "box_px": post.box_px.tolist(),
                    "foot_px": None if post.foot_px is None else post.foot_px.tolist(),
                    "top_px": None if post.top_px is None else post.top_px.tolist(),
                }
                for post in detections.posts
            ],
            "circles": [
                {"ellipse": circle.ellipse.tolist(), "points_px": circle.points_px.tolist()}
                for circle in detections.circles
            ],
            "corners": [{"point_px": corner.point_px.tolist(), "kind": corner.kind} for corner in detections.corners],
            "marks": [{"centre_px": mark.centre_px.tolist()} for mark in detections.marks],
        },
    }


def finite(text: str) -> float:
    with suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"'{text}' is not a number")


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
