"""Published particle filters by name, on our likelihoods: their algorithm and parameters, none of their code.

"-style" as the likelihood is not theirs: what is seen is posts, lines and landmarks, not laser beams.
"""

import numpy as np

from estimators.config import Config
from estimators.particles.classic import Classic, ClassicMcl
from estimators.particles.few import Few, FewSamples


def amcl_style(config: Config) -> ClassicMcl:
    """ROS 2's AMCL with the parameters of nav2_bringup (ros-navigation/navigation2, nav2_bringup/params/
    nav2_params.yaml): 500 to 2000 particles, pf_err 0.05, pf_z 0.99, alpha1..4 0.2, z_hit 0.5, z_rand 0.5, updates
    after 0.25 m or 0.2 rad, resample_interval 1, histogram bins of 0.5 m and 10 degrees.

    Recovery is off there (both alphas 0); here it has 0.001 and 0.1, which others set for it (Beluga's defaults), as
    without it a kidnapped robot is never found. pf_z goes into Fox's formula as it does there: as the quantile itself.
    """
    return ClassicMcl(
        config,
        Classic(
            min_count=500,
            max_count=2000,
            kld_error=0.05,
            kld_quantile=0.99,
            bin_m=0.5,
            bin_rad=np.pi / 18,
            alphas=(0.2, 0.2, 0.2, 0.2),
            hit=0.5,
            random_share=0.5,
            recovery=(0.001, 0.1),
            min_move_m=0.25,
            min_turn_rad=0.2,
            resample_every=1,
        ),
    )


def bhuman_style(config: Config) -> FewSamples:
    """B-Human's self-locator (bhuman/BHumanCodeRelease, Config/Scenarios/Default/selfLocator.cfg): 12 samples, each
    with a Gaussian of its own, resampled by validity (a running mean over 60 frames, base weight 0.1), the worst
    replaced by a pose from what is seen once six observations agree on it and the estimate is 1.5 m or 0.5 rad from it
    and from its mirror image.

    Theirs are unscented Kalman filters; here they are extended ones, on the likeliest solution near each sample. Theirs
    start at known places beside the field; here at the solutions of the first observation that has any.
    """
    return FewSamples(
        config,
        Few(
            samples=12,
            frames_per_s=60.0,
            sigma_process=(0.002, 0.002, 0.002),
            odometry=(0.2, 0.2, 0.3),
            translation_noise=2.0,
            turn_noise_per_rad=0.25,
            turn_noise_per_m=0.5,
            sigma_reset=(0.5, 0.5, float(np.radians(17.0))),
            base_validity=0.1,
            validity_frames=60,
            observations_for_reset=6,
            reset_m=1.5,
            reset_rad=0.5,
            stability=1.1,
        ),
    )
