"""Factors in, estimates out. Knows no file format; only the graph modules know gtsam."""
