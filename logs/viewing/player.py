"""Plays a programme by a clock: each message when its time has come, and to late comers what still holds."""

import threading
from typing import Protocol

from logs.source import Encoded
from logs.viewing.clock import Clock, Playback
from logs.viewing.programme import Programme

_TELL_EVERY_S = 0.04  # the time, to viewers
_LATE_S = 0.5  # who is so far behind does not catch up: time waits


class Stage(Protocol):
    """Where it is shown."""

    def send(self, message: Encoded) -> None: ...
    def tell(self, now: Playback, did_seek: bool = False) -> None: ...
    def tell_time(self, now: Playback) -> None: ...
    def newcomers(self) -> set[str]: ...


class Player:
    """loop_to_ns: where to begin anew at the end; None: stay there until a viewer wants something else."""

    def __init__(
        self, programme: Programme, clock: Clock, stage: Stage, loop_to_ns: int | None, stop: threading.Event
    ) -> None:
        self._programme, self._clock, self._stage = programme, clock, stage
        self._loop_to_ns, self._stop = loop_to_ns, stop

    def play(self) -> None:
        """Until it is told to stop."""
        while not self._stop.is_set():
            begun = self._clock.now
            self._stage.tell(begun, did_seek=begun.jumps > 0)  # first: viewers forget everything at a jump
            self._remind(begun.begin_ns)
            if self._show(begun) and self._until(self._clock.end_ns, begun.jumps):
                self._at_the_end(begun.jumps)

    def _show(self, begun: Playback) -> bool:
        """All from there on; False where time has jumped meanwhile, or all is over."""
        for message in self._programme.messages(begun.begin_ns):
            if not self._until(message.log_time_ns, begun.jumps):
                return False
            self._stage.send(message)
        return True

    def _until(self, time_ns: int, jumps: int) -> bool:
        """Wait for it; False where time has jumped meanwhile, or all is over."""
        now = self._clock.now
        while now.jumps == jumps and not self._stop.is_set():
            if topics := self._stage.newcomers():
                self._remind(now.position_ns, topics)
                self._stage.tell(now)
            if now.position_ns >= time_ns and (now.playing or now.ended):
                if (now.position_ns - time_ns) * 1e-9 > _LATE_S * now.rate:
                    self._clock.hold(time_ns, jumps)
                return True
            self._clock.wait(time_ns, _TELL_EVERY_S)
            now = self._clock.now
            self._stage.tell_time(now)
        return False

    def _at_the_end(self, jumps: int) -> None:
        if self._loop_to_ns is not None:
            self._clock.set(playing=True, seek_ns=self._loop_to_ns)
        elif self._clock.end(jumps):
            self._stage.tell(self._clock.now)
            while self._clock.now.jumps == jumps and not self._stop.is_set():
                if topics := self._stage.newcomers():
                    self._remind(self._clock.end_ns, topics)
                    self._stage.tell(self._clock.now)
                self._clock.wait(self._clock.end_ns, _TELL_EVERY_S)

    def _remind(self, at_ns: int, topics: set[str] | None = None) -> None:
        """Of what was said before and still holds, on these topics or on all."""
        for message in self._programme.standing(at_ns):
            if topics is None or message.source.topic in topics:
                self._stage.send(message._replace(log_time_ns=at_ns))
