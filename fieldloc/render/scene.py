"""What is on and around the field in a picture, beside the map: colours, things in the way, light, the sensor.

Colours are (blue, green, red) from 0 to 255. `Scene()` is clean: an even turf, white lines, white posts, no noise.
"""

from dataclasses import dataclass, field

Colour = tuple[float, float, float]

WHITE: Colour = (235.0, 235.0, 235.0)


@dataclass(frozen=True, slots=True)
class Ball:
    """On the ground at (x_m, y_m) of the field."""

    x_m: float
    y_m: float
    radius_m: float = 0.075
    colour: Colour = (225.0, 225.0, 225.0)
    patches: Colour = (60.0, 60.0, 60.0)


@dataclass(frozen=True, slots=True)
class Robot:
    """Upright, at (x_m, y_m) of the field: two legs, a trunk, a head."""

    x_m: float
    y_m: float
    heading_rad: float = 0.0
    height_m: float = 0.55
    legs: Colour = (215.0, 215.0, 215.0)
    trunk: Colour = (70.0, 70.0, 75.0)


@dataclass(frozen=True, slots=True)
class Person:
    """Standing at (x_m, y_m), beside the field."""

    x_m: float
    y_m: float
    height_m: float = 1.75
    trousers: Colour = (90.0, 60.0, 50.0)
    shirt: Colour = (60.0, 60.0, 180.0)


@dataclass(frozen=True, slots=True)
class Panel:
    """An upright rectangle over the ground from start to end (x_m, y_m each): a wall, a window, its frame, a banner."""

    start: tuple[float, float]
    end: tuple[float, float]
    low_m: float
    high_m: float
    colour: Colour


@dataclass(frozen=True, slots=True)
class Glare:
    """A patch of light (gain above 1) or shade (below) on the ground."""

    x_m: float
    y_m: float
    radius_m: float
    gain: float


@dataclass(frozen=True, slots=True)
class Turf:
    """The carpet: it ends border_m outside the outermost lines; floor: what lies beyond it.

    mown: amplitude of stripes of mown_m width each, light and dark, as a share of the colour; roughness: standard
    deviation of its texture, as a share; wear: how much of the white is gone where the paint is worn.
    seed: of the texture.
    """

    colour: Colour = (50.0, 130.0, 40.0)
    floor: Colour = (90.0, 95.0, 100.0)
    border_m: float = 0.7
    mown: float = 0.0
    mown_m: float = 1.0
    mown_along_rad: float = 0.0
    roughness: float = 0.0
    lines: Colour = WHITE
    wear: float = 0.0
    glares: tuple[Glare, ...] = ()
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Goals:
    """What the map does not say of the posts, its landmarks.

    colour: None: the first that the map names. height_m: of those whose height the map does not know. net: of thin
    threads, behind each crossbar. shading: how much darker a post's sides are, as a share. shadow_m: where on the
    ground the shadow of a post's top falls, seen from its foot; shadow_dark: how dark it is, as a share.
    """

    colour: Colour | None = None
    height_m: float = 1.2
    net: bool = False
    shading: float = 0.0
    shadow_m: tuple[float, float] = (0.0, 0.0)
    shadow_dark: float = 0.0


@dataclass(frozen=True, slots=True)
class Sensor:
    """From light to numbers.

    blur_px: standard deviation of the lens' blur; 0 is a lens that does not exist, and its pictures are jagged.
    motion_px: (u, v) by which the picture moved while it was exposed; the truth is that of the middle of the exposure.
    vignetting: darker by that share in the corners. exposure: gain on everything. rolling: how much of it, as a share,
    comes and goes from row to row, over rolling_rows, beginning with rolling_phase_rad. read_noise: standard deviation
    of the darkest pixels; shot_noise: that of what comes on top at 255.
    gamma: numbers go with light ** (1 / gamma); colours look as they are named. Above 1 what is bright looks wider by
    some tenths of a pixel, as in most cameras' pictures; 1: half way between two colours is where their edge is.
    """

    blur_px: float = 0.5
    motion_px: tuple[float, float] = (0.0, 0.0)
    vignetting: float = 0.0
    exposure: float = 1.0
    rolling: float = 0.0
    rolling_rows: float = 240.0
    rolling_phase_rad: float = 0.0
    read_noise: float = 0.0
    shot_noise: float = 0.0
    gamma: float = 1.0


@dataclass(frozen=True, slots=True)
class Scene:
    """ceiling: the colour behind everything. panels: the farthest first. contact_dark: how dark the ground is under
    robots and balls, as a share."""

    turf: Turf = field(default_factory=Turf)
    goals: Goals = field(default_factory=Goals)
    sensor: Sensor = field(default_factory=Sensor)
    balls: tuple[Ball, ...] = ()
    robots: tuple[Robot, ...] = ()
    people: tuple[Person, ...] = ()
    panels: tuple[Panel, ...] = ()
    ceiling: Colour = (150.0, 145.0, 140.0)
    contact_dark: float = 0.0
