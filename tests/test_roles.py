import pytest

from logs.foreign.roles import guess_roles
from logs.foreign.settings import CompassSettings, LogMapping, MountSettings
from logs.schema import BY_ROLE
from logs.source import Source

ODOMETRY, TWIST, STAMPED = "nav_msgs/msg/Odometry", "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
POSE, WITH_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
TF, INFO, IMAGE = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Image"
IMU, MAGNETIC = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
POSTS_2D, LINES_2D = "soccer_vision_2d_msgs/msg/GoalpostArray", "soccer_vision_2d_msgs/msg/MarkingArray"
POSTS_3D, LINES_3D = "soccer_vision_3d_msgs/msg/GoalpostArray", "soccer_vision_3d_msgs/msg/MarkingArray"


def ros(topic, name, count=10):
    return Source(topic, "cdr", name, "ros2msg", b"definition"), count


def foxglove(topic, name, count=10):
    return Source(topic, "protobuf", name, "protobuf", b""), count


def own(topic, role, count=10):
    return Source(topic, "json", BY_ROLE[role].name, "jsonschema", b"{}"), count


def guess(*channels, mapping=None, odometry_in_tf=False):
    return guess_roles(channels, mapping or LogMapping(), lambda topics: odometry_in_tf)


def player(role, *channels, **options):
    return guess(*channels, **options).topics.get(role, ())


def test_the_usual_topics_come_first_then_own_messages_then_those_of_others():
    usual, elsewhere = own("/odometry", "odometry", 1), own("/robot/wheels", "odometry", 5)
    other = ros("/odom", ODOMETRY, 100)
    assert player("odometry", other, elsewhere, usual) == ("/odometry",)
    assert player("odometry", other, elsewhere) == ("/robot/wheels",)
    assert player("odometry", other) == ("/odom",)
    assert guess(other, elsewhere, usual).candidates == {"/odom": "odometry", "/robot/wheels": "odometry"}
    assert player("odometry", other, own("/odometry", "odometry", 0)) == ("/odom",)


@pytest.mark.parametrize(
    ("channels", "topic"),
    [
        ([ros("/odom", ODOMETRY), ros("/cmd_vel", TWIST, 500)], "/odom"),
        ([ros("/motion", STAMPED), ros("/odom", ODOMETRY)], "/odom"),
        ([ros("/wheels", ODOMETRY, 100), ros("/odom", ODOMETRY)], "/odom"),
        ([ros("/odom", ODOMETRY), ros("/odometry/filtered", ODOMETRY, 50)], "/odometry/filtered"),
        ([ros("/b/odom", ODOMETRY), ros("/a/odom", ODOMETRY)], "/a/odom"),
        ([ros("/ground_truth/odom", ODOMETRY, 99), ros("/odom", ODOMETRY)], "/odom"),
        ([ros("/odometry/global", ODOMETRY, 99), ros("/odom", ODOMETRY)], "/odom"),
        ([ros("/fieldloc/odometry", ODOMETRY, 99), ros("/odom", ODOMETRY)], "/odom"),
        ([ros("/walk_velocity", STAMPED), ros("/cmd_vel", TWIST, 99)], "/walk_velocity"),
        ([ros("/cmd_vel", TWIST)], "/cmd_vel"),
        ([foxglove("/state", "foxglove.Odometry")], "/state"),
    ],
)
def test_of_several_odometries_the_likeliest_is_taken_in_whatever_order_they_stand(channels, topic):
    assert player("odometry", *channels) == player("odometry", *reversed(channels)) == (topic,)


def test_transforms_are_odometry_only_where_nothing_better_moves():
    tf, static = ros("/tf", TF, 100), ros("/tf_static", TF, 1)
    assert player("odometry", tf, static, odometry_in_tf=True) == ("/tf",)
    assert player("odometry", tf, static, odometry_in_tf=False) == ()
    assert player("odometry", tf, ros("/cmd_vel", TWIST), odometry_in_tf=True) == ("/tf",)
    assert player("odometry", tf, ros("/odom", ODOMETRY), odometry_in_tf=True) == ("/odom",)
    assert player("odometry", static, odometry_in_tf=True) == ()
    assert player("tf", static, tf, ros("/fieldloc/transforms", TF)) == ("/tf", "/tf_static")


@pytest.mark.parametrize(
    "topic",
    ["/ground_truth/pose", "/robot/groundtruth", "/mocap/robot", "/optitrack", "/vicon/nao/nao", "/gt", "/x/gt_pose"],
)
def test_poses_with_a_reference_system_in_their_name_are_the_truth(topic):
    assert player("truth", ros(topic, POSE)) == (topic,)
    assert player("estimate", ros(topic, POSE)) == ()


@pytest.mark.parametrize("topic", ["/goal_pose", "/ball_pose", "/target/pose", "/length", "/hand_pose"])
def test_poses_of_other_things_are_nobody_s(topic):
    roles = guess(ros(topic, POSE))
    assert roles.of(topic) == ()
    assert topic not in roles.candidates


def test_a_start_and_an_estimate_are_told_apart_by_name():
    channels = [ros("/initialpose", WITH_COVARIANCE), ros("/amcl_pose", WITH_COVARIANCE), ros("/pose", POSE, 99)]
    roles = guess(*channels)
    assert roles.topics["initial_pose"] == ("/initialpose",)
    assert roles.topics["estimate"] == ("/amcl_pose",)
    assert roles.candidates == {"/pose": "estimate"}


def test_the_main_camera_is_taken_before_depth_and_rectified_ones():
    depth, rect = ros("/camera/depth/camera_info", INFO, 500), ros("/camera/image_rect/camera_info", INFO, 300)
    main = ros("/camera/camera_info", INFO, 100)
    assert player("camera", depth, rect, main) == ("/camera/camera_info",)
    assert player("camera", depth) == ("/camera/depth/camera_info",)


PIXELS = [ros("/posts", POSTS_2D), ros("/lines", LINES_2D)]
METRES = [ros("/posts_relative", POSTS_3D), ros("/lines_relative", LINES_3D)]
PLACED = [ros("/tf", TF), ros("/camera_info", INFO)]


def test_what_is_seen_is_taken_once_in_pixels_before_in_metres():
    roles = guess(*PIXELS, *METRES, *PLACED)
    assert set(roles.topics["image_features"]) == {"/posts", "/lines"}
    assert "landmarks" not in roles.topics
    assert roles.candidates == {"/posts_relative": "landmarks", "/lines_relative": "image_features"}


def test_posts_in_metres_serve_where_those_in_pixels_have_no_camera_or_place():
    assert player("landmarks", *PIXELS, *METRES, PLACED[0]) == ("/posts_relative",)
    assert player("landmarks", *PIXELS, *METRES, PLACED[1]) == ("/posts_relative",)
    assert player("landmarks", *METRES, *PLACED) == ("/posts_relative",)
    from fieldloc.measurements import CameraMount

    mounted = LogMapping(mount=MountSettings(fixed=CameraMount(1.0, 0.0, 0.0, 0.0, None)))
    assert player("landmarks", *PIXELS, *METRES, PLACED[1], mapping=mounted) == ()


def test_lines_in_metres_stand_beside_posts_in_pixels():
    assert player("image_features", PIXELS[0], *METRES, *PLACED) == ("/posts", "/lines_relative")
    detections = ros("/yolo", "vision_msgs/msg/Detection2DArray", 500)
    assert player("image_features", *PIXELS, detections, *PLACED) == ("/yolo", "/lines")


def test_a_compass_needs_to_be_told_where_north_is():
    magnetic = ros("/imu/mag", MAGNETIC)
    assert guess(magnetic).of("/imu/mag") == ("magnetometer",)
    north = LogMapping(compass=CompassSettings(north_rad=0.0))
    assert guess(magnetic, mapping=north).of("/imu/mag") == ("compass",)
    assert guess(ros("/imu", IMU), mapping=north).of("/imu") == ("imu",)


def test_what_gives_no_record_is_shown_by_its_type():
    roles = guess(
        ros("/imu", IMU),
        ros("/camera/image_raw", IMAGE),
        ros("/camera/right/image", IMAGE, 99),
        foxglove("/video", "foxglove.CompressedVideo", 999),
        ros("/joint_states", "sensor_msgs/msg/JointState"),
        ros("/chatter", "std_msgs/msg/String"),
    )
    assert roles.topics == {"image": ("/camera/image_raw",), "imu": ("/imu",), "joints": ("/joint_states",)}
    assert roles.candidates == {"/camera/right/image": "image", "/video": "image"}


def test_a_mapping_says_who_plays_and_who_does_not():
    channels = [ros("/odom", ODOMETRY), ros("/wheel_odom", ODOMETRY), ros("/mocap", POSE)]
    mapping = LogMapping(roles={"odometry": ("/wheel_odom",), "truth": ()})
    roles = guess(*channels, mapping=mapping)
    assert roles.topics == {"odometry": ("/wheel_odom",)}
    assert roles.candidates == {"/odom": "odometry", "/mocap": "truth"}


def test_a_mistaken_schema_on_a_usual_topic_is_not_guessed_to_be_something_else():
    assert guess(own("/odometry", "truth")).topics == {}


def test_topics_without_messages_play_nothing():
    assert guess(ros("/odom", ODOMETRY, 0)).topics == {}
