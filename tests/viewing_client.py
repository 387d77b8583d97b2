"""A viewer for tests: the client's side of RFC 6455 and of the Foxglove WebSocket protocol, as far as needed."""

import base64
import json
import os
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType

SUBPROTOCOL = "foxglove.sdk.v1"
_TEXT, _BINARY, _CLOSE, _PING, _PONG = 1, 2, 8, 9, 10
_MESSAGE, _TIME, _PLAYBACK_STATE = 1, 2, 5  # opcodes of what the server sends in binary
_PLAYBACK_REQUEST = 3


@dataclass(frozen=True)
class Received:
    topic: str
    log_time_ns: int
    data: bytes


@dataclass(frozen=True)
class State:
    """status: 0 playing, 1 paused, 2 buffering, 3 ended."""

    status: int
    time_ns: int
    speed: float
    did_seek: bool
    request: str


@dataclass
class Client:
    """Connects at once; `receive` takes in what comes. subscribes: which topics to subscribe to when advertised."""

    port: int
    subscribes: Callable[[str], bool] = lambda topic: True
    info: dict = field(default_factory=dict)
    channels: dict[int, dict] = field(default_factory=dict)
    messages: list[Received] = field(default_factory=list)
    times_ns: list[int] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    statuses: list[dict] = field(default_factory=list)
    closed: bool = False

    def __enter__(self) -> "Client":
        self._topic_of: dict[int, str] = {}
        self._buffer = b""
        self._socket = socket.create_connection(("127.0.0.1", self.port), timeout=10)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\n\r\n".encode()
        )
        while b"\r\n\r\n" not in self._buffer:
            self._buffer += self._socket.recv(65536)
        head, self._buffer = self._buffer.split(b"\r\n\r\n", 1)
        assert head.startswith(b"HTTP/1.1 101"), head
        assert f"sec-websocket-protocol: {SUBPROTOCOL}".encode() in head.lower(), head
        self._take_frames()  # what came with the answer
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        self._socket.close()

    def receive(self, until: Callable[["Client"], bool], timeout_s: float = 20.0) -> None:
        """Until it is true. AssertionError after timeout_s, or when the server closes before."""
        deadline = time.monotonic() + timeout_s
        while not until(self):
            left_s = deadline - time.monotonic()
            assert left_s > 0, f"waited {timeout_s} s in vain; got {len(self.messages)} messages, {self.states}"
            assert not self.closed, "the server closed the connection"
            self._socket.settimeout(left_s)
            try:
                got = self._socket.recv(1 << 20)
            except TimeoutError:
                continue
            except ConnectionError:
                got = b""
            if not got:
                self.closed = True
                continue
            self._buffer += got
            self._take_frames()

    def drain(self, duration_s: float) -> None:
        """All that comes within a time."""
        end = time.monotonic() + duration_s
        while (left_s := end - time.monotonic()) > 0 and not self.closed:
            self._socket.settimeout(left_s)
            try:
                got = self._socket.recv(1 << 20)
            except TimeoutError:
                return
            except ConnectionError:
                got = b""
            self.closed = not got
            self._buffer += got
            self._take_frames()

    def control(self, play: bool, speed: float = 1.0, seek_ns: int | None = None, request: str = "r") -> None:
        """What the viewer's play button, speed menu and time slider send."""
        self._send(
            _BINARY,
            struct.pack("<BBfBQ", _PLAYBACK_REQUEST, 0 if play else 1, speed, seek_ns is not None, seek_ns or 0)
            + struct.pack("<I", len(request))
            + request.encode(),
        )

    def on(self, topic: str) -> list[Received]:
        return [message for message in self.messages if message.topic == topic]

    def channel(self, topic: str) -> dict:
        (channel,) = (channel for channel in self.channels.values() if channel["topic"] == topic)
        return channel

    def _take_frames(self) -> None:
        while len(self._buffer) >= 2:
            opcode, size, start = self._buffer[0] & 15, self._buffer[1] & 127, 2
            for marker, form in ((126, ">H"), (127, ">Q")):
                if size == marker:
                    start = 2 + struct.calcsize(form)
                    if len(self._buffer) < start:
                        return
                    (size,) = struct.unpack(form, self._buffer[2:start])
                    break
            if len(self._buffer) < start + size:
                return
            payload, self._buffer = self._buffer[start : start + size], self._buffer[start + size :]
            if opcode == _TEXT:
                self._take_text(json.loads(payload))
            elif opcode == _BINARY:
                self._take_binary(payload)
            elif opcode == _PING:
                self._send(_PONG, payload)
            elif opcode == _CLOSE:
                self.closed = True

    def _take_text(self, message: dict) -> None:
        if message["op"] == "serverInfo":
            self.info = message
        elif message["op"] == "status":
            self.statuses.append(message)
        elif message["op"] == "advertise":
            wanted = [channel for channel in message["channels"] if self.subscribes(channel["topic"])]
            for channel in message["channels"]:
                self.channels[channel["id"]] = channel
            for channel in wanted:
                self._topic_of[channel["id"]] = channel["topic"]
            subscriptions = [{"id": channel["id"], "channelId": channel["id"]} for channel in wanted]
            self._send(_TEXT, json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode())

    def _take_binary(self, payload: bytes) -> None:
        if payload[0] == _MESSAGE:
            subscription, time_ns = struct.unpack_from("<IQ", payload, 1)
            self.messages.append(Received(self._topic_of[subscription], time_ns, payload[13:]))
        elif payload[0] == _TIME:
            self.times_ns.append(struct.unpack_from("<Q", payload, 1)[0])
        elif payload[0] == _PLAYBACK_STATE:
            status, time_ns, speed, did_seek, size = struct.unpack_from("<BQfBI", payload, 1)
            self.states.append(State(status, time_ns, speed, bool(did_seek), payload[19 : 19 + size].decode()))

    def _send(self, opcode: int, payload: bytes) -> None:
        mask = os.urandom(4)
        size = len(payload)
        head = bytes([0x80 | opcode])
        head += bytes([0x80 | size]) if size < 126 else bytes([0x80 | 126]) + struct.pack(">H", size)
        self._socket.sendall(head + mask + bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload)))
