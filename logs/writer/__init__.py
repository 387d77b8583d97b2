"""Logs out: an MCAP file that appears under its name only when it is whole."""

from logs.writer.logwriter import METADATA, LogWriter

__all__ = ["METADATA", "LogWriter"]
