"""Hypothesis strategies for every record that a log can hold, and what it means for two of them to be the same."""

from dataclasses import fields, is_dataclass
from typing import get_args

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from estimators.base import Ambiguity, Estimate, Event, EventKind, Hypothesis
from fieldloc.camera import Camera
from fieldloc.field import FieldMap, Landmark
from fieldloc.measurements import (
    CameraMount,
    Compass,
    ImageFeatures,
    InitialPose,
    LandmarkScan,
    LineObservation,
    Odometry,
    PostObservation,
    Truth,
)

FINITE = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(min_value=1e-6, max_value=1e6)
STAMPS = st.integers(0, 2**63 - 1)
LABELS = st.none() | st.text(max_size=8)


def vectors(*shape):
    return arrays(np.float64, shape, elements=FINITE)


@st.composite
def covariances(draw, size):
    """Positive definite, with units of very different size and correlations up to about 0.99."""
    roots = draw(arrays(np.float64, (size, size), elements=st.floats(-1.0, 1.0)))
    scale = draw(arrays(np.float64, size, elements=st.floats(1e-4, 1e4)))
    matrix = roots @ roots.T + 0.01 * np.eye(size)
    matrix = matrix * scale[:, None] * scale
    return 0.5 * (matrix + matrix.T)


@st.composite
def scans(draw):
    labels = tuple(draw(st.lists(LABELS, max_size=5)))
    ranges = draw(arrays(np.float64, len(labels), elements=POSITIVE))
    bearings = draw(vectors(len(labels)))
    matrices = [draw(covariances(2)) for _ in labels]
    return LandmarkScan(
        draw(STAMPS),
        labels,
        np.stack([ranges, bearings], axis=-1),
        np.array(matrices).reshape(-1, 2, 2),
        draw(vectors(3)),
    )


@st.composite
def maps(draw):
    labels = draw(st.lists(st.text(max_size=8), unique=True, max_size=4))
    spots = st.integers(-50, 50).map(float)
    marks = tuple(
        Landmark(label, draw(arrays(np.float64, 2, elements=spots)), draw(st.floats(0.0, 1.0)), draw(covariances(2)))
        for label in labels
    )
    starts = draw(arrays(np.float64, (draw(st.integers(0, 3)), 2), elements=spots))
    lines = np.stack([starts, starts + np.array([1.5, 0.25])], axis=1)
    circles = draw(arrays(np.float64, (draw(st.integers(0, 2)), 3), elements=st.floats(0.5, 3.0)))
    return FieldMap(draw(st.text(max_size=8)), lines, circles, marks, draw(st.floats(0.01, 0.2)))


_FEET = st.tuples(vectors(2), covariances(2)) | st.just((None, None))
_POSTS = st.builds(
    lambda edges, covariance, foot, label: PostObservation(edges, covariance, foot[0], foot[1], label),
    vectors(2, 2),
    covariances(4),
    _FEET,
    LABELS,
)
_LINES = st.builds(LineObservation, vectors(2, 2), covariances(4))
_MOUNTS = st.builds(CameraMount, POSITIVE, FINITE, FINITE, FINITE, covariances(4), FINITE, FINITE)
_CAMERAS = st.builds(
    Camera,
    st.sampled_from(["pinhole", "fisheye"]),
    st.integers(1, 9999),
    st.integers(1, 9999),
    POSITIVE,
    POSITIVE,
    FINITE,
    FINITE,
    st.just(()) | st.tuples(*[st.floats(-0.5, 0.5)] * 4),
)
_HYPOTHESES = st.builds(Hypothesis, st.floats(0.0, 0.2), vectors(3), covariances(3), st.integers(0, 2**53))
BY_KIND = {
    Odometry: st.builds(Odometry, STAMPS, vectors(3), st.none() | covariances(3)),
    Camera: _CAMERAS,
    ImageFeatures: st.builds(
        ImageFeatures,
        STAMPS,
        _MOUNTS,
        st.lists(_POSTS, max_size=2).map(tuple),
        st.lists(_LINES, max_size=2).map(tuple),
    ),
    LandmarkScan: scans(),
    Compass: st.builds(Compass, STAMPS, FINITE, POSITIVE),
    Truth: st.builds(Truth, STAMPS, vectors(3)),
    Estimate: st.builds(Estimate, STAMPS, vectors(3), covariances(3)),
    InitialPose: st.builds(InitialPose, STAMPS, vectors(3), covariances(3)),
    Ambiguity: st.builds(
        Ambiguity, STAMPS, st.lists(_HYPOTHESES, max_size=3).map(tuple), st.floats(0.0, 1.0), st.floats(0.0, 0.4)
    ),
    Event: st.builds(Event, STAMPS, st.sampled_from(get_args(EventKind)), st.text(max_size=8)),
    FieldMap: maps(),
}


def same(a, b):
    """Equal bit by bit: also the sign of zero."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()
    if is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a) if f.compare)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and repr(a) == repr(b)
