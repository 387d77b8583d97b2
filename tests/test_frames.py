import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from logs.foreign import frames as frames_module
from logs.foreign.frames import Frames
from logs.foreign.parts import Transform
from logs.foreign.rotations import between, compose, heading, inverse, matrix, motion, on_the_ground, rotate

SECOND = 1_000_000_000
UNTURNED = np.array([0.0, 0.0, 0.0, 1.0])
quaternions = arrays(np.float64, 4, elements=st.floats(-1.0, 1.0)).filter(lambda q: np.linalg.norm(q) > 0.1)
vectors = arrays(np.float64, 3, elements=st.floats(-10.0, 10.0))


def tf(parent, child, x=0.0, stamp_s=0.0, rotation=UNTURNED):
    return Transform(round(stamp_s * SECOND), parent, child, np.array([x, 0.0, 0.0]), np.asarray(rotation))


def moving(samples, **options):
    """One edge base -> head whose x is given by second."""
    frames = Frames(**options)
    for second, x in samples:
        frames.add([tf("base", "head", x, second)], 0)
    return frames


def x_at(frames, second, a="base", b="head"):
    found = frames.lookup(a, b, round(second * SECOND))
    return None if found is None else pytest.approx(found[1][0])


# Rotations


@given(quaternions, vectors, quaternions, vectors)
def test_motions_compose_and_invert_as_matrices_do(q, t, p, s):
    a, b = motion(t, q), motion(s, p)
    assert matrix(a.rotation) == pytest.approx(Rotation.from_quat(q).as_matrix(), abs=1e-12)
    assert rotate(a.rotation, tuple(s)) == pytest.approx(Rotation.from_quat(q).apply(s), abs=1e-11)
    both = compose(a, b)
    assert both.translation == pytest.approx(Rotation.from_quat(q).apply(s) + t, abs=1e-11)
    assert matrix(both.rotation) == pytest.approx(matrix(a.rotation) @ matrix(b.rotation), abs=1e-12)
    nothing = compose(inverse(a), a)
    assert nothing.translation == pytest.approx((0.0, 0.0, 0.0), abs=1e-11)
    assert matrix(nothing.rotation) == pytest.approx(np.eye(3), abs=1e-12)


@given(quaternions, quaternions, st.floats(0.0, 1.0))
def test_rotations_in_between_turn_at_a_constant_rate_the_shorter_way(q, p, share):
    turn = (Rotation.from_quat(q).inv() * Rotation.from_quat(p)).magnitude()
    if turn < 3.1:  # half a turn has no shorter way
        expected = Slerp([0.0, 1.0], Rotation.from_quat([q, p]))(share).as_matrix()
        found = between(motion(np.zeros(3), q), motion(np.zeros(3), p), share)
        # a chord instead of the arc, below 3.6 degrees, is off by less than 1e-5
        assert matrix(found.rotation) == pytest.approx(expected, abs=2e-5)


@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2), st.floats(-3.1, 3.1))
def test_the_heading_is_that_of_the_forward_axis_seen_from_above(yaw, pitch, roll):
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    found = motion(np.array([1.0, 2.0, 3.0]), rotation.as_quat())
    assert heading(found.rotation) == pytest.approx(yaw, abs=1e-9)
    assert on_the_ground(found) == pytest.approx([1.0, 2.0, yaw], abs=1e-9)


@pytest.mark.parametrize("rotation", [np.zeros(4), np.full(4, np.nan), [np.inf, 0, 0, 0]])
def test_a_quaternion_that_is_none_makes_no_motion(rotation):
    assert motion(np.zeros(3), np.asarray(rotation, dtype=float)) is None
    assert motion(np.array([0.0, np.nan, 0.0]), UNTURNED) is None


# The tree


@given(st.data())
def test_a_lookup_is_the_product_of_the_transforms_on_the_way(data):
    names = ["a", "b", "c", "d", "e"]
    frames, in_root = Frames(), {"a": np.eye(4)}
    for i, child in enumerate(names[1:], start=1):
        parent = data.draw(st.sampled_from(names[:i]))
        q, t = data.draw(quaternions), data.draw(vectors)
        frames.add([Transform(7, parent, child, t, q)], 0)
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_quat(q).as_matrix(), t
        in_root[child] = in_root[parent] @ step
    a, b = data.draw(st.sampled_from(names)), data.draw(st.sampled_from(names))
    rotation, translation = frames.lookup(a, b, 7)
    expected = np.linalg.inv(in_root[a]) @ in_root[b]
    assert rotation == pytest.approx(expected[:3, :3], abs=1e-9)
    assert translation == pytest.approx(expected[:3, 3], abs=1e-9)


def test_frames_that_nothing_connects_have_no_transform():
    frames = Frames()
    frames.add([tf("map", "odom"), tf("base", "head")], 0)
    assert frames.lookup("map", "head", 0) is None
    assert frames.lookup("base", "nose", 0) is None
    assert not frames.are_connected("map", "head")
    assert frames.are_connected("head", "base")


def test_a_slash_in_front_of_a_frame_means_nothing():
    frames = Frames()
    frames.add([tf("/base", "head", 2.0)], 0)
    assert x_at(frames, 0.0, "base", "/head") == 2.0
    assert frames.names == ("base", "head")


# Time


def test_between_two_transforms_there_is_a_straight_way_and_a_steady_turn():
    frames = Frames()
    quarter = Rotation.from_euler("z", 90, degrees=True).as_quat()
    frames.add([tf("base", "head", 0.0, 1.0), tf("base", "head", 1.0, 1.4, quarter)], 0)
    rotation, translation = frames.lookup("base", "head", round(1.1 * SECOND))
    assert translation == pytest.approx([0.25, 0.0, 0.0])
    assert Rotation.from_matrix(rotation).as_euler("xyz", degrees=True) == pytest.approx([0.0, 0.0, 22.5])


def test_a_moving_frame_is_known_a_little_before_and_after_its_transforms_and_not_longer():
    frames = moving([(1.0, 1.0), (1.1, 2.0)], max_age_s=0.25)
    assert x_at(frames, 0.80) == 1.0
    assert x_at(frames, 0.70) is None
    assert x_at(frames, 1.30) == 2.0
    assert x_at(frames, 1.40) is None


def test_a_gap_is_bridged_only_as_far_as_a_transform_is_near():
    frames = moving([(1.0, 0.0), (2.0, 10.0)], max_age_s=0.25)
    assert x_at(frames, 1.2) == 2.0
    assert x_at(frames, 1.9) == 9.0
    assert x_at(frames, 1.5) is None


def test_a_gap_in_which_nothing_moved_is_no_gap():
    frames = moving([(1.0, 5.0), (2.0, 5.0), (2.1, 6.0)])
    assert x_at(frames, 1.5) == 5.0
    assert x_at(frames, 2.05) == 5.5


def test_static_transforms_and_those_that_never_change_hold_for_all_times():
    frames = moving([(5.0, 3.0), (6.0, 3.0)])
    assert x_at(frames, 1.0) == x_at(frames, 100.0) == 3.0
    frames.add([tf("head", "camera", 1.0, 5.0)], 0, static=True)
    frames.add([tf("head", "camera", 2.0, 9.0)], 0, static=True)  # corrected: the last one counts
    assert x_at(frames, 0.0, "base", "camera") == 5.0


def test_what_does_not_move_takes_no_memory():
    frames = moving([(0.01 * i, 1.0) for i in range(5000)])
    assert len(frames) == 2
    frames = moving([(0.01 * i, float(i >= 2500)) for i in range(5000)])
    assert len(frames) == 4
    assert x_at(frames, 24.0) == 0.0
    assert x_at(frames, 24.995) == 0.5
    assert x_at(frames, 49.99) == 1.0


def test_transforms_may_come_in_any_order():
    order = np.random.default_rng(1).permutation(50)
    frames = moving([(0.1 * i, float(i)) for i in order.tolist()])
    assert [x_at(frames, 0.1 * i + 0.05) for i in range(49)] == [i + 0.5 for i in range(49)]


def test_a_stamp_of_zero_is_the_beginning_and_then_the_log_time():
    frames = Frames()
    frames.add([tf("base", "head", 1.0)], 5 * SECOND)
    assert x_at(frames, 3.0) == 1.0
    frames.add([tf("base", "head", 2.0)], 6 * SECOND)
    frames.add([tf("base", "head", 3.0)], round(6.2 * SECOND))
    assert x_at(frames, 6.1) == 2.5


# What is wrong with it


def test_transforms_that_are_none_are_left_out_and_counted():
    frames = Frames()
    frames.add(
        [tf("a", "b", np.nan), tf("a", "b", rotation=np.zeros(4)), tf("a", "a"), tf("", "b"), tf("a", "b", 4.0)], 0
    )
    assert x_at(frames, 0.0, "a", "b") == 4.0
    assert frames.warnings == (
        "2 transforms left out: those with NaN or a rotation of length zero",
        "2 transforms left out: those whose frames are no two",
    )


def test_loops_and_two_parents_are_survived_and_two_parents_are_said():
    frames = Frames()
    frames.add([tf("a", "b", 1.0), tf("b", "c", 1.0), tf("c", "a", 1.0)], 0)
    assert x_at(frames, 0.0, "a", "b") == 1.0
    frames.add([tf("x", "b", 7.0), tf("b", "a", 9.0)], 0)
    assert x_at(frames, 0.0, "x", "b") == 7.0
    assert "frame b has 2 parents: a, x" in frames.warnings


def test_of_very_many_transforms_only_those_on_a_way_that_is_asked_for_are_kept(monkeypatch):
    monkeypatch.setattr(frames_module, "_MAX_SAMPLES", 1000)
    frames = Frames(wanted=lambda frame: frame in ("base", "camera"))
    frames.add([tf("head", "camera", 0.5)], 0, static=True)
    for i in range(3000):
        finger = [tf("base", f"finger{k}", i * 0.001, 0.01 * i + 1.0) for k in range(5)]
        frames.add([*finger, tf("base", "head", 0.001 * i, 0.01 * i + 1.0)], 0)
    assert len(frames) < 5000
    assert x_at(frames, 21.0, "base", "camera") == 2.5
    assert frames.lookup("base", "finger1", 21 * SECOND) is None
