"""Random actions, the oracle and a trained policy: ``python 02_random_oracle_trained.py [EPISODES]``

The first part calls ``evaluate``. The second part loads a policy and steps it.
"""

import sys

import gymnasium as gym
import numpy as np

import avrgym  # noqa: F401  registers the environments
from avrgym.learning.evaluation import evaluate
from avrgym.policies.trained_policies import Policy, find_policy_file

ENVIRONMENT = "avrgym/FeedingJaco-v1"
EPISODES = int(sys.argv[1]) if len(sys.argv) > 1 else 20

for name in ("random", "oracle", "revised"):
    row = evaluate(ENVIRONMENT, name, people="revised", episodes=EPISODES, seed=0)
    low, high = row.success_ci95
    print(
        f"{name:8} success {row.success_rate:4.0%} [{low:.0%}, {high:.0%}]"
        f"  reward {row.reward_mean:7.1f}  force {row.force_mean_newton:.1f} N"
    )

policy = Policy.load(find_policy_file("revised", ENVIRONMENT))
generators = [np.random.default_rng(0)]  # one generator for each row of observations
env = gym.make(ENVIRONMENT, people="revised")
observation, info = env.reset(seed=0)
ended = False
while not ended:
    action = policy.act(observation[None], generators)[0]
    observation, reward, _, ended, info = env.step(action)
print(f"one episode after {policy.metadata.steps:,} training steps: success {info['success']}")
env.close()
