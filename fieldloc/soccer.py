"""A soccer field from the numbers in its rule book's table."""

from dataclasses import dataclass

import numpy as np

from fieldloc.pose import FloatArray


@dataclass(frozen=True, slots=True)
class SoccerDimensions:
    """Named as in the RoboCup rule books, metres.

    Lengths run along x (goal to goal), widths along y, both to the middles of the lines. `goal_width_m` is between the
    insides of the posts. A field without penalty areas leaves both of their numbers at zero.
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

    def lines(self) -> FloatArray:
        """(n, 2, 2): touch lines, goal lines, halfway line, then each area's front and sides, opponent's before own.

        Penalty marks and the centre mark are left out: at 10 to 25 cm they are spots, too short to be lines.
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

    def posts(self) -> dict[str, FloatArray]:
        """Label -> (2,) middle of each goal post. It stands on the goal line's middle; left is y > 0 at both goals."""
        x, y = self.field_length_m / 2, (self.goal_width_m + self.post_diameter_m) / 2
        return {
            "post_opponent_left": np.array([x, y]),
            "post_opponent_right": np.array([x, -y]),
            "post_own_left": np.array([-x, y]),
            "post_own_right": np.array([-x, -y]),
        }
