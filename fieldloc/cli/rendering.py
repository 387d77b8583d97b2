"""render: pictures of a field with exact truth."""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fieldloc.camera import Camera, load_camera
from fieldloc.cli.commands import Commands, positive, quality, seed
from fieldloc.cli.terminal import bar, say
from fieldloc.errors import FieldlocError
from fieldloc.field import load_field
from fieldloc.measurements import CameraMount
from fieldloc.pose import FloatArray

if TYPE_CHECKING:  # what is slow to load waits until it is needed
    from fieldloc.render.random_views import View

_HEIGHT_M, _TILT_DEG = 0.5, 15.0
_MOST_VIEWS = 1_000_000
_FEW = 4  # views that are not worth a second process
_MOUNT = ("height_m", "pan_deg", "tilt_deg", "roll_deg")


def add_commands(commands: Commands) -> None:
    """render."""
    what, example = "A picture of a field with its truth", "render --field spl --pose -2,0.5,20 -o view.png"
    sub = commands.add("render", _render, what, example)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.png|.jpg", help="a folder with --random")
    sub.add_argument("--field", default="kidsize", metavar="NAME|FILE", help="default: %(default)s")
    sub.add_argument("--camera", type=Path, metavar="FILE.toml", help="default: 640 x 480, 60 degrees wide")
    sub.add_argument("--pose", type=_pose, metavar="X,Y,HEADING_DEG", help="of the robot under the camera")
    sub.add_argument("--height-m", type=positive, metavar="H", help=f"of the camera; default: {_HEIGHT_M:g}")
    sub.add_argument("--pan-deg", type=_angle, metavar="A", help="to the left; default: 0")
    sub.add_argument("--tilt-deg", type=_angle, metavar="A", help=f"downwards; default: {_TILT_DEG:g}")
    sub.add_argument("--roll-deg", type=_angle, metavar="A", help="right side down; default: 0")
    sub.add_argument("--random", type=_count, metavar="N", help="views from anywhere on the field instead of one pose")
    sub.add_argument("--seed", type=seed, default=0, metavar="N", help="the same seed is the same picture")
    sub.add_argument("--clean", action="store_true", help="nothing but the field, and no noise")
    sub.add_argument("--suffix", default=".png", metavar=".png|.jpg", help="of the pictures of --random")
    sub.add_argument("--quality", type=quality, default=95, metavar="Q", help="of JPEG, 1 to 100; default: %(default)s")


def _render(options: argparse.Namespace) -> None:
    from fieldloc.render.random_views import USUAL_CAMERA

    load_field(options.field)
    camera = USUAL_CAMERA if options.camera is None else load_camera(options.camera)
    if options.random is not None:
        _render_many(options, camera)
    elif options.pose is None:
        raise FieldlocError("render: from where? give --pose X,Y,HEADING_DEG, or --random N")
    else:
        _render_one(options, camera)


def _render_one(options: argparse.Namespace, camera: Camera) -> None:
    from fieldloc.render.random_views import View, random_scene
    from fieldloc.render.scene import Scene
    from logs.output import output_file

    out = output_file(options.output)
    if out.suffix.lower() == ".json":
        raise FieldlocError(f"{out}: the truth goes there; name a picture with -o, .png or .jpg")
    field, random = load_field(options.field), np.random.default_rng(options.seed)
    tilt_deg = _TILT_DEG if options.tilt_deg is None else options.tilt_deg
    pan_rad, tilt_rad, roll_rad = np.radians([options.pan_deg or 0.0, tilt_deg, options.roll_deg or 0.0]).tolist()
    mount = CameraMount(options.height_m or _HEIGHT_M, pan_rad, tilt_rad, roll_rad, np.zeros((4, 4)))
    scene = Scene() if options.clean else random_scene(field, random, options.pose[:2])
    _write(View(scene, camera, mount, options.pose), options.field, out, (options.seed,), options.quality, random)
    say(options, f"{out}, {out.with_suffix('.json')}")


def _render_many(options: argparse.Namespace, camera: Camera) -> None:
    from logs.output import output_folder

    given = [name for name in ("pose", *_MOUNT) if getattr(options, name) is not None]
    if given:
        raise FieldlocError(f"--{given[0].replace('_', '-')}: --random draws it; leave out one of the two")
    folder = output_folder(options.output)
    _make(folder)
    count: int = options.random
    write = partial(
        _write_random, options.field, camera, options.seed, options.clean, folder, options.suffix, options.quality
    )
    with bar(options, "rendering") as progress:
        if count < _FEW:
            for index in range(count):
                write(index)
        else:
            with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
                try:
                    for done, future in enumerate(as_completed([pool.submit(write, k) for k in range(count)]), 1):
                        future.result()
                        progress(done, count)
                finally:
                    pool.shutdown(cancel_futures=True)
    say(options, f"{folder}: {count} pictures, each with its truth beside it")


def _write_random(
    field_name: str, camera: Camera, seed: int, clean: bool, folder: Path, suffix: str, quality: int, index: int
) -> None:
    """In whatever process; each view has random numbers of its own."""
    from fieldloc.render.random_views import random_view

    random = np.random.default_rng([seed, index])
    view = random_view(load_field(field_name), random, camera, clean)
    _write(view, field_name, folder / f"{index:06d}{suffix}", (seed, index), quality, random)


def _write(
    view: "View", field_name: str, path: Path, seed: tuple[int, ...], quality: int, random: np.random.Generator
) -> None:
    from fieldloc.render.document import truth_json
    from fieldloc.render.renderer import render_with_truth
    from fieldloc.vision.picture import encode
    from logs.atomic import write_atomic

    field = load_field(field_name)
    picture, truth = render_with_truth(view.scene, view.camera, field, view.mount, view.pose, random)
    data = encode(picture, path.suffix, quality)
    write_atomic(path, data)
    write_atomic(path.with_suffix(".json"), f"{truth_json(view, field.name, truth, seed)}\n".encode())


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FieldlocError(f"{folder}: cannot be made: {error.strerror or error}") from None


def _pose(text: str) -> FloatArray:
    with suppress(ValueError):
        x_m, y_m, heading_deg = (float(part) for part in text.split(","))
        if np.isfinite([x_m, y_m, heading_deg]).all() and max(abs(x_m), abs(y_m)) <= 1000.0:
            return np.array([x_m, y_m, np.radians(heading_deg)])
    raise argparse.ArgumentTypeError(f"'{text}' is not X,Y,HEADING_DEG in metres and degrees, for example -2.5,0,90")


def _angle(text: str) -> float:
    with suppress(ValueError):
        if -360.0 <= (value := float(text)) <= 360.0:
            return value
    raise argparse.ArgumentTypeError(f"'{text}' is not an angle in degrees")


def _count(text: str) -> int:
    if text.isascii() and text.isdigit() and 1 <= int(text) <= _MOST_VIEWS:
        return int(text)
    raise argparse.ArgumentTypeError(f"'{text}' is not a number of views from 1 to {_MOST_VIEWS}")
