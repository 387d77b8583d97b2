"""Time on disk and on the wire: schemas, reader, writer, importers, replay, evaluation, report."""
