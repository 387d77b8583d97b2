"""How each record is written as JSON: one pair of functions and one JSON Schema a record, nothing about files."""
