"""The numbers of an evaluation as records, and as metrics.json's flat dictionary. `docs/metrics.md` defines them."""

from dataclasses import dataclass
from math import degrees


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Of the sizes of n errors; the unit is the error's."""

    rmse: float
    median: float
    mean: float
    max: float


@dataclass(frozen=True, slots=True)
class RelativeError:
    """RMSE of the motion between pairs of poses, with the number of pairs."""

    translation_rmse_m: float
    rotation_rmse_rad: float
    pairs: int


@dataclass(frozen=True, slots=True)
class Consistency:
    """Whether the covariances tell the truth.

    anees: mean NEES / 3, 1 when they do, above when too sure. anees_low, anees_high: where it lies with 95 % if they do
    and the `samples` errors are independent, which errors one after the other are not: a lower bound of the spread.
    within_3sigma: share of poses inside the 99.73 % ellipsoid.
    within_3sigma_axes: share with |error| <= 3 sigma in x, in y, in heading.
    unusable: covariances that are not positive definite: no sample of anees, outside in within_3sigma.
    """

    anees: float
    anees_low: float
    anees_high: float
    samples: int
    within_3sigma: float
    within_3sigma_axes: tuple[float, float, float]
    unusable: int


@dataclass(frozen=True, slots=True)
class Metrics:
    """Translation in metres, heading in radians; a part is None where the data cannot give it, never NaN.

    rpe_frame: between consecutive matched poses; None when there is one. rpe_metre: over a metre of the estimated
    path; None on a shorter one. consistency: None without a usable covariance.
    matched: pairs compared; estimates, truths: poses there were.
    truth_covered: share of the truth's time in which there are estimates.
    time_to_first_estimate_s: from the first true pose, 0 when the estimate was there first.
    """

    ate_m: ErrorStatistics
    heading_rad: ErrorStatistics
    rpe_frame: RelativeError | None
    rpe_metre: RelativeError | None
    consistency: Consistency | None
    matched: int
    estimates: int
    truths: int
    truth_covered: float
    time_to_first_estimate_s: float

    def to_dict(self) -> dict[str, float | int | None]:
        """Flat, JSON-ready, always the same keys; null where a part is None."""
        out: dict[str, float | int | None] = {}
        for name, value in _statistics(self.ate_m).items():
            out[f"ate_{name}_m"] = value
        for name, value in _statistics(self.heading_rad).items():
            out[f"heading_{name}_rad"] = value
            out[f"heading_{name}_deg"] = degrees(value)
        for kind, rpe in (("frame", self.rpe_frame), ("metre", self.rpe_metre)):
            out[f"rpe_{kind}_translation_rmse_m"] = rpe.translation_rmse_m if rpe else None
            out[f"rpe_{kind}_rotation_rmse_rad"] = rpe.rotation_rmse_rad if rpe else None
            out[f"rpe_{kind}_rotation_rmse_deg"] = degrees(rpe.rotation_rmse_rad) if rpe else None
            out[f"rpe_{kind}_pairs"] = rpe.pairs if rpe else 0
        out |= _consistency(self.consistency)
        out |= {
            "matched_poses": self.matched,
            "estimated_poses": self.estimates,
            "true_poses": self.truths,
            "truth_covered": self.truth_covered,
            "time_to_first_estimate_s": self.time_to_first_estimate_s,
        }
        return out


def _statistics(s: ErrorStatistics) -> dict[str, float]:
    return {"rmse": s.rmse, "median": s.median, "mean": s.mean, "max": s.max}


def _consistency(c: Consistency | None) -> dict[str, float | int | None]:
    x, y, heading = c.within_3sigma_axes if c else (None, None, None)
    return {
        "anees": c.anees if c else None,
        "anees_low": c.anees_low if c else None,
        "anees_high": c.anees_high if c else None,
        "anees_samples": c.samples if c else 0,
        "within_3sigma": c.within_3sigma if c else None,
        "within_3sigma_x": x,
        "within_3sigma_y": y,
        "within_3sigma_heading": heading,
        "unusable_covariances": c.unusable if c else None,
    }
