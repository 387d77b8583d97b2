"""The online estimator that keeps every place where the robot may be, and says how sure it is of each."""

from estimators.mixture.filter import MixtureFilter

__all__ = ["MixtureFilter"]
