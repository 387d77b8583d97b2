"""A mixture of found solutions that counts for less than one: its densities to the power of 1 / wider."""

from dataclasses import replace

import numpy as np

from fieldloc.covariance import log_peaks
from fieldloc.pose import FloatArray
from fieldloc.solution_mixture import SolutionMixture
from fieldloc.stacks import FactorStack, LandmarkStack, LineStack, PoseStack


def tempered(mixture: SolutionMixture, wider: float) -> SolutionMixture:
    """With the same ids. Between solutions, between poses and against the outlier every log odds is divided by `wider`:
    normal densities by covariances so much wider and peaks of the powered height, counts of false things and of things
    missed with them. So an image that is seen `wider` times over counts as one."""
    if wider == 1.0:
        return mixture
    stacks = tuple((_wider(stack, wider), _powered(stack, weights, wider)) for stack, weights in mixture.stacks)
    return replace(mixture, stacks=stacks, log_outlier=mixture.log_outlier / wider)


def _powered(stack: FactorStack, log_weights: FloatArray, wider: float) -> FloatArray:
    peak = log_peaks(stack.covariances)
    return np.asarray((log_weights + peak) / wider - peak + 0.5 * stack.covariances.shape[-1] * np.log(wider))


def _wider(stack: FactorStack, wider: float) -> FactorStack:
    match stack:
        case PoseStack() | LineStack() | LandmarkStack():
            return replace(stack, covariances=wider * stack.covariances)
    raise TypeError(f"cannot widen a stack of {type(stack).__name__}")
