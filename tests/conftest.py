"""Hypothesis draws the same examples every time: a test that fails for one person fails for all."""

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")
