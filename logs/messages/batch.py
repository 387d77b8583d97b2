"""Many messages of one kind at once: what `logs.messages.fields` reads one by one, at a fifth of the price.

msgspec reads the text, straight into the types that are stated here, and the checks are done on all messages together.
It is strict about what it takes: whatever it does not take, or what a check has doubts about, is `Odd`, and then the
whole batch is for the readers that go one by one, which alone say what is wrong. No two records share numbers, so that
a change to one changes no other.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate, pairwise, repeat
from typing import TypeVar

import msgspec
import numpy as np

from fieldloc.pose import FloatArray
from logs.messages.symmetric import are_covariances

T = TypeVar("T")
Pair = tuple[float, float]
_TOGETHER = 16  # arrays in one piece of memory
_FRAMES = {n: b"[" + b",".join([b"[" + b"," * (n - 1) + b"]"] * n) + b"]" for n in (2, 3, 4)}  # of an n x n matrix
_NUMBERS_AND_SPACE = b"0123456789+-.eE \t\r\n"
_BRACKETS_TO_SPACE = bytes.maketrans(b"[]", b"  ")
_read_numbers = msgspec.json.Decoder(list[float]).decode


class Odd(Exception):
    """A batch in which something is not as nearly always."""


class Message(msgspec.Struct, forbid_unknown_fields=True, gc=False):
    """Base of the types. A number that must be an integer is an `object`: msgspec would take 1.0 for one."""


def reader(kind: type[T]) -> Callable[[Sequence[bytes]], list[T]]:
    """What reads messages of one type, in order; raises Odd."""
    decode = msgspec.json.Decoder(kind).decode

    def read(datas: Sequence[bytes]) -> list[T]:
        with _odd():
            return [*map(decode, datas)]

    return read


def records(kind: type[T], *columns: Iterable[object]) -> list[T]:
    """Frozen dataclasses with slots, all fields by column in their order: as by calling `kind`, at half the price."""
    if "__post_init__" in vars(kind) or len(columns) != len(slots := kind.__dict__["__slots__"]):
        return [*map(kind, *columns)]
    first = [*columns[0]]
    out = [*map(object.__new__, repeat(kind, len(first)))]
    for name, column in zip(slots, (first, *columns[1:]), strict=True):
        deque(map(vars(kind)[name].__set__, out, column), maxlen=0)  # a frozen one's own way is twice as long
    return out


def stamps(values: Sequence[object]) -> list[int]:
    """The same, if all are whole numbers that MCAP's times can be."""
    whole = [value for value in values if type(value) is int]
    if len(whole) != len(values) or (whole and not 0 <= min(whole) <= max(whole) < 2**63):
        raise Odd
    return whole


def positive(values: Sequence[float]) -> Sequence[float]:
    """The same, if all are above 0."""
    if values and min(values) <= 0.0:
        raise Odd
    return values


def arrays(numbers: Iterable[float], *shape: int) -> list[FloatArray]:
    """As many arrays of that shape as the numbers make."""
    return apart(block(numbers, *shape))


def block(numbers: Iterable[float], *shape: int) -> FloatArray:
    """(n, *shape) of all the numbers."""
    return np.fromiter(numbers, np.float64).reshape(-1, *shape)


def apart(stack: FloatArray) -> list[FloatArray]:
    """The rows of a stack, none of which keeps more than a few others in memory. One by one is four times the price."""
    return [row for i in range(0, len(stack), _TOGETHER) for row in stack[i : i + _TOGETHER].copy()]


def pieces(stack: FloatArray, sizes: Sequence[int]) -> list[FloatArray]:
    """The stack cut into pieces of these many rows each; they are kept in memory as those of `apart` are."""
    out: list[FloatArray] = []
    start = 0
    for i in range(0, len(sizes), _TOGETHER):
        few = sizes[i : i + _TOGETHER]
        ends = [*accumulate(few, initial=0)]
        kept = stack[start : start + ends[-1]].copy()
        out += [kept[a:b] for a, b in pairwise(ends)]
        start += ends[-1]
    return out


def covariances(texts: Sequence[msgspec.Raw], size: int) -> list[FloatArray]:
    """(size, size) each, positive semidefinite."""
    return apart(_covariances([*map(bytes, texts)], size))


def covariances_or_none(texts: Sequence[msgspec.Raw], size: int) -> list[FloatArray | None]:
    """The same, None for a null."""
    said = [*map(bytes, texts)]
    told = [text for text in said if text != b"null"]
    if not told:
        return [None] * len(said)
    read = iter(apart(_covariances(told, size)))
    return [None if text == b"null" else next(read) for text in said] if len(told) < len(said) else [*read]


def definite_covariances(texts: Sequence[msgspec.Raw], size: int) -> FloatArray:
    """(n, size, size), each positive definite; mostly another one each time."""
    return _checked([*map(bytes, texts)], size, definite=True)


def _covariances(texts: Sequence[bytes], size: int) -> FloatArray:
    """(n, size, size). A robot mostly states one covariance all day: what is said twice is read once."""
    number = {text: i for i, text in enumerate(dict.fromkeys(texts))}
    table = _checked([*number], size, definite=False)
    return table if len(table) == len(texts) else table[[number[text] for text in texts]]


def _checked(texts: Sequence[bytes], size: int, definite: bool) -> FloatArray:
    """All their numbers as one list, once the rest of the text is just the brackets and commas of such matrices."""
    joined = b",".join(texts)
    if joined.translate(None, _NUMBERS_AND_SPACE) != b",".join([_FRAMES[size]] * len(texts)):
        raise Odd
    with _odd():
        stack = block(_read_numbers(b"[" + joined.translate(_BRACKETS_TO_SPACE) + b"]"), size, size)
    if not np.all(are_covariances(stack, definite)):
        raise Odd
    return stack


@contextmanager
def _odd() -> Iterator[None]:
    try:
        yield
    except (msgspec.MsgspecError, ValueError, RecursionError):  # ValueError: text that is not UTF-8
        raise Odd from None
