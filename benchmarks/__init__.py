"""What fieldloc costs, measured beside what others cost on the same data: python -m benchmarks NAME.

A figure is a ratio within one run, since microseconds are another machine's. Not part of the installed package.
"""
