"""Episodes that went badly and that training begins again, until they go well.

What is rare is learned slowly: one start in a hundred from which an arm jams the person's hand. Begun again and again
it is rare no longer (compare Jiang, Grefenstette and Rocktäschel, "Prioritized level replay", ICML 2021).
"""

from collections.abc import Sequence

import numpy as np

HARD_FORCE_N = 12.0
"""With more than this on the person, in the mean over its steps, an episode went badly though it may have succeeded."""
KEPT = 256
"""How many episodes are remembered; older ones make room."""


class HardEpisodes:
    """Chooses the episodes that N worlds begin together; each is known by the seed that it is drawn from.

    ``kept`` are the seeds of those that went badly when they ran last, the latest last. Of those chosen last the first
    ``again`` had gone badly before.
    """

    def __init__(self, worlds: int, share: float, seed: int) -> None:
        """``share`` of the worlds, at most, begin episodes again; ``seed`` decides which, and all new ones."""
        self.kept: list[int] = []
        self.again = 0
        self._worlds, self._most_again, self._seed = worlds, int(share * worlds), seed
        self._chosen: list[int] = []

    def choose(self, steps: int) -> list[int]:
        """Seeds (N,) of the episodes to begin after so many environment steps; the same again if asked again."""
        random = np.random.default_rng([self._seed, 3, steps])
        old = random.permutation(self.kept)[: self._most_again].tolist()
        new = random.integers(2**53, size=self._worlds - len(old)).tolist()
        self._chosen, self.again = [int(seed) for seed in old] + new, len(old)
        return self._chosen

    def judge(self, successes: Sequence[bool], forces_n: Sequence[float]) -> None:
        """Keep of the chosen episodes those that went badly, and only those.

        Args:
            successes: whether each (N,) succeeded.
            forces_n: mean forces on the person (N,), newtons.
        """
        outcomes = zip(self._chosen, successes, forces_n, strict=True)
        bad = [seed for seed, success, force_n in outcomes if not success or force_n > HARD_FORCE_N]
        chosen = set(self._chosen)
        self.kept = ([seed for seed in self.kept if seed not in chosen] + bad)[-KEPT:]
