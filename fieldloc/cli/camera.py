"""camera: a camera file, from a field of view or from pictures of a calibration board."""

import argparse
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fieldloc.camera import Across, Camera, camera_of_view, camera_to_toml
from fieldloc.cli.commands import Commands, positive
from fieldloc.cli.terminal import bar, say, warn
from fieldloc.errors import FieldlocError

if TYPE_CHECKING:
    from fieldloc.vision.boards import Board, BoardView
    from fieldloc.vision.calibrate import Calibration


def add_commands(commands: Commands) -> None:
    """camera."""
    what = "A camera file, from a field of view or from pictures of a calibration board"
    example = "camera boards/*.jpg --board chessboard --corners 9x6 --square-m 0.025 -o camera.toml"
    sub = commands.add("camera", _camera, what, example)
    sub.add_argument("images", type=Path, nargs="*", metavar="IMAGE", help="of the board, from several sides")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="CAMERA.toml")
    sub.add_argument("--fov-deg", type=positive, metavar="DEG", help="horizontal field of view, instead of images")
    across = sub.add_mutually_exclusive_group()
    across.add_argument(
        "--vertical", action="store_const", dest="across", const="vertical", help="--fov-deg is vertical"
    )
    across.add_argument(
        "--diagonal", action="store_const", dest="across", const="diagonal", help="from corner to corner"
    )
    sub.add_argument("--size", type=_size, metavar="WxH", help="pixels of the pictures, with --fov-deg: 640x480")
    sub.add_argument("--board", choices=("chessboard", "charuco"), help="what is in the images")
    sub.add_argument("--corners", type=_size, metavar="CxR", help="inner corners of the board, where squares meet: 9x6")
    sub.add_argument("--square-m", type=positive, metavar="M", help="side of a square; its unit does not matter here")
    sub.add_argument("--marker-m", type=positive, metavar="M", help="charuco: side of a marker")
    sub.add_argument(
        "--dictionary", default="4X4_50", metavar="NAME", help="charuco: of its markers; default: %(default)s"
    )
    sub.add_argument("--fisheye", action="store_true", help="a fisheye lens, more than some 100 degrees wide")


def _camera(options: argparse.Namespace) -> None:
    from logs.output import output_file

    out = output_file(options.output, *options.images)
    if options.fov_deg is not None:
        camera = _from_view(options)
    elif options.images:
        camera = _from_images(options)
    else:
        raise FieldlocError("camera: give either images of a board, or --fov-deg and --size")
    _write(camera, out)
    say(options, f"camera: {out}")


def _from_view(options: argparse.Namespace) -> Camera:
    if options.images or options.board or options.fisheye:
        raise FieldlocError("--fov-deg: makes a camera without images; leave out images, --board and --fisheye")
    if options.size is None:
        raise FieldlocError("--fov-deg: needs --size too, for example --size 640x480")
    across: Across = options.across or "horizontal"
    try:
        width_px, height_px = options.size
        return camera_of_view(width_px, height_px, math.radians(options.fov_deg), across)
    except ValueError as error:
        raise FieldlocError(f"--fov-deg: {error}") from None


def _from_images(options: argparse.Namespace) -> Camera:
    from fieldloc.vision.calibrate import calibrate

    if options.size is not None or options.across is not None:
        raise FieldlocError("--size, --vertical and --diagonal: go with --fov-deg; images have their own size")
    board = _board(options)
    views, names, size = _views(options, board)
    try:
        done = calibrate(views, size, "fisheye" if options.fisheye else "pinhole")
    except FieldlocError as error:
        raise FieldlocError(f"{len(options.images)} images: {error}") from None
    _tell(options, done, names)
    return done.camera


def _board(options: argparse.Namespace) -> "Board":
    from fieldloc.vision.boards import Board

    if options.board is None or options.corners is None or options.square_m is None:
        raise FieldlocError("camera: images need --board, --corners and --square-m, for example chessboard, 9x6, 0.025")
    if options.board == "charuco" and options.marker_m is None:
        raise FieldlocError("--board charuco: needs --marker-m too")
    try:
        columns, rows = options.corners
        return Board(options.board, columns, rows, options.square_m, options.marker_m or 0.0, options.dictionary)
    except ValueError as error:
        raise FieldlocError(f"--board {options.board}: {error}") from None


def _views(options: argparse.Namespace, board: "Board") -> tuple[list["BoardView"], list[Path], tuple[int, int]]:
    """Boards that were found, in which images, and the size of those; what is left out is said."""
    from fieldloc.vision.boards import find_board
    from fieldloc.vision.picture import load_picture

    found: list[tuple[Path, tuple[int, int], BoardView]] = []
    with bar(options, "looking for boards") as progress:
        for n, path in enumerate(options.images):
            progress(n, len(options.images))
            try:
                picture = load_picture(path)
            except FieldlocError as error:
                warn([f"{error}; left out"])
                continue
            view = find_board(picture, board)
            if view is None:
                warn([f"{path}: no {board.kind} of {board.columns}x{board.rows} inner corners is seen; left out"])
            else:
                found.append((path, (picture.shape[1], picture.shape[0]), view))
    if not found:
        raise FieldlocError(f"no board is seen in any of {len(options.images)} images; --corners counts inner corners")
    sizes = [size for _, size, _ in found]
    size = max(sizes, key=sizes.count)
    warn([f"{path}: is {w}x{h}, most are {size[0]}x{size[1]}; left out" for path, (w, h), _ in found if (w, h) != size])
    kept = [one for one in found if one[1] == size]
    return [view for _, _, view in kept], [path for path, _, _ in kept], size


def _tell(options: argparse.Namespace, done: "Calibration", names: list[Path]) -> None:
    for path, rms_px in zip(names, done.rms_px.tolist(), strict=True):
        say(
            options, f"{path}: {rms_px:.3f} px" if np.isfinite(rms_px) else f"{path}: does not fit the others; left out"
        )
    camera = done.camera
    numbers = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion]
    for (name, sigma), number in zip(done.sigmas.items(), numbers, strict=True):
        say(options, f"{name} = {number:.6g} +- {sigma:.2g}")
    total = float(np.sqrt(np.nanmean(done.rms_px**2)))
    say(options, f"{np.count_nonzero(np.isfinite(done.rms_px))} of {len(options.images)} images, {total:.3f} px")


def _write(camera: Camera, path: Path) -> None:
    from logs.atomic import atomic_text

    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_text(path) as file:
        file.write(camera_to_toml(camera))


def _size(text: str) -> tuple[int, int]:
    if match := re.fullmatch(r"([1-9]\d{0,5})[xX]([1-9]\d{0,5})", text):
        return int(match[1]), int(match[2])
    raise argparse.ArgumentTypeError(f"'{text}' is no size; two whole numbers as in 640x480")
