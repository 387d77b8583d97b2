"""What is played, and what late comers are told: without a server."""

import threading
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from estimators.base import Estimate
from fieldloc.measurements import Truth
from logs.source import Attachment, Encoded, RawMessage, Source
from logs.viewing.clock import Clock, Playback
from logs.viewing.player import Player
from logs.viewing.programme import RawProgramme, Together, Without
from logs.viewing.timeline import Event, Timeline

TICK, MAP, STATIC, LATCHED = (
    Source("/tick", "json"),
    Source("/map", "json"),
    Source("/tf_static", "cdr"),
    Source("/latched", "cdr", metadata={"offered_qos_profiles": "- history: 3\n  durability: 1\n"}),
)


class Shelf:
    """A container that is a list. queries: what was asked of it."""

    path = Path("shelf")
    metadata: Mapping[str, Mapping[str, str]] = {}
    damage: tuple[str, ...] = ()

    def __init__(self, messages: list[tuple[Source, int, bytes]]) -> None:
        topics = list(dict.fromkeys(source.topic for source, _, _ in messages))
        self.sources = {topics.index(source.topic): source for source, _, _ in messages}
        self._messages = [RawMessage(topics.index(s.topic), t, t, 0, data) for s, t, data in messages]
        self.counts = {n: sum(m.channel == n for m in self._messages) for n in self.sources}
        self.queries: list[tuple[list[int], int | None]] = []

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return (self._messages[0].log_time_ns, self._messages[-1].log_time_ns)

    def messages(
        self, channels: Collection[int], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        self.queries.append((list(channels), start_ns))
        for m in self._messages:
            if m.channel in channels and (start_ns or 0) <= m.log_time_ns < (end_ns or 2**63):
                yield m

    def attachments(self) -> Iterator[Attachment]:
        return iter(())


def ticks(count: int, step_ns: int = 10) -> list[tuple[Source, int, bytes]]:
    return [(TICK, step_ns * k, b"%d" % k) for k in range(count)]


def said(programme: RawProgramme, at_ns: int) -> list[tuple[str, bytes]]:
    return [(message.source.topic, message.data) for message in programme.standing(at_ns)]


def test_messages_are_played_as_they_stand_in_the_log_from_a_time_on() -> None:
    programme = RawProgramme(Shelf(ticks(100)))
    played = list(programme.messages(970))
    assert [(m.log_time_ns, m.data, m.source) for m in played] == [
        (970 + 10 * k, b"%d" % (97 + k), TICK) for k in range(3)
    ]
    assert programme.span_ns == (0, 990)


def test_what_a_rare_topic_last_said_holds_until_it_says_something_else() -> None:
    programme = RawProgramme(Shelf(sorted([*ticks(100), (MAP, 5, b"old"), (MAP, 505, b"new")], key=lambda m: m[1])))
    assert said(programme, 0) == []
    assert said(programme, 5) == []  # it is just about to be said
    assert said(programme, 400) == [("/map", b"old")]
    assert said(programme, 990) == [("/map", b"new")]


def test_static_transforms_add_up_however_many_there_are() -> None:
    static = [(STATIC, 10 * k + 1, b"t%d" % k) for k in range(30)]
    programme = RawProgramme(Shelf(sorted([*ticks(100), *static], key=lambda m: m[1])))
    assert [data for _, data in said(programme, 250)] == [b"t%d" % k for k in range(25)]


def test_a_topic_whose_publisher_latched_it_holds_also_if_it_speaks_often() -> None:
    latched = [(LATCHED, 10 * k + 1, b"%d" % k) for k in range(50)]
    programme = RawProgramme(Shelf(sorted([*ticks(100), *latched], key=lambda m: m[1])))
    assert said(programme, 990) == [("/latched", b"49")]


def test_only_topics_that_hold_are_read_for_that_and_only_once() -> None:
    shelf = Shelf(sorted([*ticks(100), (MAP, 5, b"map")], key=lambda m: m[1]))
    programme = RawProgramme(shelf)
    said(programme, 100)
    said(programme, 200)
    assert shelf.queries == [([1], None)]


def test_programmes_play_together_in_the_order_of_time_and_without_what_another_has() -> None:
    one, other = RawProgramme(Shelf(ticks(3))), RawProgramme(Shelf([(MAP, 5, b"m"), (TICK, 6, b"x"), (MAP, 15, b"n")]))
    both = Together([one, Without(other, ["/tick"])])
    assert [m.data for m in both.messages(0)] == [b"0", b"m", b"1", b"n", b"2"]
    assert [source.topic for source in both.sources] == ["/tick", "/map"]
    assert both.span_ns == (0, 20)
    assert [m.data for m in both.standing(20)] == [b"1", b"n"]  # a topic so quiet holds what it said


# -- the timeline ------------------------------------------------------------------------------------------------------


def events(count: int, made: list[int]) -> Iterator[Event]:
    for k in range(count):
        made.append(k)
        yield Event(10**8 * k, Estimate(10**8 * k, np.zeros(3), np.eye(3)), np.zeros(3))


def test_an_estimator_runs_no_further_than_it_is_watched_and_never_twice() -> None:
    made: list[int] = []
    timeline = Timeline(events(100, made))
    watching = timeline.after(0)
    assert [next(watching).log_time_ns for _ in range(5)] == [10**8 * k for k in range(5)]
    assert made == [0, 1, 2, 3, 4]
    later = timeline.after(20 * 10**8)
    assert next(later).log_time_ns == 20 * 10**8
    assert len(list(timeline.after(0))) == 100
    assert made == list(range(100))
    assert list(timeline.after(100 * 10**8)) == []


def test_before_a_time_is_the_last_of_each_kind_but_nothing_old() -> None:
    truth = Truth(0, np.zeros(3))
    estimate = Estimate(0, np.zeros(3), np.eye(3))
    at_s = [(0.0, truth), (0.2, estimate), (0.9, estimate), (1.9, estimate), (2.0, estimate)]
    timeline = Timeline([Event(int(1e9 * t), record, None) for t, record in at_s])
    kinds = (Estimate, Truth)
    assert [e.log_time_ns for e in timeline.before(10**9, kinds)] == [9 * 10**8, 0]
    assert [e.log_time_ns for e in timeline.before(2 * 10**9, kinds)] == [19 * 10**8]
    assert [e.log_time_ns for e in timeline.before(4 * 10**9, kinds)] == []


# -- the player --------------------------------------------------------------------------------------------------------


class Stage:
    """Writes down what is shown, and does something at a message."""

    def __init__(self, at: dict[bytes, object]) -> None:
        self.shown: list[Encoded] = []
        self.told: list[tuple[Playback, bool]] = []
        self.topics: set[str] = set()
        self._at = at

    def send(self, message: Encoded) -> None:
        self.shown.append(message)
        if callable(do := self._at.pop(message.data, None)):
            do()

    def tell(self, now: Playback, did_seek: bool = False) -> None:
        self.told.append((now, did_seek))

    def tell_time(self, now: Playback) -> None:
        pass

    def newcomers(self) -> set[str]:
        topics, self.topics = self.topics, set()
        return topics


def play(messages: list[tuple[Source, int, bytes]], loop: bool = False, **at: object) -> tuple[Stage, Clock]:
    """Until the message "stop" is shown. at: what to do at the message of that name."""
    programme = RawProgramme(Shelf(messages))
    clock = Clock(*programme.span_ns, 0, 1000.0)
    stop = threading.Event()

    def bind(do: object) -> object:
        return (lambda: do(stage, clock)) if callable(do) else do

    stage = Stage({name.encode(): bind(do) for name, do in at.items()} | {b"stop": stop.set})
    clock.set(playing=True)
    player = Player(programme, clock, stage, 0 if loop else None, stop)
    playing = threading.Thread(target=player.play, daemon=True)
    playing.start()
    playing.join(10.0)
    assert not playing.is_alive()
    return stage, clock


def many(*extra: tuple[Source, int, bytes]) -> list[tuple[Source, int, bytes]]:
    """A frequent topic, so that it does not hold, and more."""
    return sorted([*((TICK, 10**7 * k, b"m%d" % k) for k in range(40)), *extra], key=lambda m: m[1])


def test_a_jump_shows_what_holds_there_and_goes_on_from_there() -> None:
    def jump(stage: Stage, clock: Clock) -> None:
        clock.set(playing=True, seek_ns=3 * 10**8)

    stage, _ = play(many((MAP, 5, b"map"), (TICK, 4 * 10**8, b"stop")), m3=jump)
    data = [m.data for m in stage.shown]
    after = data.index(b"m3") + 1
    assert data[after : after + 3] == [b"map", b"m30", b"m31"]
    assert stage.shown[after].log_time_ns == 3 * 10**8
    assert stage.told[-1][1]


def test_who_comes_late_is_told_what_holds_on_his_topics() -> None:
    def come(stage: Stage, clock: Clock) -> None:
        stage.topics = {"/map"}

    other = Source("/other", "json")
    stage, _ = play(many((MAP, 5, b"map"), (other, 6, b"other"), (TICK, 4 * 10**8, b"stop")), m20=come)
    shown = [(m.source.topic, m.data) for m in stage.shown if m.source is not TICK]
    assert shown == [("/map", b"map"), ("/other", b"other"), ("/map", b"map")]


def test_at_the_end_of_a_loop_it_begins_anew() -> None:
    programme = RawProgramme(Shelf(many()))
    clock, stop = Clock(*programme.span_ns, 0, 1000.0), threading.Event()
    stage = Stage({})
    clock.set(playing=True)
    threading.Timer(0.2, stop.set).start()
    Player(programme, clock, stage, 2 * 10**8, stop).play()
    data = [m.data for m in stage.shown]
    assert data[:41] == [*(b"m%d" % k for k in range(40)), b"m20"]
    assert data.count(b"m39") >= 2
    assert any(did_seek for _, did_seek in stage.told)


def test_without_a_loop_it_stands_at_the_end_and_still_tells_newcomers() -> None:
    programme = RawProgramme(Shelf(many((MAP, 5, b"map"))))
    clock, stop = Clock(*programme.span_ns, 0, 1000.0), threading.Event()

    def come() -> None:
        assert clock.now.ended
        stage.topics = {"/map"}

    stage = Stage({})
    clock.set(playing=True)
    threading.Timer(0.2, come).start()
    threading.Timer(0.5, stop.set).start()
    Player(programme, clock, stage, None, stop).play()
    assert [m.data for m in stage.shown][-2:] == [b"m39", b"map"]
    assert len(stage.shown) == 42
    assert stage.told[-1][0].ended
