from math import radians

import numpy as np
import pytest

from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from logs.foreign.mapping import load_mapping, with_roles
from logs.foreign.settings import LogMapping

WHOLE = """
camera = "eye.toml"
rectified = true
[roles]
odometry = "/odom"
image_features = ["/posts", "/lines"]
truth = []
[frames]
field = "world"
odom = "odom_combined"
robot = "torso"
camera = "eye"
robot_height_m = -0.1
max_age_s = 0.5
field_from_map = {x_m = 4.5, y_m = -3.0, heading_deg = -90.0}
[mount]
x_m = -0.02
y_m = 0.01
height_m = 0.6
pan_deg = -5.0
tilt_deg = 20
roll_deg = -1.5
height_sigma_m = 0.02
pan_sigma_deg = 2.0
tilt_sigma_deg = 3.0
roll_sigma_deg = 4.0
[detections]
edge_sigma_px = 1.0
foot_sigma_px = 2.0
line_sigma_px = 5.0
range_sigma_m = 0.1
range_sigma_relative = 0.0
bearing_sigma_deg = 3.0
min_confidence = 0.5
[odometry]
max_speed_mps = 2.0
max_turn_degps = 360.0
use_covariance = false
[compass]
north_deg = -120.0
imu_heading_deg = 30
sigma_deg = 5.0
[initial_pose]
sigma_m = 0.1
heading_sigma_deg = 2.0
"""
EYE = 'model = "pinhole"\nwidth_px = 640\nheight_px = 480\nfx_px = 500\nfy_px = 500\ncx_px = 319.5\ncy_px = 239.5\n'


def load(tmp_path, text):
    (tmp_path / "eye.toml").write_text(EYE)
    (tmp_path / "team.toml").write_text(text)
    return load_mapping(tmp_path / "team.toml")


def test_a_mapping_says_all_of_it(tmp_path):
    mapping = load(tmp_path, WHOLE)
    assert dict(mapping.roles) == {"odometry": ("/odom",), "image_features": ("/posts", "/lines"), "truth": ()}
    assert mapping.told == frozenset()
    assert mapping.camera == Camera("pinhole", 640, 480, 500, 500, 319.5, 239.5)
    assert mapping.rectified is True
    frames = mapping.frames
    assert (frames.field, frames.odom, frames.robot, frames.camera) == ("world", "odom_combined", "torso", "eye")
    assert (frames.robot_height_m, frames.max_age_s) == (-0.1, 0.5)
    assert frames.field_from_map == pytest.approx((4.5, -3.0, -np.pi / 2))
    mount = mapping.mount.fixed
    assert (mount.x_m, mount.y_m, mount.height_m) == (-0.02, 0.01, 0.6)
    assert (mount.pan_rad, mount.tilt_rad, mount.roll_rad) == pytest.approx(tuple(np.radians([-5.0, 20.0, -1.5])))
    sigmas = [0.02, *np.radians([2.0, 3.0, 4.0])]
    assert np.sqrt(np.diag(mount.covariance)) == pytest.approx(sigmas)
    assert mount.covariance == pytest.approx(mapping.mount.covariance)
    noise = mapping.detections
    assert (noise.edge_sigma_px, noise.foot_sigma_px, noise.line_sigma_px, noise.min_confidence) == (1.0, 2.0, 5.0, 0.5)
    assert (noise.range_sigma_m, noise.range_sigma_relative, noise.bearing_sigma_rad) == (0.1, 0.0, radians(3.0))
    odometry, compass, start = mapping.odometry, mapping.compass, mapping.initial_pose
    assert (odometry.max_speed_mps, odometry.max_turn_radps, odometry.use_covariance) == (2.0, radians(360.0), False)
    assert compass.north_rad == pytest.approx(radians(-120.0))
    assert (compass.imu_heading_rad, compass.sigma_rad) == (radians(30.0), radians(5.0))
    assert (start.sigma_m, start.heading_sigma_rad) == (0.1, radians(2.0))


def test_what_is_not_said_has_its_default(tmp_path):
    assert load(tmp_path, "") == LogMapping()
    sections = "[roles]\n[frames]\n[mount]\n[detections]\n[odometry]\n[compass]\n[initial_pose]\n"
    assert load(tmp_path, sections) == LogMapping()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[roles]\nwheels = '/odom'", "roles.wheels: unknown key; known here are camera, compass"),
        ("[roles]\nodometry = 3", r"roles.odometry: needs a topic in quotes or a list of topics, got 3"),
        ("[roles]\nodometry = ''", "roles.odometry: needs a topic"),
        ("[roles]\nodometry = ['/a', '/b']", "roles.odometry: is played by one topic, got 2"),
        ("[frames]\nrobot = 3", "frames.robot: needs a name in quotes"),
        ("[frames]\nfield_from_map = [1, 2, 3]", r"frames.field_from_map: needs a table \[frames.field_from_map\]"),
        ("[frames]\nfield_from_map = {x = 1}", "frames.field_from_map.x: unknown key"),
        ("[frames]\nfield_from_map = {x_m = true}", "frames.field_from_map.x_m: needs a number, got True"),
        ("[frames]\nrobot_height_m = nan", "frames.robot_height_m: needs a number, got nan"),
        ("[mount]\ntilt_deg = 20", r"mount.tilt_deg: says where the camera is, which takes height_m too"),
        ("[mount]\nheight_m = -1", "mount.height_m: needs a number above 0"),
        ("[mount]\ntilt_sigma_deg = 0", "mount.tilt_sigma_deg: needs a number above 0"),
        ("[compass]\nnorth_deg = 'east'", "compass.north_deg: needs a number, got 'east'"),
        ("[odometry]\nuse_covariance = 1", "odometry.use_covariance: needs true or false, got 1"),
        ("[noise]\nx = 1", "noise: unknown key; known here are camera, compass, detections"),
        ("camera = 'none.toml'", "none.toml: no such camera file"),
        ("camera = ", "not valid TOML"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_file_and_the_key(tmp_path, text, complaint):
    with pytest.raises(FieldlocError, match=complaint) as error:
        load(tmp_path, text)
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_mapping_that_is_not_there_is_one_line_too(tmp_path):
    with pytest.raises(FieldlocError, match="no such mapping file; give the path of a TOML file"):
        load_mapping(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"\xe4")
    for path in (tmp_path, tmp_path / "latin.toml"):
        with pytest.raises(FieldlocError, match="cannot be read as a mapping"):
            load_mapping(path)


def test_roles_on_the_command_line_come_before_those_of_the_file():
    mapping = LogMapping(roles={"odometry": ("/a",), "truth": ("/t",)})
    told = with_roles(mapping, ["odometry=/b", "image_features=/posts", "image_features=/lines", "compass="])
    assert dict(told.roles) == {
        "odometry": ("/b",),
        "truth": ("/t",),
        "image_features": ("/posts", "/lines"),
        "compass": (),
    }
    assert told.told == {"odometry", "image_features", "compass"}
    assert with_roles(mapping, []) == mapping


@pytest.mark.parametrize(
    ("setting", "complaint"),
    [
        ("odometry", "--role odometry: needs ROLE=TOPIC, for example odometry=/odom"),
        ("wheels=/odom", "--role wheels=/odom: no role 'wheels'; there is odometry, camera, image_features"),
        ("odometry=/b", "--role odometry=/b: odometry is played by one topic, not by /a and /b"),
    ],
)
def test_a_role_that_is_none_is_one_line(setting, complaint):
    with pytest.raises(FieldlocError, match=complaint):
        with_roles(LogMapping(), ["odometry=/a", setting])
