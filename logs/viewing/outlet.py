"""The wire: channels of a Foxglove server, what its clients ask for, and the time they are told."""

import queue
import threading
import time
from collections.abc import Sequence

import foxglove
from foxglove import websocket

from logs.source import Encoded, Source
from logs.viewing.clock import Clock, Playback

_CAPABILITIES = [websocket.Capability.Time, websocket.Capability.PlaybackControl]
_SETTLED_S = 0.15  # a client subscribes to one topic after the other, and is not to miss the first messages of some
_Key = tuple[str, str, str, str, bytes]


class Outlet(websocket.ServerListener):
    """Never waits for a client: what a slow one does not take in time it does not get.

    sources: advertised from the beginning. autoplay: time begins to run when the first client has subscribed, unless
    one has taken the controls by then.
    """

    def __init__(self, sources: Sequence[Source], clock: Clock, autoplay: bool) -> None:
        self._clock = clock
        self._autoplay = autoplay
        self._asked_s: float | None = None
        self._context = foxglove.Context()
        self._channels: dict[_Key, foxglove.Channel] = {}
        self._server: websocket.WebSocketServer | None = None
        self._newcomers: queue.SimpleQueue[str] = queue.SimpleQueue()
        for source in sources:
            self._channel(source)

    def open(self, name: str, host: str, port: int) -> None:
        """RuntimeError or OverflowError where that is not possible."""
        self._server = foxglove.start_server(
            name=name,
            host=host,
            port=port,
            capabilities=_CAPABILITIES,
            server_listener=self,
            context=self._context,
            playback_time_range=(self._clock.start_ns, self._clock.end_ns),
        )

    @property
    def port(self) -> int:
        return self._running.port

    def close(self, patience_s: float) -> None:
        """Waits so long at most: the server would wait forever for a client that takes nothing."""
        stopping = threading.Thread(target=self._running.stop, daemon=True)
        stopping.start()
        stopping.join(patience_s)

    def send(self, message: Encoded) -> None:
        self._channel(message.source).log(message.data, log_time=message.log_time_ns)

    def tell(self, now: Playback, did_seek: bool = False) -> None:
        """Time, and what it does."""
        self._running.broadcast_playback_state(_state(now, did_seek, None))
        self._running.broadcast_time(now.position_ns)

    def tell_time(self, now: Playback) -> None:
        self._running.broadcast_time(now.position_ns)

    def newcomers(self) -> set[str]:
        """Topics that a client has subscribed to since the last call. Lets time run when the first one has them all."""
        if self._autoplay and self._asked_s is not None and time.monotonic() > self._asked_s + _SETTLED_S:
            self._autoplay = False
            self._clock.set(playing=True)
        topics = set()
        while True:
            try:
                topics.add(self._newcomers.get_nowait())
            except queue.Empty:
                return topics

    def on_subscribe(self, client: websocket.Client, channel: websocket.ChannelView) -> None:
        self._newcomers.put(channel.topic)
        self._asked_s = time.monotonic()
        self._clock.nudge()

    def on_playback_control_request(
        self, playback_control_request: websocket.PlaybackControlRequest
    ) -> websocket.PlaybackState:
        request = playback_control_request
        self._autoplay = False
        jumps = self._clock.now.jumps
        playing = request.playback_command == websocket.PlaybackCommand.Play
        now = self._clock.set(playing, request.playback_speed, request.seek_time)
        return _state(now, now.jumps != jumps, request.request_id)

    @property
    def _running(self) -> websocket.WebSocketServer:
        if self._server is None:
            raise ValueError("the outlet is not open")
        return self._server

    def _channel(self, source: Source) -> foxglove.Channel:
        key = (source.topic, source.message_encoding, source.schema_name, source.schema_encoding, source.schema_data)
        if key not in self._channels:
            schema = foxglove.Schema(name=source.schema_name, encoding=source.schema_encoding, data=source.schema_data)
            self._channels[key] = foxglove.Channel(
                source.topic,
                schema=schema,
                message_encoding=source.message_encoding,
                context=self._context,
                metadata=dict(source.metadata),
            )
        return self._channels[key]


def _state(now: Playback, did_seek: bool, request_id: str | None) -> websocket.PlaybackState:
    status = websocket.PlaybackStatus.Paused
    if now.ended:
        status = websocket.PlaybackStatus.Ended
    elif now.playing:
        status = websocket.PlaybackStatus.Playing
    return websocket.PlaybackState(status, now.position_ns, now.rate, did_seek, request_id)
