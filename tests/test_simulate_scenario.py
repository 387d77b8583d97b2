import dataclasses
import json
from pathlib import Path

import pytest

from fieldloc.errors import FieldlocError
from fieldloc.field import load_field
from logs.simulate import SCENARIOS, Scenario, load_scenario, with_settings
from logs.simulate.settings import (
    CompassSettings,
    FallSettings,
    OdometrySettings,
    StartSettings,
    WalkSettings,
)
from logs.simulate.vision_settings import ideal_vision


def _file(folder: Path, text: str) -> str:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def _refusal(folder: Path, text: str) -> str:
    with pytest.raises(FieldlocError) as caught:
        load_scenario(_file(folder, text))
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{folder / 'own.toml'}: ")
    return message


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_named_scenario_loads_and_says_what_it_is(name: str) -> None:
    scenario = load_scenario(name)
    assert len(scenario.about) > 20
    assert load_field(scenario.field).name == scenario.field


def test_the_names_are_those_of_the_files() -> None:
    folder = Path(__file__).parents[1] / "logs" / "simulate" / "scenarios"
    assert sorted(path.stem for path in folder.glob("*.toml")) == sorted(SCENARIOS)


def test_an_empty_file_is_the_defaults(tmp_path: Path) -> None:
    assert load_scenario(_file(tmp_path, "")) == Scenario()


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    text = 'field = "spl"\ntruth_hz = 50\n[falls]\nat_s = [10, 20.5]\n[odometry]\nheading = "steps"\nrate_hz = 100'
    expected = Scenario(
        field="spl",
        truth_hz=50,
        falls=FallSettings(at_s=(10.0, 20.5)),
        odometry=OdometrySettings(heading="steps", rate_hz=100.0),
    )
    loaded = load_scenario(_file(tmp_path, text))
    assert loaded == expected
    assert type(loaded.odometry.rate_hz) is float


def test_a_file_may_begin_from_a_named_scenario(tmp_path: Path) -> None:
    quiet = load_scenario("quiet")
    own = load_scenario(_file(tmp_path, 'base = "quiet"\n[odometry]\nslip_share = 0.5'))
    assert own == dataclasses.replace(quiet, odometry=dataclasses.replace(quiet.odometry, slip_share=0.5))


def test_a_map_is_found_beside_the_scenario_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "garden.toml").write_text("lines = [[[0, 0], [4, 0]], [[0, 3], [4, 3]]]", encoding="utf-8")
    assert load_field(load_scenario(_file(tmp_path, 'field = "garden.toml"')).field).name == "garden"


def test_the_ideal_scenario_has_an_ideal_camera() -> None:
    assert load_scenario("ideal").vision == ideal_vision()


def test_single_settings_are_spelled_as_in_a_file_and_the_last_one_wins() -> None:
    changed = with_settings(
        Scenario(),
        ["odometry.rate_hz=20", 'odometry.fallen = "silent"', "odometry.rate_hz=30", "vision.posts.people=0"],
    )
    assert changed.odometry == OdometrySettings(rate_hz=30.0, fallen="silent")
    assert changed.vision.posts.people == 0
    for wrong in ("odometry.rate_hz", "odometry.rate_hz=", "=3", "odometry.rate_hz=fast", "odometry.rate=3"):
        with pytest.raises(FieldlocError, match=f"^--set {wrong}"):
            with_settings(Scenario(), [wrong])


def test_the_json_in_a_log_tells_every_setting() -> None:
    scenario = load_scenario("crowded")
    told = json.loads(scenario.to_json())
    assert told["odometry"]["bump_m"] == scenario.odometry.bump_m
    assert told["vision"]["camera"]["width_px"] == scenario.vision.camera.width_px
    assert set(told) == {item.name for item in dataclasses.fields(Scenario)}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("tempo = 3", "tempo: unknown key; known here are about, field, duration_s"),
        ("[walk]\nhop_m = 1", "walk.hop_m: unknown key; known here are forward_mps"),
        ("[vision.camera]\nzoom = 2", "vision.camera.zoom: unknown key"),
        ("walk = 3", "walk: needs a table [walk]"),
        ('duration_s = "long"', "duration_s: needs a number, got 'long'"),
        ("duration_s = true", "duration_s: needs a number, got True"),
        ("duration_s = 0", "duration_s: needs seconds from 0.1 to 21600, got 0.0"),
        ("duration_s = nan", "duration_s: needs seconds"),
        ("truth_hz = 33", "truth_hz: needs a divisor of 100, got 33"),
        ("truth_hz = 50.0", "truth_hz: needs a whole number"),
        ("field = 3", "field: needs text, got 3"),
        ("[start]\ntold = 1", "start.told: needs true or false, got 1"),
        ("[start]\npose = [1, 2]", "start.pose: needs [x_m, y_m, heading_rad]"),
        ("[start]\npose = 1", "start.pose: needs a list of numbers, got 1"),
        ('[start]\npose = [1, 2, "north"]', "start.pose: needs a number, got 'north'"),
        ("[start]\nsigma_m = 0", "start.sigma_m and sigma_rad: need to be above 0"),
        ("[falls]\nlying_s = [3, 1]", "falls.lying_s: needs two numbers, the lower one first"),
        ("[falls]\nlying_s = [1]", "falls.lying_s: needs two numbers"),
        ("[falls]\nper_min = -1", "falls.per_min: needs to be at least 0, got -1.0"),
        ("[falls]\nat_s = [5, -5]", "falls.at_s: needs to be at least 0"),
        ("[walk]\nforward_mps = 0", "walk.forward_mps: needs to be at least 0.01, got 0.0"),
        ("[walk]\nforward_mps = inf", "walk.forward_mps: needs finite numbers, got inf"),
        (f"[walk]\nforward_mps = {10**400}", "walk.forward_mps: is too large for a number"),
        ('[odometry]\nheading = "stars"', "odometry.heading: needs one of gyro, steps, got 'stars'"),
        ('[odometry]\nfallen = "crying"', "odometry.fallen: needs one of silent, still, walking, got 'crying'"),
        ("[odometry]\nrate_hz = 0", "odometry.rate_hz: needs to be at least 0.1, got 0.0"),
        ("[odometry]\ndrop_share = 1", "odometry.drop_share: needs a share below 1"),
        ("[compass]\nrate_hz = 1e9", "compass.rate_hz: needs to be at most 1000, got 1000000000.0"),
        ("[others]\ncount = -1", "others.count: needs to be at least 0, got -1"),
        ("[others]\ncount = 101", "others.count: needs to be at most 100, got 101"),
        ("[falls]\nper_min = 1e5", "falls.per_min: needs to be at most 1000"),
        ("[falls]\nget_up_s = [1, 1e5]", "falls.get_up_s: needs to be at most 3600"),
        ("[others]\nspeed_mps = 1e6", "others.speed_mps: needs to be at most 10, got 1000000.0"),
        ("[odometry]\nbump_m = 1e300", "odometry.bump_m: needs to be at most 100"),
        ("[compass]\ndeclination_rad = [-1e300, 0]", "compass.declination_rad: needs to be at most 1000"),
        ("[vision.camera]\nwidth_px = 0", "vision.camera.width_px"),
        ('base = "chess"', "base: needs the name of another scenario (kidsize-game, "),
        ("base = 3", "base: needs the name of another scenario"),
        ("walk = [", "not valid TOML"),
        pytest.param("walk = " + "[" * 100_000, "not valid TOML", id="brackets"),
        pytest.param("duration_s = " + "9" * 5000, "not valid TOML", id="digits"),
    ],
)
def test_a_mistake_is_one_line_with_file_key_and_need(tmp_path: Path, text: str, says: str) -> None:
    assert says in _refusal(tmp_path, text)


def test_what_is_no_scenario_is_told_with_the_names(tmp_path: Path) -> None:
    with pytest.raises(FieldlocError, match="chess: no such scenario; give one of kidsize-game, spl-game"):
        load_scenario("chess")
    with pytest.raises(FieldlocError, match="cannot be read as a scenario"):
        load_scenario(str(tmp_path))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FieldlocError, match="cannot be read as a scenario"):
        load_scenario(str(tmp_path / "binary.toml"))


def test_settings_that_nothing_can_mean_are_refused_in_python_too() -> None:
    for make in (
        lambda: WalkSettings(forward_mps=float("nan")),
        lambda: CompassSettings(hard_iron=(0.2, 0.1)),
        lambda: StartSettings(pose=(1.0,)),
        lambda: Scenario(duration_s=1e9),
    ):
        with pytest.raises(ValueError):
            make()
    assert CompassSettings(declination_rad=(-0.2, -0.1)).declination_rad == (-0.2, -0.1)
    assert StartSettings(pose=(-1.0, -2.0, -3.0)).pose == (-1.0, -2.0, -3.0)
