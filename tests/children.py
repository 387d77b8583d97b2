"""Programs that tests start."""

import signal


def interruptible() -> None:
    """preexec_fn of a program that shall end by Ctrl-C: one that was started in the background would not hear it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
