"""The estimators by name."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from estimators.base import Estimator
from estimators.config import Config
from estimators.dead_reckoning import DeadReckoning
from estimators.ekf import Ekf
from estimators.mixture import MixtureFilter
from estimators.particles import ParticleFilter
from estimators.particles.presets import amcl_style, bhuman_style
from estimators.smoother import Smoother

ONLINE: Mapping[str, Callable[[Config], Estimator]] = MappingProxyType(
    {
        "dead-reckoning": DeadReckoning,
        "ekf": Ekf,
        "mixture": MixtureFilter,
        "particles": ParticleFilter,
        "amcl-style": amcl_style,
        "bhuman-style": bhuman_style,
    }
)
SMOOTHERS: Mapping[str, Callable[[Config], Smoother]] = MappingProxyType({"smooth": Smoother})
ALL: Mapping[str, Callable[[Config], Estimator]] = MappingProxyType({**ONLINE, **SMOOTHERS})
