"""Contact forces under jumping tracking: `make soak`."""

from pathlib import Path

from avrgym.tasks.registry import ENVIRONMENTS
from helpers.vr.teleporting_hands import IMPACT_N, PATTERNS, peak_force_n

SEEDS = 5


def test_jumping_poses_add_at_most_the_force_of_a_slow_impact(tmp_path: Path) -> None:
    """Trials of six seconds in all environments."""
    strongest_n, excess_n = 0.0, 0.0
    for environment in ENVIRONMENTS:
        for seed in range(SEEDS):
            place = tmp_path / f"{environment.replace('/', '-')}-{seed}"
            at_rest_n = peak_force_n(place / "rest", environment, seed, "rest", steps=60)
            for attack in PATTERNS:
                attacked_n = peak_force_n(place / attack, environment, seed, attack, steps=60)
                strongest_n, excess_n = max(strongest_n, attacked_n), max(excess_n, attacked_n - at_rest_n)
                assert attacked_n < at_rest_n + IMPACT_N, (environment, seed, attack)
    trials = len(ENVIRONMENTS) * SEEDS * len(PATTERNS)
    print(
        f"\n{trials} trials with teleporting heads and hands: at most {strongest_n:.0f} N on the person in any tick, "
        f"at most {excess_n:.0f} N more than at rest; allowed are {IMPACT_N:.0f} N more"
    )
