"""Stable-Baselines3 on many worlds: ``python 09_stable_baselines3.py``

Needs ``pip install 'avrgym[train]'``; arguments: steps, worlds. Other algorithms for vector
environments work too. Writes ``sb3.zip`` and the normaliser ``sb3.pkl``.
"""

import sys

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import avrgym  # noqa: F401  registers the environments
from avrgym.learning.stable_baselines import SB3VectorEnv

STEPS, WORLDS = map(int, sys.argv[1:] or (300_000, 32))


def environment(people: str, **options) -> VecNormalize:
    """Many worlds with normalised observations."""
    worlds = gym.make_vec("avrgym/FeedingJaco-v1", num_envs=WORLDS, people=people)
    return VecNormalize(VecMonitor(SB3VectorEnv(worlds.unwrapped)), **options)


training = environment("original", gamma=0.95)
model = PPO(
    "MlpPolicy",
    training,
    n_steps=200,
    batch_size=320,
    gamma=0.95,
    policy_kwargs={"net_arch": [64, 64]},
    device="cpu",
    seed=0,
)
model.learn(STEPS)
model.save("sb3.zip")
training.save("sb3.pkl")

others = environment("revised", training=False, norm_reward=False)
others.obs_rms = training.obs_rms
reward, spread = evaluate_policy(model, others, n_eval_episodes=WORLDS)
print(f"reward {reward:.1f} ± {spread:.1f} with a held-out population")
