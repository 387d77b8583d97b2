"""Data sets recorded by others, turned into logs."""

from logs.importers.result import Imported
from logs.importers.utias import import_utias
from logs.importers.woods import import_woods

__all__ = ["Imported", "import_utias", "import_woods"]
