import threading
import time

import pytest

from logs.viewing.clock import Clock

SECOND = 10**9


class Watch:
    """Time that goes on when told."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def clock(rate: float = 1.0, at_s: float = 10.0) -> tuple[Clock, Watch]:
    watch = Watch()
    return Clock(10 * SECOND, 20 * SECOND, int(at_s * SECOND), rate, watch), watch


def test_time_stands_until_it_is_let_run_and_runs_at_its_rate() -> None:
    played, watch = clock(rate=2.0)
    watch.now_s += 3.0
    assert played.now.position_ns == 10 * SECOND
    played.set(playing=True)
    watch.now_s += 1.5
    assert played.now.position_ns == 13 * SECOND
    played.set(playing=False)
    watch.now_s += 5.0
    assert played.now.position_ns == 13 * SECOND


def test_another_rate_takes_over_where_time_is() -> None:
    played, watch = clock()
    played.set(playing=True)
    watch.now_s += 1.0
    assert played.set(playing=True, rate=4.0).position_ns == 11 * SECOND
    watch.now_s += 1.0
    assert played.now.position_ns == 15 * SECOND
    assert played.now.jumps == 0


def test_time_does_not_leave_the_log() -> None:
    played, watch = clock()
    played.set(playing=True)
    watch.now_s += 100.0
    assert played.now.position_ns == 20 * SECOND
    assert played.set(playing=True, seek_ns=0).position_ns == 10 * SECOND
    assert played.set(playing=True, seek_ns=99 * SECOND).position_ns == 20 * SECOND
    assert Clock(10, 20, 5, 1.0).now.position_ns == 10


def test_a_jump_is_counted_so_that_whoever_plays_begins_anew() -> None:
    played, _ = clock()
    before = played.now.jumps
    now = played.set(playing=False, seek_ns=15 * SECOND)
    assert (now.jumps, now.position_ns, now.playing) == (before + 1, 15 * SECOND, False)


def test_where_a_pass_began_is_known_however_far_time_has_gone_since() -> None:
    played, watch = clock(at_s=12.0)
    played.set(playing=True)
    watch.now_s += 3.0
    assert played.now.begin_ns == 12 * SECOND
    played.set(playing=True, seek_ns=16 * SECOND)
    watch.now_s += 3.0
    assert (played.now.begin_ns, played.now.position_ns) == (16 * SECOND, 19 * SECOND)


def test_at_the_end_time_stands_and_playing_on_begins_from_the_start() -> None:
    played, _ = clock()
    played.set(playing=True)
    assert played.end(played.now.jumps)
    assert (played.now.playing, played.now.ended, played.now.position_ns) == (False, True, 20 * SECOND)
    again = played.set(playing=True)
    assert (again.playing, again.ended, again.position_ns, again.jumps) == (True, False, 10 * SECOND, 1)


def test_the_end_of_what_was_played_before_a_jump_is_not_the_end() -> None:
    played, _ = clock()
    jumps = played.now.jumps
    played.set(playing=True, seek_ns=15 * SECOND)
    assert not played.end(jumps)
    assert not played.now.ended


def test_time_waits_for_what_could_not_be_shown_but_never_runs_back_after_a_jump() -> None:
    played, watch = clock()
    played.set(playing=True)
    watch.now_s += 5.0
    played.hold(12 * SECOND, played.now.jumps)
    assert played.now.position_ns == 12 * SECOND
    watch.now_s += 1.0
    assert played.now.position_ns == 13 * SECOND
    played.hold(15 * SECOND, played.now.jumps)  # which is still to come
    assert played.now.position_ns == 13 * SECOND
    played.set(playing=True, seek_ns=19 * SECOND)
    played.hold(11 * SECOND, played.now.jumps - 1)
    assert played.now.position_ns == 19 * SECOND


@pytest.mark.parametrize(("asked", "taken"), [(0.0, 1.0), (-2.0, 1.0), (1e9, 1000.0), (1e-9, 0.01), (0.5, 0.5)])
def test_a_rate_that_makes_no_sense_is_made_one_that_does(asked: float, taken: float) -> None:
    played, _ = clock()
    assert played.set(playing=True, rate=asked).rate == taken


def test_who_waits_is_woken_by_a_change_and_by_a_nudge() -> None:
    played = Clock(0, 100 * SECOND, 0, 1.0)
    for wake in (lambda: played.set(playing=False, seek_ns=5 * SECOND), played.nudge):
        waiting = threading.Thread(target=played.wait, args=(100 * SECOND, 30.0))
        waiting.start()
        time.sleep(0.05)
        wake()
        waiting.join(5.0)
        assert not waiting.is_alive()


def test_a_nudge_that_comes_before_the_wait_is_not_lost() -> None:
    played = Clock(0, 100 * SECOND, 0, 1.0)
    played.nudge()
    began = time.monotonic()
    played.wait(100 * SECOND, 30.0)
    assert time.monotonic() - began < 5.0
