"""The profile across a post: background, post and background again, blurred, fitted to rows of pixels.

A round post is darker or lighter towards its sides than in its middle, and lit more from one side than from the other:
inside it is taken for a parabola, so that where light fades towards the edges the edges are not lost. Where blur has
the standard deviation s, what lies right of an edge l has at u the value

    E[p(y); y > l] = p(u) F(z) + p'(u) s f(z) + p''(u) s^2 (F(z) - z f(z)) / 2,   y ~ N(u, s^2), z = (u - l) / s

of a parabola p; F is the normal distribution and f its density.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from fieldloc.pose import FloatArray
from fieldloc.vision.turf import Mask

_ITERATIONS = 4
_BLUR_PX = 0.4, 4.0  # standard deviations that a fit may come to
_FARTHEST_PX, _FARTHEST = 3.0, 0.3  # an edge, from where it was thought to be; by the width of wide posts
_DAMPING = 1e-3
_UNKNOWNS = 8  # left, right, blur; both backgrounds; 1, x and x^2 inside


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """edges: (k, 2) left and right in the profiles' unit. variance: (k, 2) of them, from the residuals. good: (k,)."""

    edges: FloatArray
    variance: FloatArray
    good: Mask


def fit_profiles(values: FloatArray, at: FloatArray, width: FloatArray, flat: Mask) -> Profiles:
    """Edges of profiles (k, s) sampled at offsets (k, s), which are about at -width / 2 and width / 2, (k,).

    flat: (k,) where the inside is taken to be of one light all over, not a parabola.
    """
    half = 0.5 * width[:, None]
    state = np.concatenate([-half, half, np.ones_like(half)], axis=1)
    place = at / half
    reach = np.maximum(_FARTHEST_PX, 2.0 * _FARTHEST * half)
    free = np.ones((len(values), _UNKNOWNS))
    free[flat, 6:] = 0.0
    linear = np.zeros((len(values), 5))
    weight = np.ones_like(values)
    for step in range(_ITERATIONS):
        jacobian, z, density = _parts(at, place, half, state)
        basis = jacobian[:, 3:]
        basis[flat, 3:] = 0.0
        if step == 0:
            normal = basis @ basis.transpose(0, 2, 1) + 1e-6 * np.eye(5)
            linear = np.linalg.solve(normal, basis @ values[..., None])[..., 0] * free[:, 3:]
        _fill_in_moves(jacobian, z, density, half, state, linear)
        residual = values - (linear[:, None] @ basis)[:, 0]
        if step > 1:  # what is no step and no parabola counts little
            scale = 1.5 + 1.5 * np.mean(np.abs(residual), axis=1, keepdims=True)
            weight = 1.0 / (1.0 + (residual / scale) ** 2)
        weighted = jacobian * weight[:, None]
        system = weighted @ jacobian.transpose(0, 2, 1)
        diagonal = np.diagonal(system, axis1=1, axis2=2)
        damped = system + np.eye(_UNKNOWNS) * (_DAMPING * diagonal + 1e-6)[..., None]
        change = np.linalg.solve(damped, weighted @ residual[..., None])[..., 0] * free
        state = state + np.minimum(np.maximum(change[:, :3], -reach / 3.0), reach / 3.0)
        state[:, 2] = np.minimum(np.maximum(state[:, 2], _BLUR_PX[0]), _BLUR_PX[1])
        linear = linear + change[:, 3:]
    noise = (weight * residual**2).sum(axis=1) / np.maximum(weight.sum(axis=1) - _UNKNOWNS, 1.0)
    inverse = np.linalg.solve(system + np.eye(_UNKNOWNS) * (1e-6 * diagonal + 1e-9)[..., None], np.eye(_UNKNOWNS, 2))
    variance = np.diagonal(inverse, axis1=1, axis2=2) * noise[:, None]
    near = (np.abs(state[:, :2] - np.concatenate([-half, half], axis=1)) < reach).all(axis=1)
    good = near & np.isfinite(variance).all(axis=1) & (variance > 0.0).all(axis=1) & (state[:, 1] > state[:, 0])
    return Profiles(state[:, :2], variance, good)


def _parts(
    at: FloatArray, x: FloatArray, half: FloatArray, state: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(k, 8, s) a profile's derivatives, of which the last five are filled in: by both backgrounds, and by 1, x and x^2
    inside; and (k, 2, s) how many standard deviations of the blur places are beyond each edge, and the density there.

    x: (k, s) `at` in half widths (k, 1), which stay as they are when edges move.
    """
    out = np.empty((len(at), _UNKNOWNS, at.shape[1]))
    sigma = state[:, 2:3, None]
    spread = sigma / half[..., None]
    z = (at[:, None] - state[:, :2, None]) / sigma
    below = ndtr(z)
    density = np.exp(-0.5 * z * z) * (1.0 / math.sqrt(2.0 * math.pi))
    wide = spread * density
    blurred = x[:, None] * below + wide
    square = x[:, None] * (blurred + wide) + spread**2 * (below - z * density)
    out[:, 3], out[:, 4] = 1.0 - below[:, 0], below[:, 1]
    for n, part in enumerate((below, blurred, square)):
        out[:, 5 + n] = part[:, 0] - part[:, 1]
    return out, z, density


def _fill_in_moves(
    jacobian: FloatArray, z: FloatArray, density: FloatArray, half: FloatArray, state: FloatArray, linear: FloatArray
) -> None:
    """The first three of a profile's derivatives (k, 8, s): by left, right and blur."""
    edges, sigma = state[:, :2, None], state[:, 2:3, None]
    level = edges / half[..., None]
    inside = linear[:, 2:3, None] + (linear[:, 3:4, None] + linear[:, 4:5, None] * level) * level
    step = (inside - linear[:, :2, None]) * density / sigma
    jacobian[:, 0], jacobian[:, 1] = -step[:, 0], step[:, 1]
    step *= z
    jacobian[:, 2] = step[:, 1] - step[:, 0]
