"""How reliably things are seen: what the weights of a mixture's solutions rest on beside the geometry."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Detection:
    """landmark: probability that a landmark of a scan is seen that is well inside what the sensor has shown to cover,
    and behind nothing known; low, as people and other robots hide things too, and some codes cannot be read. post:
    probability that a goal post in sight and in range is seen; post_range_m: up to where that holds, beyond it a post
    that is not seen says less, and at half as far again nothing. clutter: of a thing seen, that it is none of the
    map's; false_post, false_line: the same of what an image shows, where people, circles and carpets' borders pass for
    posts and lines. nothing_right: of an image or scan, that nothing in it is what it seems to be.

    ValueError for a probability that leaves no doubt, and a range that is none.
    """

    post: float = 0.7
    landmark: float = 0.3
    clutter: float = 0.02
    nothing_right: float = 0.05
    post_range_m: float = 4.5
    false_post: float = 0.1
    false_line: float = 0.05

    def __post_init__(self) -> None:
        for name in ("post", "landmark", "clutter", "nothing_right", "false_post", "false_line"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}, must be above 0 and below 1")
        if not self.post_range_m > 0.0:
            raise ValueError(f"post_range_m is {self.post_range_m}, must be positive")
