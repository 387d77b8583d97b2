"""Numbers in a page: base64, which is a fifth of what they take as text."""

from base64 import b64encode

import numpy as np
from numpy.typing import DTypeLike, NDArray

from logs.results import Json


def array(values: NDArray[np.generic], kind: str) -> Json:
    """kind: one of f4, f8, u4, u1."""
    little_endian: DTypeLike = f"<{kind}"
    return {"type": kind, "data": b64encode(values.astype(little_endian).tobytes()).decode("ascii")}
