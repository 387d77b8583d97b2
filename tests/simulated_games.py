"""Games without a file, for the tests of what they are made of."""

from dataclasses import replace

import numpy as np

from fieldloc.field import load_field
from logs.simulate.game import Game, play
from logs.simulate.scenario import Scenario, load_scenario

IDEAL = load_scenario("ideal")
QUIET = load_scenario("quiet")
KIDSIZE = load_field("kidsize")


def game(scenario: Scenario = IDEAL, seed: int = 0, **changes: object) -> Game:
    """The scenario played; `changes` are sections or values in place of the scenario's."""
    scenario = replace(scenario, **changes)  # type: ignore[arg-type]
    return play(scenario, load_field(scenario.field), seed)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)
