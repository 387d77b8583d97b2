"""Logs out of logs: cut, merge, repair. Messages are copied as they are; nobody decodes them.

Any format that fieldloc reads comes in, MCAP comes out, whole or not at all, and what is read is never touched. Log and
publish times, sequence numbers, schemas, channels' metadata, metadata records and attachments are kept.
"""

from logs.edit.copying import Summary
from logs.edit.cut import cut
from logs.edit.merge import merge
from logs.edit.repair import repair

__all__ = ["Summary", "cut", "merge", "repair"]
