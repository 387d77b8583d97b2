"""How everything that was observed can be read: one discrete choice for each observation."""

from dataclasses import dataclass

from fieldloc.mixture import IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ModeSequence:
    """One way to read everything observed since the start.

    log_weight: log of its probability among those returned. choices: (t,) per observed mixture, in the order of
    `observe`, the id of the solution, -1 where nothing of it was right or nobody was there to see it.
    births: indices into the observed mixtures at which the hypothesis began: the first is the start, any later one
    means that the robot was found elsewhere. Empty for one that was told where it was and never lost.
    copy: which copy under the map's symmetries, 0 as the choices' poses are, i as moved by field.symmetries[i - 1].
    """

    log_weight: float
    choices: IntArray
    births: tuple[int, ...]
    copy: int
