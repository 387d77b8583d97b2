import os
import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import pytest

from fieldloc.errors import FieldlocError
from fieldloc.vision.picture import as_bgr, decode, encode, load_picture

PICTURE = np.random.default_rng(1).integers(0, 256, (20, 30, 3), dtype=np.uint8)


def test_a_picture_comes_back_from_its_png_as_it_was():
    assert np.array_equal(decode(encode(PICTURE, ".png"), "a"), PICTURE)


@pytest.mark.parametrize("pixels", [PICTURE[:, :, 0], PICTURE[:, :1], np.dstack([PICTURE, PICTURE[:, :, :1]])])
def test_grey_narrow_and_transparent_pictures_become_blue_green_red(pixels):
    done, data = cv2.imencode(".png", pixels)
    found = decode(data.tobytes(), "a")
    expected = pixels[:, :, :3] if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)
    assert done
    assert np.array_equal(found, expected)


def test_sixteen_bits_become_the_upper_eight():
    pixels = PICTURE.astype(np.uint16) * 257
    done, data = cv2.imencode(".png", pixels)
    assert done
    assert np.array_equal(decode(data.tobytes(), "a"), PICTURE)
    assert np.array_equal(as_bgr(pixels), PICTURE)


def test_a_picture_is_turned_as_its_exif_says():
    # JPEG: an APP1 segment right after the start, with the one entry "orientation: 6" (turn by 90 degrees)
    wide = np.zeros((16, 32, 3), np.uint8)
    wide[:, 16:] = 255
    data = encode(wide, ".jpg")
    entry = struct.pack(">HHIHH", 0x0112, 3, 1, 6, 0)
    tiff = b"MM\x00\x2a\x00\x00\x00\x08\x00\x01" + entry + b"\x00\x00\x00\x00"
    segment = b"Exif\x00\x00" + tiff
    turned = decode(data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:], "a")
    assert turned.shape == (32, 16, 3)
    assert turned[:12].mean() < 20 < 235 < turned[20:].mean()


@pytest.mark.parametrize("data", [b"", b"no picture at all " * 9, encode(PICTURE, ".png")[:40]])
def test_what_is_no_picture_is_named_with_the_way_out(data, capfd):
    with pytest.raises(FieldlocError, match=r"^shot\.png: .*JPEG, PNG") as error:
        decode(data, "shot.png")
    assert "\n" not in str(error.value)


def test_a_file_that_claims_to_be_huge_is_refused_before_it_takes_the_memory(capfd):
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 20_000, 20_000, 8, 2, 0, 0, 0))
    data = b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")
    with pytest.raises(FieldlocError, match="big"):
        decode(data, "big")


def test_a_file_that_is_missing_or_a_folder_is_named(tmp_path):
    with pytest.raises(FieldlocError, match="no such picture"):
        load_picture(tmp_path / "none.png")
    with pytest.raises(FieldlocError, match="cannot be read"):
        load_picture(tmp_path)
    with pytest.raises(FieldlocError, match="cannot be read"):
        load_picture("a\0b")


def test_a_file_on_disk_is_read(tmp_path):
    path = tmp_path / "shot.png"
    path.write_bytes(encode(PICTURE, ".png"))
    assert np.array_equal(load_picture(path), PICTURE)


@pytest.mark.parametrize(("told", "threads"), [(None, "1"), ("3", "3")])
def test_opencv_has_one_thread_unless_the_environment_says_more(told, threads):
    environment = {key: value for key, value in os.environ.items() if key != "OPENCV_FOR_THREADS_NUM"}
    if told:
        environment["OPENCV_FOR_THREADS_NUM"] = told
    code = "import fieldloc.vision.picture, cv2; print(cv2.getNumThreads())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.strip() == threads


@pytest.mark.parametrize("suffix", ["", ".xyz", "png"])
def test_a_suffix_that_is_no_format_is_named(suffix):
    with pytest.raises(FieldlocError, match="no picture can be written"):
        encode(PICTURE, suffix)


def test_jpeg_of_less_quality_is_smaller():
    assert len(encode(PICTURE, ".jpg", 30)) < len(encode(PICTURE, ".jpg", 95))


@pytest.mark.parametrize("pixels", [np.zeros((4, 5)), np.zeros((4, 5, 2), np.uint8), np.zeros((0, 5, 3), np.uint8)])
def test_arrays_that_are_no_picture_are_a_callers_mistake(pixels):
    with pytest.raises(ValueError, match="a picture"):
        as_bgr(pixels)
