"""Logs in: what is in an MCAP file, and its messages as records in the order of their log time."""

from logs.reader.logfile import LogFile, Message, read_log

__all__ = ["LogFile", "Message", "read_log"]
