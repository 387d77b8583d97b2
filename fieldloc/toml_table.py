"""Typed reading of a TOML table: every mistake becomes one FieldlocError that names the file and the key."""

import sys
import tomllib
from collections.abc import Mapping
from typing import Never, TypeGuard

import numpy as np

from fieldloc.errors import FieldlocError
from fieldloc.pose import FloatArray


class TomlTable:
    """One table of a file. Read what it may hold, then `finish`: a key that nothing asked for is a mistake too."""

    def __init__(self, values: Mapping[str, object], source: str, prefix: str = "") -> None:
        self._values = values
        self._source = source
        self._prefix = prefix
        self._asked: list[str] = []

    @classmethod
    def parse(cls, text: str, source: str) -> "TomlTable":
        """The file's top table; `source` is how messages name the file."""
        return cls(read_toml(text, source), source)

    def fail(self, key: str, problem: str) -> Never:
        """Raise about the key."""
        raise FieldlocError(f"{self._source}: {self._prefix}{key}: {problem}")

    def has(self, key: str) -> bool:
        """Whether the key is given."""
        self._asked.append(key)
        return key in self._values

    def string(self, key: str) -> str:
        """A string that is not empty."""
        value = self._get(key)
        if not isinstance(value, str) or not value.strip():
            self.fail(key, f"needs a name in quotes, got {value!r}")
        return value

    def number(self, key: str, default: float | None = None, *, positive: bool = False) -> float:
        """A finite number >= 0, or > 0; `default` where the key is missing, an error without one."""
        if default is not None and not self.has(key):
            return default
        value = self._get(key)
        need = "above 0" if positive else "of at least 0"
        if not _is_number(value) or value < 0.0 or (positive and value == 0.0):
            self.fail(key, f"needs a number {need}, got {value!r}")
        return float(value)

    def signed(self, key: str, default: float | None = None) -> float:
        """A finite number; `default` where the key is missing, an error without one."""
        if default is not None and not self.has(key):
            return default
        value = self._get(key)
        if not _is_number(value):
            self.fail(key, f"needs a number, got {value!r}")
        return float(value)

    def flag(self, key: str, default: bool) -> bool:
        """true or false."""
        if not self.has(key):
            return default
        value = self._get(key)
        if not isinstance(value, bool):
            self.fail(key, f"needs true or false, got {value!r}")
        return value

    def strings(self, key: str, what: str) -> tuple[str, ...]:
        """A string that is not empty, or a list of such; `what` tells the user."""
        value = self._get(key)
        items = value if isinstance(value, list) else [value]
        strings = tuple(item for item in items if isinstance(item, str) and item)
        if len(strings) < len(items):
            self.fail(key, f"needs {what}, got {value!r}")
        return strings

    def rows(self, key: str, what: str) -> list[tuple[str, ...]]:
        """A list of lists of strings, none where the key is missing; `what` tells the user."""
        value = self._values.get(key, []) if self.has(key) else []
        if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
            self.fail(key, f"needs {what}, got {value!r}")
        if not all(isinstance(item, str) and item for row in value for item in row):
            self.fail(key, f"needs {what}, got {value!r}")
        return [tuple(row) for row in value]

    def array(self, key: str, shape: tuple[int, ...], what: str) -> FloatArray:
        """Nested lists of finite numbers as an array; -1 in the shape stands for any length, `what` tells the user."""
        value = self._get(key)
        flat = _flatten(value)
        if flat is None:
            self.fail(key, f"needs {what}, got {value!r}")
        if shape[0] == -1 and not flat:
            return np.zeros((0, *shape[1:]))
        try:
            array = np.array(value, dtype=np.float64)
        except ValueError:
            self.fail(key, f"needs {what}; its lists have different lengths")
        if array.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
            self.fail(key, f"needs {what}, got {value!r}")
        return array

    def table(self, key: str) -> "TomlTable":
        """The table [key]."""
        value = self._get(key)
        if not isinstance(value, Mapping):
            self.fail(key, f"needs a table [{self._prefix}{key}], got {value!r}")
        return TomlTable(value, self._source, f"{self._prefix}{key}.")

    def tables(self, key: str) -> list["TomlTable"]:
        """The tables [[key]]; none where there are none."""
        if not self.has(key):
            return []
        value = self._get(key)
        if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
            self.fail(key, f"needs tables [[{self._prefix}{key}]], got {value!r}")
        return [TomlTable(item, self._source, f"{self._prefix}{key}[{i}].") for i, item in enumerate(value)]

    def finish(self) -> None:
        """Raise if the table holds a key that was never asked for."""
        for key in self._values:
            if key not in self._asked:
                self.fail(key, f"unknown key; known here are {', '.join(sorted(set(self._asked)))}")

    def _get(self, key: str) -> object:
        if not self.has(key):
            self.fail(key, "missing")
        return self._values[key]


def read_toml(text: str, source: str) -> dict[str, object]:
    """The file's top table as it is; FieldlocError where there is none."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: bad TOML, and integers of too many digits
        raise FieldlocError(f"{source}: not valid TOML: {error}") from None


def _is_number(value: object) -> TypeGuard[float]:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    # an integer can be too large for any float
    return abs(value) <= sys.float_info.max


def _flatten(value: object) -> list[object] | None:
    """The numbers of nested lists; None if something else is in there."""
    if not isinstance(value, list):
        return None
    out: list[object] = []
    for item in value:
        inner = [item] if _is_number(item) else _flatten(item)
        if inner is None:
            return None
        out += inner
    return out
