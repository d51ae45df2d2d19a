"""Replay of failed episodes: training repeats them until they succeed.

A policy learns slowly from rare failures. For example, the arm traps the person's hand in one of a hundred initial
states. Training repeats such initial states to make them frequent (compare Jiang, Grefenstette and Rocktäschel,
"Prioritized level replay", ICML 2021).
"""

from collections.abc import Sequence

from avrgym.system import random_streams

FAILURE_FORCE_N = 12.0
"""Maximum mean force on the person. Episodes with a larger force are treated as failed, even if the task succeeded."""
MAX_STORED_EPISODES = 256
"""Maximum number of stored seeds. The oldest seeds are deleted first."""


class FailedEpisodeSampler:
    """Chooses the episodes of N worlds: new episodes, and episodes that failed before. A seed identifies each episode.

    ``failed_seeds`` contains the seeds of failed episodes, the newest at the end. ``num_repeated_episodes`` is the
    number of repeated episodes in the latest choice; they are in the first worlds.
    """

    def __init__(self, worlds: int, share: float, seed: int) -> None:
        """``share`` is the maximum fraction of the worlds that repeat failed episodes, 0 to 1. ``seed`` is the seed of
        the training run.
        """
        self.failed_seeds: list[int] = []
        self.num_repeated_episodes = 0
        self._worlds, self._max_repeated, self._seed = worlds, int(share * worlds), seed
        self._chosen: list[int] = []

    def choose_seeds(self, steps: int) -> list[int]:
        """Chooses the next episodes after ``steps`` environment steps. Returns their N seeds. They depend only on the
        state and ``steps``."""
        random = random_streams.make_failed_episode_rng(self._seed, steps)
        old = random.permutation(self.failed_seeds)[: self._max_repeated].tolist()
        new = random.integers(2**53, size=self._worlds - len(old)).tolist()
        self._chosen, self.num_repeated_episodes = [int(seed) for seed in old] + new, len(old)
        return self._chosen

    def store_failures(self, successes: Sequence[bool], forces_n: Sequence[float]) -> None:
        """Store the seeds of the chosen episodes that failed, and delete the seeds of those that succeeded.

        Args:
            successes: success of each episode (N,).
            forces_n: mean forces on the person (N,), newtons.
        """
        outcomes = zip(self._chosen, successes, forces_n, strict=True)
        failed = [seed for seed, success, force_n in outcomes if not success or force_n > FAILURE_FORCE_N]
        chosen = set(self._chosen)
        self.failed_seeds = ([seed for seed in self.failed_seeds if seed not in chosen] + failed)[
            -MAX_STORED_EPISODES:
        ]
