from dataclasses import fields
from pathlib import Path

import pytest

from estimators import config_file
from estimators.config import Config, Graph, MotionNoise, Particles, Robust
from estimators.config_file import load_config, with_settings
from fieldloc.errors import FieldlocError

EVERYTHING = """
[motion]
forward_m_per_sqrt_m = 0.1
max_hold_s = 1
[robust]
restart_after = 6
[particles]
count = 500
outlier_share = 0.1
[graph]
cauchy = 3
node_interval_s = 0
"""

# setting, what its message must name
WRONG = [
    ("particles.cuont=3", "particles.cuont"),
    ("particle.count=3", "particle"),
    ("particles.count=2.5", "particles.count"),
    ("particles.count=0", "particles.count"),
    ("particles.count=-1", "particles.count"),
    ("particles.count=nan", "particles.count"),
    ("particles.count=true", "particles.count"),
    ("particles.count='many'", "particles.count"),
    ("particles.count=[3]", "particles.count"),
    ("particles.outlier_share=1", "particles.outlier_share"),
    ("particles.seed=-1", "particles.seed"),
    ("robust.nis_per_dof=0", "robust.nis_per_dof"),
    ("robust.restart_after=0", "robust.restart_after"),
    ("graph.cauchy=0", "graph.cauchy"),
    ("graph.cauchy=-2", "graph.cauchy"),
    ("motion.max_hold_s=-1", "motion.max_hold_s"),
    ("motion.forward_m_per_sqrt_m=inf", "motion.forward_m_per_sqrt_m"),
    ("a.b.c=1", "a"),
]


def test_an_empty_file_and_no_settings_leave_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "empty.toml"
    path.write_text("")
    assert load_config(path) == Config()
    assert with_settings(Config(), []) == Config()
    path.write_text("[particles]\n")
    assert load_config(path) == Config()


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(EVERYTHING)
    assert load_config(path) == Config(
        motion=MotionNoise(forward_m_per_sqrt_m=0.1, max_hold_s=1.0),
        robust=Robust(restart_after=6),
        particles=Particles(count=500, outlier_share=0.1),
        graph=Graph(cauchy=3.0, node_interval_s=0.0),
    )


def test_settings_change_a_configuration_and_the_last_one_wins() -> None:
    base = Config(particles=Particles(seed=5))
    changed = with_settings(base, ["particles.count=10", "graph.cauchy=7", "particles.count=20"])
    assert changed == Config(particles=Particles(count=20, seed=5), graph=Graph(cauchy=7.0))


def test_whole_numbers_stay_whole_and_the_others_fractions() -> None:
    changed = with_settings(Config(), ["particles.count=2e3", "robust.restart_after=3.0", "graph.cauchy=2"])
    for section in fields(Config):
        for item in fields(getattr(Config(), section.name)):
            default = getattr(getattr(Config(), section.name), item.name)
            assert type(getattr(getattr(changed, section.name), item.name)) is type(default)
    assert changed.particles.count == 2000
    assert changed.robust.restart_after == 3


@pytest.mark.parametrize(("setting", "key"), WRONG)
def test_a_wrong_setting_is_named_with_its_key(setting: str, key: str) -> None:
    with pytest.raises(FieldlocError) as caught:
        with_settings(Config(), [setting])
    assert str(caught.value).startswith(f"--set {setting}: {key}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("setting", ["", "count=3", "particles=3", "particles.count", "particles.count=", ".count=3"])
def test_a_setting_of_another_form_shows_the_right_one(setting: str) -> None:
    with pytest.raises(
        FieldlocError, match=r"^--set .*: needs SECTION\.NAME=NUMBER, for example particles\.count=2000$"
    ):
        with_settings(Config(), [setting])


@pytest.mark.parametrize("setting", ["particles.count=[", "particles.count=three", "par ticles.count=3"])
def test_a_setting_that_is_no_toml_says_so(setting: str) -> None:
    with pytest.raises(FieldlocError) as caught:
        with_settings(Config(), [setting])
    assert str(caught.value).startswith(f"--set {setting}: not valid TOML: ")


@pytest.mark.parametrize(("setting", "key"), WRONG)
def test_a_wrong_line_in_a_file_is_named_with_file_and_key(setting: str, key: str, tmp_path: Path) -> None:
    name, value = setting.split("=")
    path = tmp_path / "wrong.toml"
    path.write_text(f"{name} = {value}\n")
    with pytest.raises(FieldlocError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: {key}: ")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"[particles\n", "not valid TOML"),
        (b"particles = 3\n", r"particles: needs a table \[particles\], got 3"),
        (b"\xff\xfe", "cannot be read as a configuration"),
        (b"[particles]\ncount = 3\ncount = 4\n", "not valid TOML"),
    ],
)
def test_a_file_that_is_no_configuration_is_named(content: bytes, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_bytes(content)
    with pytest.raises(FieldlocError, match=problem) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_file_that_is_missing_or_a_directory_is_named(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.toml", tmp_path):
        with pytest.raises(FieldlocError, match="cannot be read as a configuration") as caught:
            load_config(path)
        assert str(caught.value).startswith(f"{path}: ")


def test_every_limit_is_that_of_a_setting_which_exists() -> None:
    names = {item.name for section in fields(Config) for item in fields(getattr(Config(), section.name))}
    assert {*config_file._ABOVE_ZERO, *config_file._BELOW_ONE} <= names
