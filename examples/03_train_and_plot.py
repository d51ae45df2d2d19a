"""Train a policy and plot its learning curve: ``python 03_train_and_plot.py [STEPS]``

Needs ``pip install 'avrgym[train]'``. Writes the folder ``trained`` and ``learning.png``. 300 000 steps take some
minutes; start with fewer.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from avrgym.learning.training import make_feedforward_configuration, train

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 300_000

configuration = make_feedforward_configuration("avrgym/FeedingJaco-v1", people="revised", steps=STEPS, seed=0)
policy = train(
    configuration,
    Path("trained"),
    report=lambda now: print(
        f"{now.num_timesteps:9,} steps  reward {now.reward_mean:7.1f}  {now.success_rate:4.0%}"
    ),
)
print(f"evaluated on the validation split: {policy.metadata.measured}")

steps, rewards, successes = zip(*policy.metadata.curve, strict=True)
figure, (above, below) = plt.subplots(2, sharex=True, figsize=(6, 5), layout="constrained")
above.plot(steps, rewards)
above.set_ylabel("reward of an episode")
below.plot(steps, [100.0 * success for success in successes])
below.set(xlabel="environment steps", ylabel="success, %", ylim=(0, 100))
figure.savefig("learning.png", dpi=150)
