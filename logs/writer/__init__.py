"""Logs out: an MCAP file that appears under its name only when it is whole."""

from logs.writer.logwriter import METADATA, ROS2, LogWriter

__all__ = ["METADATA", "ROS2", "LogWriter"]
