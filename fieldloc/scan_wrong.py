"""How often nothing in a scan is what it seems to be, as the scans of a log themselves show."""

_BEFORE = 20.0  # scans that what is thought before is worth: the fewest that can show one in twenty


class WrongShare:
    """Counts the scans in which no landmark was where it should be from where the robot was."""

    def __init__(self) -> None:
        self._wrong = self._all = 0

    def count(self, wrong: bool) -> None:
        self._wrong, self._all = self._wrong + wrong, self._all + 1

    def share(self, before: float) -> float:
        """As counted so far, and never less than thought before: what went well says little of the next one."""
        return max(before, (before * _BEFORE + self._wrong) / (_BEFORE + self._all))
