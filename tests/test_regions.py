"""Regions to start in: their places, their densities, and drawing from them."""

import numpy as np
import pytest

from fieldloc import pose as se2
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.pose import FloatArray
from fieldloc.regions import REGIONS, Region, anywhere, draw, region
from logs.simulate.events import touch_line_pose

FIELD = load_field("kidsize")
TREES = FieldMap("trees", np.zeros((0, 2, 2)), np.zeros((0, 3)), (Landmark("1", np.ones(2), 0.2, np.zeros((2, 2))),))
every = pytest.mark.parametrize("name", REGIONS)


def pose(x_m: float, y_m: float, heading_deg: float) -> FloatArray:
    return np.array([x_m, y_m, np.radians(heading_deg)])


def inside(where: Region, poses: FloatArray) -> bool:
    """As likely as anywhere within."""
    return bool((where.log_density(poses) > -where.log_volume - 1e-9).all())


def grid(where: Region) -> tuple[FloatArray, float]:
    """Poses in the middles of cells around the region, and the cells' volume."""
    low, high = where.boxes[:, :2].min(axis=0) - 2.0, where.boxes[:, 2:].max(axis=0) + 2.0
    sizes = np.array([0.1, 0.1, np.pi / 36])
    x, y = (np.arange(a + 0.5 * s, b, s) for a, b, s in zip(low, high, sizes, strict=False))
    headings = np.arange(-np.pi + 0.5 * sizes[2], np.pi, sizes[2])
    return np.stack(np.meshgrid(x, y, headings), axis=-1).reshape(-1, 3), float(sizes.prod())


@every
def test_all_draws_are_inside_and_fill_it(name: str) -> None:
    where = region(name, FIELD)
    poses = draw(where, 20_000, np.random.default_rng(1))
    assert poses.shape == (20_000, 3)
    assert where.name == name
    assert inside(where, poses)
    # even: shares of the boxes as their volumes, the middle of each in its middle, up to five sampling errors
    volume = np.prod(where.boxes[:, 2:] - where.boxes[:, :2], axis=1) * where.headings[:, 1]
    for box, (heading, half), share in zip(where.boxes, where.headings, volume / volume.sum(), strict=True):
        own = poses[(poses[:, :2] >= box[:2]).all(axis=1) & (poses[:, :2] <= box[2:]).all(axis=1)]
        assert len(own) / 20_000 == pytest.approx(share, abs=5 * 0.5 / 20_000**0.5)
        spread = 0.29 * np.array([*(box[2:] - box[:2]), 2 * half]) / len(own) ** 0.5
        middle = np.append(0.5 * (box[:2] + box[2:]), heading)
        assert (
            np.abs(np.append(own[:, :2], se2.wrap(own[:, 2:] - heading) + heading, axis=1).mean(axis=0) - middle)
            < 5 * spread
        ).all()


@every
def test_its_density_is_one_over_its_volume_and_little_is_beyond_its_edges(name: str) -> None:
    where = region(name, FIELD)
    poses, cell = grid(where)
    density = np.exp(where.log_density(poses))
    within = where.log_density(poses) > -where.log_volume - 1e-9
    assert density[within].sum() * cell == pytest.approx(1.0, abs=0.05)
    assert density[within].max() == pytest.approx(np.exp(-where.log_volume))
    off = np.array([[30.0, 0.0, 0.0]])
    assert where.log_density(off)[0] < -1000.0


@every
def test_it_knows_how_the_field_repeats(name: str) -> None:
    np.testing.assert_array_equal(region(name, FIELD).symmetries, FIELD.symmetries)


def test_halves_are_each_others_half_turn() -> None:
    own, opponent = region("own-half", FIELD), region("opponent-half", FIELD)
    poses = draw(own, 1000, np.random.default_rng(2))
    assert poses[:, 0].max() <= 0.0
    assert inside(opponent, se2.compose(FIELD.symmetries[0], poses))
    assert own.log_density(se2.compose(FIELD.symmetries[0], pose(-2.0, 1.0, 30.0))) < -20.0
    assert inside(own, np.array([pose(-0.1, 0.0, 170.0), pose(-5.0, 3.5, -90.0)]))
    assert np.logaddexp(own.log_volume, opponent.log_volume) == pytest.approx(anywhere(FIELD).log_volume)


def test_robots_enter_from_the_own_touch_lines() -> None:
    own, both = region("own-touch-line", FIELD), region("touch-line", FIELD)
    starts = np.array([touch_line_pose(FIELD.bounds, np.random.default_rng(seed)) for seed in range(50)])
    assert {-1.0, 1.0} == set(np.sign(starts[:, 1]))
    assert inside(own, starts)
    assert inside(both, starts)
    mirrored = se2.compose(FIELD.symmetries[0], starts)
    assert inside(both, mirrored)
    # told apart but for those that stand close to the half way line
    assert (own.log_density(mirrored[mirrored[:, 0] > 1.0]) < own.log_density(starts).min() - 5.0).all()
    # looking out of the field
    assert own.log_density(pose(-2.0, 3.0, 90.0)) < own.log_density(pose(-2.0, 3.0, -90.0)) - 10.0


def test_what_is_not_known_is_refused_with_the_choices() -> None:
    with pytest.raises(FieldlocError, match=r"region our-half: not known; give one of anywhere, own-half, opponent"):
        region("our-half", FIELD)


@pytest.mark.parametrize("name", [name for name in REGIONS if name != "anywhere"])
def test_a_map_without_lines_has_no_halves(name: str) -> None:
    with pytest.raises(FieldlocError, match=f"region {name}: the map trees has no lines.*or anywhere"):
        region(name, TREES)
    assert inside(region("anywhere", TREES), np.array([[1.5, 0.5, 3.0]]))
