"""A log, or an estimator at work on it, for Foxglove and Lichtblick: played over their WebSocket at the log's pace."""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from urllib.parse import quote

from fieldloc.errors import FieldlocError
from fieldloc.measurements import Truth
from logs.reader import LogFile
from logs.replay import Run
from logs.result_streams import clock_offset_ns, kept_channels
from logs.viewing.clock import Clock
from logs.viewing.outlet import Outlet
from logs.viewing.player import Player
from logs.viewing.programme import Programme, RawProgramme, Together, Without
from logs.viewing.scenes import frames_beside, log_scenes, run_scenes

_PATIENCE_S = 1.0  # for clients that do not take what they have been sent; the server's threads end with the program


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """host, port: where to listen; port 0 takes any that is free. rate: seconds of the log a second.

    start_s: where to begin, from the log's first message. loop: from the end back to there. wait: play when the first
    viewer looks, not before.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    rate: float = 1.0
    start_s: float = 0.0
    loop: bool = False
    wait: bool = True


@dataclass(frozen=True, slots=True)
class Address:
    """Where a viewer finds the server: the WebSocket itself, and links that open Foxglove (in a browser) and Lichtblick
    (the program, as an argument or a link) on it. Lichtblick understands the protocol since the end of 2025."""

    websocket: str
    foxglove: str
    lichtblick: str


def serve(
    log: LogFile,
    options: ServeOptions,
    on_ready: Callable[[Address], None],
    run: Run | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Until Ctrl-C (KeyboardInterrupt goes through, the server closed) or until `stop` is set.

    run: an estimator at the beginning of its way through the log's recording; it goes no further than is looked at.
    FieldlocError where the log is empty, the port is taken, or the estimator fails.
    """
    programme = programme_of(log, run)
    start_ns, end_ns = programme.span_ns
    at_ns = start_ns + int(options.start_s * 1e9)
    if at_ns > end_ns:
        raise FieldlocError(
            f"{log.path}: lasts {(end_ns - start_ns) * 1e-9:.1f} s, so there is nothing at {options.start_s:g} s"
        )
    clock = Clock(start_ns, end_ns, at_ns, options.rate)
    with _listening(log, options, programme, clock) as (outlet, address):
        on_ready(address)
        if not options.wait:
            clock.set(playing=True)
        player = Player(programme, clock, outlet, at_ns if options.loop else None, stop or threading.Event())
        player.play()


def programme_of(log: LogFile, run: Run | None = None) -> Programme:
    """What the log holds, and what fieldloc makes of it. FieldlocError where there is nothing to play."""
    container = log.container
    if container.span_ns is None:
        raise FieldlocError("; ".join([f"{log.path}: holds no messages", *container.damage]))
    frames = frames_beside(list(container.sources.values()))
    if run is None:
        scenes = log_scenes(log, frames)
        raw = RawProgramme(container)
        taken = [source.topic for source in container.sources.values()]
        return raw if scenes is None else Together([raw, Without(scenes, taken)])
    truth = list(log.records(Truth))
    scenes = run_scenes(run, truth, clock_offset_ns(log), frames)
    return Together([RawProgramme(container, kept_channels(container)), scenes])


@contextlib.contextmanager
def _listening(
    log: LogFile, options: ServeOptions, programme: Programme, clock: Clock
) -> Iterator[tuple[Outlet, Address]]:
    logging.getLogger("foxglove").addHandler(logging.NullHandler())  # else it prints that a viewer has left
    outlet = Outlet(programme.sources, clock, autoplay=options.wait)
    name = f"fieldloc {log.path.name}".encode(errors="replace").decode()
    try:
        outlet.open(name, options.host, options.port)
    except (RuntimeError, OverflowError) as error:
        reason = str(error).removeprefix("FoxgloveError: ")
        raise FieldlocError(
            f"cannot listen on {options.host}, port {options.port}: {reason}; another one with --port, 0 takes any"
        ) from None
    try:
        yield outlet, _address(options.host, outlet.port)
    finally:
        outlet.close(_PATIENCE_S)


def _address(host: str, port: int) -> Address:
    reachable = "127.0.0.1" if host in ("", "0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    websocket = f"ws://{reachable}:{port}"
    query = f"?ds=foxglove-websocket&ds.url={quote(websocket, safe='')}"
    return Address(websocket, f"https://app.foxglove.dev/{query}", f"lichtblick://open{query}")
