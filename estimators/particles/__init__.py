"""Monte Carlo localization, as good as we can make it, and as published."""

from estimators.particles.filter import ParticleFilter

__all__ = ["ParticleFilter"]
