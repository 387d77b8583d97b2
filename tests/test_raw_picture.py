"""Pixels without compression, in the encodings of cameras, as BGR pictures."""

import numpy as np
import pytest

from fieldloc.vision.raw_picture import from_pixels

BGR = np.array([[[10, 20, 30], [40, 50, 60]], [[70, 80, 90], [100, 110, 120]], [[5, 15, 25], [35, 45, 55]]], np.uint8)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("bgr8", BGR),
        ("rgb8", BGR[..., ::-1]),
        ("bgra8", np.dstack([BGR, np.full(BGR.shape[:2], 7, np.uint8)])),
        ("rgba8", np.dstack([BGR[..., ::-1], np.full(BGR.shape[:2], 7, np.uint8)])),
        ("8UC3", BGR),
    ],
)
@pytest.mark.parametrize("padding", [0, 5])
def test_colours_come_in_any_order_and_rows_of_any_length(encoding: str, pixels: np.ndarray, padding: int) -> None:
    rows = np.pad(pixels.reshape(3, -1), ((0, 0), (0, padding)), constant_values=255)
    picture = from_pixels(rows.tobytes(), encoding, 2, 3, rows.shape[1] if padding else 0)
    np.testing.assert_array_equal(picture, BGR)


def test_the_last_row_may_end_where_its_pixels_end() -> None:
    rows = np.pad(BGR.reshape(3, -1), ((0, 0), (0, 4))).tobytes()[:-4]
    np.testing.assert_array_equal(from_pixels(rows, "bgr8", 2, 3, 10), BGR)


def test_grey_has_three_equal_colours() -> None:
    picture = from_pixels(bytes([0, 100, 200, 255]), "mono8", 2, 2, 0)
    np.testing.assert_array_equal(picture[..., 0], [[0, 100], [200, 255]])
    assert (picture == picture[..., :1]).all()


def test_sixteen_bits_are_spread_over_eight() -> None:
    deep = np.array([[0, 1000], [2000, 4000]], "<u2")
    picture = from_pixels(deep.tobytes(), "mono16", 2, 2, 0)
    np.testing.assert_array_equal(picture[..., 0], [[0, 63], [127, 255]])


@pytest.mark.parametrize("encoding", ["yuyv", "uyvy"])
def test_grey_in_paired_colours_stays_grey(encoding: str) -> None:
    luma, chroma = [60, 120, 180, 230], 128
    order = [(y, chroma) if encoding == "yuyv" else (chroma, y) for y in luma]
    picture = from_pixels(bytes(value for pair in order for value in pair), encoding, 2, 2, 0)
    assert (np.ptp(picture, axis=-1) <= 1).all()
    assert (np.diff(picture[..., 0].ravel().astype(int)) > 0).all()


@pytest.mark.parametrize(
    ("data", "encoding", "size", "said"),
    [
        (b"\0" * 12, "nv21", (2, 2), "encoding 'nv21' is not known"),
        (b"\0" * 11, "bgr8", (2, 2), "no picture of 2 by 2"),
        (b"", "mono8", (0, 0), "no picture of 0 by 0"),
        (b"\0" * 12, "bgr8", (2, 2, 3), "no picture"),
    ],
)
def test_what_is_no_picture_is_refused(data: bytes, encoding: str, size: tuple[int, ...], said: str) -> None:
    width, height, step = (*size, 0)[:3]
    with pytest.raises(ValueError, match=said):
        from_pixels(data, encoding, width, height, step)
