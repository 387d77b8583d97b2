"""The server as a viewer sees it: over a real socket."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import foxglove.messages
import numpy as np
import pytest
from children import interruptible
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from two_minds import InTwoMinds
from viewing_client import Client

from estimators.base import Estimate
from estimators.config import Config
from estimators.ekf import Ekf
from fieldloc.camera import Camera
from fieldloc.errors import FieldlocError
from fieldloc.field import FieldMap, Landmark, load_field
from fieldloc.measurements import InitialPose, LandmarkScan, Odometry, Truth
from logs.foxglove import topics
from logs.reader import LogFile
from logs.recording import load_recording
from logs.replay import Run, replay
from logs.schema import BY_ROLE, Record, decode, topic_of
from logs.source import Source
from logs.viewing.scenes import TRUE_POSE, TRUE_WAY
from logs.viewing.server import Address, ServeOptions, programme_of, serve
from logs.writer import LogWriter

SECOND = 10**9
START_NS = 1_700_000_000 * SECOND
STEPS = 50  # ten a second: five seconds
MARKS = {"a": (3.0, 0.0), "b": (0.0, 2.0), "c": (-1.0, -2.5)}
FIELD = FieldMap(
    "three",
    np.zeros((0, 2, 2)),
    np.array([[0.0, 0.0, 0.5]]),
    tuple(Landmark(label, np.array(place), 0.1, np.zeros((2, 2))) for label, place in MARKS.items()),
)
CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
RAW = ["/field", "/camera", "/initial_pose", "/odometry", "/landmarks", "/truth"]


def scan(stamp_ns: int, pose: np.ndarray) -> LandmarkScan:
    offsets = np.array(list(MARKS.values())) - pose[:2]
    seen = np.stack([np.hypot(*offsets.T), np.arctan2(offsets[:, 1], offsets[:, 0]) - pose[2]], axis=-1)
    return LandmarkScan(stamp_ns, tuple(MARKS), seen, np.tile(np.diag([0.05, 0.02]) ** 2, (3, 1, 1)))


def pose_at(k: int) -> np.ndarray:
    return np.array([0.02 * k, 0.0, 0.0])


def drive(path: Path, offset_ns: int = 0) -> LogFile:
    """Straight ahead at 0.2 m/s, three landmarks in sight. offset_ns: log time minus stamp."""
    with LogWriter(path) as log:

        def put(record: Record, stamp_ns: int) -> None:
            log.write(topic_of(type(record)), record, stamp_ns + offset_ns)

        put(FIELD, START_NS)
        put(CAMERA, START_NS)
        put(InitialPose(START_NS, np.zeros(3), np.diag([0.1, 0.1, 0.1]) ** 2), START_NS)
        for k in range(STEPS):
            stamp_ns = START_NS + k * SECOND // 10
            put(Odometry(stamp_ns, np.array([0.2, 0.0, 0.0]), np.diag([0.02, 0.02, 0.02]) ** 2), stamp_ns)
            put(scan(stamp_ns, pose_at(k)), stamp_ns)
            put(Truth(stamp_ns, pose_at(k)), stamp_ns)
    return LogFile(path)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> LogFile:
    return drive(tmp_path_factory.mktemp("serve") / "drive.mcap")


@contextmanager
def serving(log: LogFile, run: Run | None = None, **options: object) -> Iterator[int]:
    """The port. What goes wrong in the server's thread fails the test."""
    ready, stop, failures = threading.Event(), threading.Event(), []
    addresses: list[Address] = []

    def on_ready(address: Address) -> None:
        addresses.append(address)
        ready.set()

    def work() -> None:
        try:
            serve(log, ServeOptions(**{"port": 0, "rate": 100.0, **options}), on_ready, run, stop)  # type: ignore[arg-type]
        except FieldlocError as error:
            failures.append(error)
        finally:
            ready.set()

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    assert ready.wait(10.0)
    try:
        if addresses:
            yield int(addresses[0].websocket.rsplit(":", 1)[1])
    finally:
        stop.set()
        thread.join(10.0)
        assert not thread.is_alive()
    assert not failures, failures


def ended(client: Client) -> bool:
    return any(state.status == 3 for state in client.states)


def watched(port: int, **options: object) -> Client:
    """All that a client gets until the end."""
    with Client(port, **options) as client:  # type: ignore[arg-type]
        client.receive(ended)
        client.drain(0.2)
    return client


def message_class(channel: dict) -> type:
    """From the schema that was advertised, and from nothing else."""
    import base64

    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"] + "=="))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


# -- a log -------------------------------------------------------------------------------------------------------------


def test_every_message_of_the_log_arrives_as_it_stands_in_the_file(log: LogFile) -> None:
    with serving(log) as port:
        client = watched(port)
    assert client.info["name"] == "fieldloc drive.mcap"
    counts = Counter(message.topic for message in client.messages)
    assert {topic: counts[topic] for topic in RAW[3:]} == dict.fromkeys(RAW[3:], STEPS)
    sources = log.container.sources
    for topic in RAW[3:]:
        got = [(message.log_time_ns, message.data) for message in client.on(topic)]
        numbers = [number for number, source in sources.items() if source.topic == topic]
        assert got == [(raw.log_time_ns, raw.data) for raw in log.container.messages(numbers)]
        channel = client.channel(topic)
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        (source,) = (sources[number] for number in numbers)
        assert channel["schema"].encode() == source.schema_data
        assert channel["schemaName"] == source.schema_name
    record = decode(BY_ROLE["odometry"], "/odometry", client.on("/odometry")[7].data)
    assert isinstance(record, Odometry)
    assert record.stamp_ns == START_NS + 7 * SECOND // 10


def test_messages_come_in_the_order_of_time_and_none_before_its_time(log: LogFile) -> None:
    began = time.monotonic()
    with serving(log, rate=5.0) as port, Client(port) as client:
        client.receive(lambda c: len(c.on("/truth")) == STEPS)
        took_s = time.monotonic() - began
    times = [message.log_time_ns for message in client.messages if message.topic in RAW[3:]]
    assert times == sorted(times)
    assert 4.9 / 5.0 <= took_s < 4.9 / 5.0 + 2.0
    assert client.times_ns == sorted(client.times_ns)
    assert client.times_ns[0] >= START_NS
    assert client.times_ns[-1] <= START_NS + 49 * SECOND // 10


def test_a_viewer_draws_field_truth_and_rays_from_the_schemas_it_is_told(log: LogFile) -> None:
    with serving(log) as port:
        client = watched(port)

    def decoded(topic: str) -> list:
        of = message_class(client.channel(topic))
        return [of.FromString(message.data) for message in client.on(topic)]  # type: ignore[attr-defined]

    (field,) = decoded(topics.FIELD)[:1]
    assert client.channel(topics.FIELD)["schemaName"] == "foxglove.SceneUpdate"
    assert sum(len(entity.cylinders) for entity in field.entities) == 3
    way = decoded(TRUE_WAY)[0]
    assert way.poses[-1].position.x == pytest.approx(0.98)
    true = decoded(TRUE_POSE)
    assert len(true) >= STEPS
    assert true[-1].pose.position.x == pytest.approx(0.98)
    sights = decoded(topics.SIGHTS)
    first = sights[0].entities[0].lines[0]
    assert (first.points[1].x, first.points[1].y) == pytest.approx((3.0, 0.0), abs=0.002)  # where landmark a stands
    assert len(sights) >= STEPS


def test_estimates_of_a_result_are_shown_as_a_robot_with_its_ellipse(log: LogFile, tmp_path: Path) -> None:
    with LogWriter(tmp_path / "result.mcap") as out:
        out.write("/field", FIELD, START_NS)
        for k in range(STEPS):
            out.write("/estimate", Estimate(START_NS + k * SECOND // 10, pose_at(k), 0.01 * np.eye(3)))
    with serving(LogFile(tmp_path / "result.mcap")) as port:
        client = watched(port)
    kinds = {
        topic: client.channel(topic)["schemaName"] for topic in (topics.POSE, topics.UNCERTAINTY, topics.TRANSFORMS)
    }
    assert list(kinds.values()) == ["foxglove.PoseInFrame", "foxglove.SceneUpdate", "foxglove.FrameTransforms"]
    poses = [message_class(client.channel(topics.POSE)).FromString(m.data) for m in client.on(topics.POSE)]  # type: ignore[attr-defined]
    assert [round(pose.pose.position.x, 9) for pose in poses[:STEPS]] == [round(0.02 * k, 9) for k in range(STEPS)]
    assert client.on(topics.UNCERTAINTY)
    assert client.on(topics.TRAJECTORY)


def test_every_topic_is_advertised_before_its_first_message(log: LogFile) -> None:
    for programme in (programme_of(log), programme_of(log, Run(load_recording(log), Ekf(Config())))):
        told = {source.topic for source in programme.sources}
        sent = {m.source.topic for m in programme.messages(0)} | {m.source.topic for m in programme.standing(START_NS)}
        assert sent <= told


def test_scenes_that_are_in_the_file_are_not_made_twice(tmp_path: Path) -> None:
    schema = foxglove.messages.PoseInFrame.get_schema()
    own = Source(topics.POSE, "protobuf", schema.name, schema.encoding, schema.data)
    with LogWriter(tmp_path / "result.mcap") as out:
        out.write("/estimate", Estimate(START_NS, np.zeros(3), np.eye(3)))
        out.write_raw(own, START_NS, foxglove.messages.PoseInFrame().encode())
    programme = programme_of(LogFile(tmp_path / "result.mcap"))
    counts = Counter(message.source.topic for message in programme.messages(0))
    assert (counts[topics.POSE], counts[topics.STATE]) == (1, 1)
    assert [source.topic for source in programme.sources].count(topics.POSE) == 1


# -- late comers, several, slow ----------------------------------------------------------------------------------------


def test_who_comes_later_gets_the_map_the_camera_and_the_scene_at_once(log: LogFile) -> None:
    with serving(log, rate=1.0) as port, Client(port) as first:
        first.receive(lambda c: len(c.on("/odometry")) >= 10)
        with Client(port) as second:
            second.receive(lambda c: all(c.on(topic) for topic in ("/field", "/camera", topics.FIELD, TRUE_WAY)))
            came_ns = first.on("/odometry")[-1].log_time_ns
            assert second.on("/field")[0].log_time_ns >= START_NS + 9 * SECOND // 10
            second.receive(lambda c: c.on("/odometry"))
            assert second.on("/odometry")[0].log_time_ns >= came_ns - SECOND // 10
            assert second.times_ns[0] >= START_NS


def test_the_map_comes_to_who_starts_in_the_middle(log: LogFile) -> None:
    with serving(log, start_s=3.0) as port:
        client = watched(port)
    assert client.on("/field")[0].log_time_ns == START_NS + 3 * SECOND
    assert client.on("/odometry")[0].log_time_ns == START_NS + 3 * SECOND
    assert len(client.on("/odometry")) == 20


def test_only_what_is_subscribed_to_is_sent(log: LogFile) -> None:
    with serving(log) as port:
        client = watched(port, subscribes=lambda topic: topic == "/truth")
    assert {message.topic for message in client.messages} == {"/truth"}
    assert len(client.messages) == STEPS


def test_a_client_that_takes_nothing_holds_up_neither_the_others_nor_the_end(tmp_path: Path) -> None:
    big = Source("/big", "json")
    with LogWriter(tmp_path / "big.mcap") as out:
        for k in range(2000):
            out.write_raw(big, START_NS + k * SECOND // 1000, b'"%s"' % (b"x" * 20_000))
    with ExitStack() as later:
        with serving(LogFile(tmp_path / "big.mcap"), rate=1.0) as port:
            slow = later.enter_context(Client(port))
            slow.receive(lambda c: c.messages)  # and from now on nothing, but it stays
            began = time.monotonic()
            quick = watched(port)
            assert quick.messages[-1].log_time_ns == START_NS + 1999 * SECOND // 1000
            assert time.monotonic() - began < 4.0
            stopping = time.monotonic()
        assert time.monotonic() - stopping < 4.0


# -- controls ----------------------------------------------------------------------------------------------------------


def test_the_log_waits_for_its_first_viewer(log: LogFile) -> None:
    with serving(log) as port:
        time.sleep(0.3)  # at this rate the log would be over
        client = watched(port)
    assert len(client.on("/odometry")) == STEPS


def test_without_waiting_it_plays_to_an_empty_house(log: LogFile) -> None:
    with serving(log, wait=False) as port:
        time.sleep(0.3)
        with Client(port) as client:
            client.receive(ended)
            assert client.on("/odometry") == []
            client.receive(lambda c: c.on("/field"))


def test_a_viewer_can_pause_jump_and_go_on(log: LogFile) -> None:
    with serving(log, rate=0.5) as port, Client(port) as client:
        client.receive(lambda c: len(c.on("/odometry")) >= 2)
        assert {"time", "playbackControl"} <= set(client.info["capabilities"])
        assert client.info["dataStartTime"]["sec"] == START_NS // SECOND
        client.control(play=False, speed=0.5, request="pause")
        client.receive(lambda c: any(s.request == "pause" for s in c.states))
        assert client.states[-1].status == 1
        client.drain(0.1)
        count = len(client.on("/odometry"))
        client.drain(0.5)
        assert len(client.on("/odometry")) == count
        client.control(play=False, seek_ns=START_NS + 4 * SECOND, request="jump")
        client.receive(lambda c: any(s.request == "jump" for s in c.states))
        (answer,) = (s for s in client.states if s.request == "jump")
        assert (answer.status, answer.time_ns, answer.did_seek) == (1, START_NS + 4 * SECOND, True)
        client.receive(lambda c: c.on(topics.FIELD)[-1].log_time_ns == START_NS + 4 * SECOND)  # shown although paused
        client.control(play=True, speed=50.0, request="go")
        client.receive(ended)
        client.drain(0.1)
        rest = [m.log_time_ns for m in client.on("/odometry")][count:]
        assert rest == [START_NS + k * SECOND // 10 for k in range(40, STEPS)]


def test_play_at_the_end_begins_again(log: LogFile) -> None:
    with serving(log) as port, Client(port) as client:
        client.receive(ended)
        client.drain(0.1)
        client.control(play=True, speed=100.0, request="again")
        client.receive(lambda c: len(c.on("/odometry")) == 2 * STEPS)
        (answer,) = (s for s in client.states if s.request == "again")
        assert (answer.status, answer.did_seek) == (0, True)
        assert START_NS <= answer.time_ns < START_NS + SECOND


def test_a_loop_goes_back_to_where_it_began(log: LogFile) -> None:
    with serving(log, start_s=2.0, loop=True) as port, Client(port) as client:
        client.receive(lambda c: len(c.on("/truth")) > 65)
        times = [message.log_time_ns for message in client.on("/truth")]
    assert times[:30] == [START_NS + k * SECOND // 10 for k in range(20, STEPS)]
    assert sum(t == START_NS + 2 * SECOND for t in times) >= 2
    assert min(times) == START_NS + 2 * SECOND


# -- a running estimator -----------------------------------------------------------------------------------------------


def test_a_running_estimator_is_seen_to_find_what_a_replay_finds(log: LogFile) -> None:
    recording = load_recording(log)
    expected = replay(recording, Ekf(Config())).estimates
    with serving(log, Run(recording, Ekf(Config()))) as port:
        client = watched(port)
    of = message_class(client.channel(topics.POSE))
    poses = {m.log_time_ns: of.FromString(m.data) for m in client.on(topics.POSE)}  # type: ignore[attr-defined]
    assert sorted(poses) == [estimate.stamp_ns for estimate in expected]
    for estimate in expected:
        assert poses[estimate.stamp_ns].pose.position.x == pytest.approx(estimate.pose[0], abs=1e-12)
    moves = message_class(client.channel(topics.TRANSFORMS)).FromString(client.on(topics.TRANSFORMS)[-1].data)  # type: ignore[attr-defined]
    links = [(t.parent_frame_id, t.child_frame_id) for t in moves.transforms]
    assert links == [("field", "odom"), ("odom", "robot")]
    assert client.on("/odometry")
    assert client.on(topics.SIGHTS)
    assert client.on(TRUE_WAY)


def test_the_hypotheses_of_a_running_estimator_are_seen_and_what_befalls_them(log: LogFile) -> None:
    recording = load_recording(log)
    expected = replay(recording, InTwoMinds(Config()))
    with serving(log, Run(recording, InTwoMinds(Config()))) as port:
        client = watched(port)
    ways = {m.log_time_ns for m in client.on(topics.HYPOTHESES)}
    assert ways == {one.stamp_ns for one in expected.ambiguities}
    of = message_class(client.channel(topics.HYPOTHESES))
    first = of.FromString(client.on(topics.HYPOTHESES)[0].data)  # type: ignore[attr-defined]
    both = [one.pose[0] for one in expected.ambiguities[0].hypotheses]
    assert [pose.position.x for pose in first.poses] == pytest.approx(both, abs=1e-9)
    assert len(client.on(topics.WEIGHTS)) == len(client.on(topics.HYPOTHESES))
    lines = message_class(client.channel(topics.EVENTS))
    told = [lines.FromString(m.data) for m in client.on(topics.EVENTS)]  # type: ignore[attr-defined]
    assert [(line.name, line.message) for line in told] == [(one.kind, one.text) for one in expected.events]
    assert [one.kind for one in expected.events] == ["start", "decision"]


def test_an_estimator_may_be_watched_twice_but_runs_once(log: LogFile) -> None:
    class Counting(Ekf):
        fed = 0

        def predict(self, odometry: Odometry) -> None:
            Counting.fed += 1
            super().predict(odometry)

    with serving(log, Run(load_recording(log), Counting(Config()))) as port, Client(port) as client:
        client.receive(ended)
        assert Counting.fed == STEPS
        client.control(play=True, speed=100.0, seek_ns=START_NS)
        client.receive(lambda c: len(c.on("/odometry")) == 2 * STEPS)
    assert Counting.fed == STEPS


def test_estimates_stand_beside_the_log_whose_clock_is_another(tmp_path: Path) -> None:
    offset_ns = 1000 * SECOND
    log = drive(tmp_path / "late.mcap", offset_ns)
    programme = programme_of(log, Run(load_recording(log), Ekf(Config())))
    assert programme.span_ns == (START_NS + offset_ns, START_NS + offset_ns + 49 * SECOND // 10)
    times = {message.log_time_ns for message in programme.messages(0) if message.source.topic == topics.POSE}
    assert min(times) == START_NS + offset_ns


def test_earlier_results_in_the_log_make_room_for_the_running_estimate(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "merged.mcap") as out:
        for message in drive(tmp_path / "drive.mcap").messages():
            out.write(message.topic, message.record, message.log_time_ns)
        out.write("/estimate", Estimate(START_NS + 5 * SECOND, np.array([9.0, 9.0, 0.0]), np.eye(3)))
    merged = LogFile(tmp_path / "merged.mcap")
    programme = programme_of(merged, Run(load_recording(merged), Ekf(Config())))
    assert "/estimate" not in {source.topic for source in programme.sources}
    assert all(message.source.topic != "/estimate" for message in programme.messages(0))


def test_an_estimator_that_fails_ends_the_show_with_its_reason(log: LogFile) -> None:
    class Broken(Ekf):
        def advance(self, stamp_ns: int) -> None:
            raise ValueError("out of order")

    with pytest.raises(FieldlocError, match=r"Broken failed at .*: out of order"):
        serve(log, ServeOptions(port=0, wait=False), lambda address: None, Run(load_recording(log), Broken(Config())))


# -- beginning and end -------------------------------------------------------------------------------------------------


def test_the_addresses_open_the_viewers_on_the_server(log: LogFile) -> None:
    told: list[Address] = []
    stop = threading.Event()
    stop.set()
    serve(log, ServeOptions(port=0), told.append, stop=stop)
    (address,) = told
    port = address.websocket.rsplit(":", 1)[1]
    assert address.websocket == f"ws://127.0.0.1:{port}"
    query = f"?ds=foxglove-websocket&ds.url=ws%3A%2F%2F127.0.0.1%3A{port}"
    assert address.foxglove == f"https://app.foxglove.dev/{query}"
    assert address.lichtblick == f"lichtblick://open{query}"


def test_only_this_machine_can_connect_unless_told_otherwise(log: LogFile) -> None:
    assert ServeOptions().host == "127.0.0.1"
    assert ServeOptions().port == 8765


def test_a_port_that_is_taken_is_named_with_the_way_out(log: LogFile) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(FieldlocError, match=rf"cannot listen on 127\.0\.0\.1, port {port}: .*in use.*--port"):
            serve(log, ServeOptions(port=port), lambda address: None)
    with pytest.raises(FieldlocError, match=r"port 70000: .*--port"):
        serve(log, ServeOptions(port=70000), lambda address: None)


def test_a_start_behind_the_end_and_an_empty_log_are_told(log: LogFile, tmp_path: Path) -> None:
    with pytest.raises(FieldlocError, match=r"drive\.mcap: lasts 4\.9 s, so there is nothing at 5 s"):
        serve(log, ServeOptions(port=0, start_s=5.0), lambda address: None)
    with LogWriter(tmp_path / "empty.mcap"):
        pass
    with pytest.raises(FieldlocError, match=r"empty\.mcap: holds no messages"):
        serve(LogFile(tmp_path / "empty.mcap"), ServeOptions(port=0), lambda address: None)


PROGRAM = """
import sys
from logs.reader import LogFile
from logs.viewing.server import ServeOptions, serve
try:
    serve(LogFile(sys.argv[1]), ServeOptions(port=0), lambda address: print(address.websocket, flush=True))
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.parametrize("viewer", ["none", "left", "watching"])
def test_ctrl_c_ends_it_cleanly_and_nothing_is_printed_when_a_viewer_leaves(log: LogFile, viewer: str) -> None:
    command = [sys.executable, "-c", PROGRAM, str(log.path)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    pipe = subprocess.PIPE
    with (
        subprocess.Popen(
            command, stdout=pipe, stderr=pipe, text=True, env=environment, preexec_fn=interruptible
        ) as program,
        ExitStack() as later,
        ExitStack() as viewing,
    ):
        later.callback(program.kill)
        assert program.stdout is not None
        assert program.stderr is not None
        port = int(program.stdout.readline().rsplit(":", 1)[1])
        if viewer != "none":
            client = viewing.enter_context(Client(port))
            client.receive(lambda c: c.messages)
        if viewer == "left":
            viewing.close()
            time.sleep(0.3)
        program.send_signal(signal.SIGINT)
        assert program.wait(10) == 0
        assert program.stdout.read() == "interrupted\n"
        assert program.stderr.read() == ""


def test_reading_a_log_does_not_import_the_server_nor_a_page_the_pictures() -> None:
    code = (
        "import sys; import logs.reader, logs.viewing.page; "
        "print(sorted({'foxglove', 'matplotlib', 'rosbags'} & set(sys.modules)))"
    )
    root = Path(__file__).parents[1]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout == "[]\n"


@pytest.mark.slow
def test_ten_minutes_at_a_hundred_hertz_keep_their_pace(tmp_path: Path) -> None:
    field = load_field("kidsize")
    with LogWriter(tmp_path / "long.mcap") as out:
        out.write("/field", field, 0)
        for k in range(60_000):
            out.write(
                "/estimate", Estimate(k * SECOND // 100, np.array([0.001 * (k % 1000), 0.0, 0.0]), np.eye(3) * 0.01)
            )
    log = LogFile(tmp_path / "long.mcap")
    with serving(log, rate=16.0, start_s=500.0) as port:
        began = time.monotonic()
        client = watched(port)
        took_s = time.monotonic() - began
    assert took_s < 100 / 16 + 3.0
    assert len(client.on("/estimate")) == 10_000


def test_json_is_json(log: LogFile) -> None:
    with serving(log) as port:
        client = watched(port, subscribes=lambda topic: topic == "/landmarks")
    document = json.loads(client.on("/landmarks")[0].data)
    assert [mark["label"] for mark in document["landmarks"]] == list(MARKS)
