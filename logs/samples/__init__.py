"""Small real logs that ship with the package (README.md says whose they are)."""

from importlib import resources
from pathlib import Path

SAMPLES = ("woods",)


def sample_path(name: str) -> Path:
    """The file of a sample; ValueError for a name that is none."""
    if name not in SAMPLES:
        raise ValueError(f"no sample '{name}'; there is {', '.join(SAMPLES)}")
    return Path(str(resources.files("logs.samples") / f"{name}.mcap"))
