"""A soccer field from the numbers in its rule book's table."""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray
from fieldloc.toml_table import TomlTable


@dataclass(frozen=True, slots=True)
class SoccerDimensions:
    """Named as in the RoboCup rule books, metres.

    Lengths run along x (goal to goal), widths along y, both to the middles of the lines. `goal_width_m` is between the
    insides of the posts, `goal_height_m` from the ground to the lower edge of the crossbar. A field without penalty
    areas leaves both of their numbers at zero, one without marks or crossbars theirs.
    """

    field_length_m: float
    field_width_m: float
    goal_width_m: float
    goal_area_length_m: float
    goal_area_width_m: float
    centre_circle_diameter_m: float
    penalty_area_length_m: float = 0.0
    penalty_area_width_m: float = 0.0
    post_diameter_m: float = 0.1
    goal_height_m: float = 0.0
    penalty_mark_distance_m: float = 0.0

    def lines(self) -> FloatArray:
        """(n, 2, 2): touch lines, goal lines, halfway line, then each area's front and sides, opponent's before own.

        Penalty marks and the centre mark are `marks`: at 10 to 25 cm they are spots, too short to be lines.
        """
        x, y = self.field_length_m / 2, self.field_width_m / 2
        ends = [
            [[-x, y], [x, y]],
            [[-x, -y], [x, -y]],
            [[x, -y], [x, y]],
            [[-x, -y], [-x, y]],
            [[0.0, -y], [0.0, y]],
        ]
        areas = [
            (self.goal_area_length_m, self.goal_area_width_m / 2),
            (self.penalty_area_length_m, self.penalty_area_width_m / 2),
        ]
        for length, side in areas:
            if length == 0.0:
                continue
            for goal in (x, -x):
                front = goal - np.copysign(length, goal)
                ends += [
                    [[front, -side], [front, side]],
                    [[front, side], [goal, side]],
                    [[front, -side], [goal, -side]],
                ]
        return np.array(ends)

    def circles(self) -> FloatArray:
        """(1, 3): the centre circle as x, y, radius of its line's middle."""
        return np.array([[0.0, 0.0, self.centre_circle_diameter_m / 2]])

    def marks(self) -> FloatArray:
        """(3, 2): the opponent's penalty mark, the own, the centre mark; (0, 2) on a field without penalty marks."""
        if self.penalty_mark_distance_m == 0.0:
            return np.zeros((0, 2))
        x = self.field_length_m / 2 - self.penalty_mark_distance_m
        return np.array([[x, 0.0], [-x, 0.0], [0.0, 0.0]])

    @property
    def post_height_m(self) -> float:
        """Of the crossbar's upper edge, where the post ends; 0 without a crossbar. The bar is as thick as the posts."""
        return self.goal_height_m + self.post_diameter_m if self.goal_height_m else 0.0

    def posts(self) -> dict[str, FloatArray]:
        """Label -> (2,) middle of each goal post. It stands on the goal line's middle; left is y > 0 at both goals."""
        x, y = self.field_length_m / 2, (self.goal_width_m + self.post_diameter_m) / 2
        return {
            "post_opponent_left": np.array([x, y]),
            "post_opponent_right": np.array([x, -y]),
            "post_own_left": np.array([-x, y]),
            "post_own_right": np.array([-x, -y]),
        }


def read_soccer(table: TomlTable) -> SoccerDimensions:
    """The dimensions in the table [soccer] of a map's file."""
    dimensions = SoccerDimensions(
        field_length_m=table.number("field_length_m", positive=True),
        field_width_m=table.number("field_width_m", positive=True),
        goal_width_m=table.number("goal_width_m", positive=True),
        goal_area_length_m=table.number("goal_area_length_m", positive=True),
        goal_area_width_m=table.number("goal_area_width_m", positive=True),
        centre_circle_diameter_m=table.number("centre_circle_diameter_m", positive=True),
        penalty_area_length_m=table.number("penalty_area_length_m", 0.0),
        penalty_area_width_m=table.number("penalty_area_width_m", 0.0),
        post_diameter_m=table.number("post_diameter_m", 0.1, positive=True),
        goal_height_m=table.number("goal_height_m", 0.0),
        penalty_mark_distance_m=table.number("penalty_mark_distance_m", 0.0),
    )
    table.finish()
    if (dimensions.penalty_area_length_m == 0.0) != (dimensions.penalty_area_width_m == 0.0):
        table.fail("penalty_area_length_m", "a penalty area needs its length and its width")
    if dimensions.penalty_mark_distance_m >= dimensions.field_length_m / 2:
        table.fail("penalty_mark_distance_m", "the marks lie on the other half")
    return dimensions
