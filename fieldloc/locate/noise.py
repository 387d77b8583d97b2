"""How far what is seen may be off what should be seen: the detector's noise, the lens', the map's."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldloc.locate.cameras import IntArray
from fieldloc.locate.settings import LocateSettings
from fieldloc.locate.shape import Shape
from fieldloc.locate.sight import Sight
from fieldloc.pose import FloatArray

_PAINTED = 0.12  # share by which the widths of all of a field's lines are off
_UNEVEN = 0.05  # share by which a line's width changes along it
_LEAST_WIDTH_PX = 2.0  # of a line whose width says how far it is: thinner ones are all blur
_BLUR_PX = 0.5  # by which light and a lens make white wider than it is
_THREAD_PX2 = 2.0  # standard deviation of THREAD_PX squared, from camera to camera
_THIN_PX2 = 3.0  # by which a thin post is wider than it is, times its width
_SIDES = np.array([0.5, 0.5, -0.5, -0.5])  # of a post's four ends, for each pixel of width
_FOOT_PX = 0.2  # by which a foot's own shade, and the turf before it, move it down or up
_TWICE_PX = 3.0  # across, a foot is where the post's edges are: that is seen once
_NOTHING = 1e6


@dataclass(frozen=True)
class Noise:
    """widen_px: how much farther off everything may be than noise makes it, while states are still rough.
    amounts: (a,) of the model's noise, as variances; each in turn for so many states, or one for all."""

    sight: Sight
    shape: Shape
    settings: LocateSettings
    widen_px: float = 0.0
    amounts: FloatArray | None = None

    def _of(self, map_px: FloatArray) -> FloatArray:
        """Of (k, ...)."""
        model = self.settings.model_px**2 + map_px * map_px
        if self.amounts is None:
            return model + self.widen_px**2
        by_amount = model.reshape(-1, len(self.amounts), *model.shape[1:])
        by_amount = by_amount * self.amounts.reshape(-1, *(1,) * (model.ndim - 1)) + self.widen_px**2
        return by_amount.reshape(model.shape)

    def of_lines(self, px_per_m: FloatArray) -> FloatArray:
        """(k, l, 2, ...) px^2 of the model alone."""
        return self._of(self.settings.map_m * px_per_m)

    def at(self, rows: IntArray, px_per_m: FloatArray) -> FloatArray:
        """(n, 2) px^2 of the model alone, of states (n,)."""
        map_px = self.settings.map_m * px_per_m
        model = self.settings.model_px**2 + map_px * map_px
        if self.amounts is not None:
            model *= self.amounts[rows % len(self.amounts), None]
        return model + self.widen_px**2

    def of_circle(self, px_per_m: FloatArray, alike: float = 1.0) -> FloatArray:
        """(k, c) px^2 of points (k, c) of which so many are off by the model's noise together."""
        return alike * self._of(self.settings.map_m * px_per_m) + self.sight.circle_sigmas**2

    @cached_property
    def of_widths(self) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
        """Of which lines a width says how far they are (l,); variance of its logarithm at both ends (l, 2), of what is
        not common to all lines, and of what is."""
        sight = self.sight
        known = sight.widths > _LEAST_WIDTH_PX  # no NaN is
        own = np.full(known.shape, _NOTHING)
        width2 = sight.widths[known] ** 2
        noise_px2 = sight.width_sigmas[known] ** 2 + _BLUR_PX**2 + self.widen_px**2
        own[known] = _UNEVEN**2 + noise_px2 / width2
        common = np.full(known.shape, _PAINTED**2)
        common[known] += (0.5 * _THREAD_PX2 / width2) ** 2
        return np.asarray(known.any(axis=1)), own, common

    def whitening_of_posts(self, count: int) -> FloatArray:
        """(k, p, 6, 6) or (1, p, 6, 6) makes white noise of a post's six numbers of so many states."""
        if self.amounts is None:
            return self._post_whitening
        return np.tile(self._post_whitening, (count // len(self.amounts), 1, 1, 1))

    @cached_property
    def _post_whitening(self) -> FloatArray:
        """(a, p, 6, 6); the numbers of a foot that is not seen are left as zero."""
        sight = self.sight
        diameter = 2.0 * float(np.mean(self.shape.radii)) if len(self.shape.radii) else 0.1
        map_px = self.settings.map_m * sight.post_widths / diameter
        amounts = np.ones(1) if self.amounts is None else self.amounts
        model = amounts[:, None] * (self.settings.model_px**2 + map_px**2) + self.widen_px**2
        out = np.zeros((*model.shape, 6, 6))
        thin = (_THIN_PX2 / np.maximum(sight.post_widths, 1.0)) ** 2
        own = sight.post_noise + thin[:, None, None] * np.outer(_SIDES, _SIDES)
        out[..., :4, :4] = own + model[..., None, None] * np.eye(4)
        foot = sight.feet.noise + np.diag([_TWICE_PX, _FOOT_PX]) ** 2 + model[..., None, None] * np.eye(2)
        out[..., 4:, 4:] = np.where(sight.feet.known[:, None, None], foot, np.eye(2))
        return np.asarray(np.linalg.inv(np.linalg.cholesky(out)))
