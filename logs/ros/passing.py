"""Folders for what has to be unpacked or mended before it can be read, since nothing is written beside a recording."""

import shutil
import tempfile
import weakref
from pathlib import Path


class PassingFolder:
    """A new folder at `path`; it goes when this does, at the latest when the program ends."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="fieldloc-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)
