"""The one error a user can cause: a bad file, configuration or log. The command line prints it and exits 1."""


class FieldlocError(Exception):
    """Message names the file, topic, stamp or option at fault and the way out."""
