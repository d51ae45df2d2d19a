"""RLlib's PPO over native worlds, and its weights as a policy: ``python 10_rllib.py``

Needs Ray's ``ray[rllib]`` and PyTorch; arguments: updates, worlds a runner, runners.
Writes ``rllib.safetensors`` for ``--policy``.
"""

import sys

import numpy as np
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

from avrgym.policies.trained_policies import Policy, PolicyMetadata

UPDATES, WORLDS, RUNNERS = map(int, sys.argv[1:] or (100, 64, 2))
ENVIRONMENT, STEPS = "avrgym/FeedingJaco-v1", 200 * WORLDS * max(1, RUNNERS)
config = PPOConfig().environment(
    f"avrgym:{ENVIRONMENT}", env_config={"people": "original", "autoreset_mode": "NextStep"}
)  # RLlib needs this mode
config.env_runners(
    num_env_runners=RUNNERS,
    num_envs_per_env_runner=WORLDS,
    gym_env_vectorize_mode="vector_entry_point",  # native worlds
)
config.rl_module(
    model_config=DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False)
)
config.training(
    lr=3e-4, gamma=0.97, lambda_=0.95, train_batch_size_per_learner=STEPS, minibatch_size=STEPS // 20
)
ray.init("local", include_dashboard=False, log_to_driver=False, configure_logging=False)
algorithm = config.build_algo()
for update in range(1, UPDATES + 1):
    episodes = algorithm.train()["env_runners"]
    print(f"{update * STEPS:9,} steps  reward {episodes.get('episode_return_mean', np.nan):7.1f}")
module = algorithm.get_module()
parts = [*module.encoder.actor_encoder.modules(), *module.pi.modules()]
layers = [part for part in parts if isinstance(part, torch.nn.Linear)]
joints = layers[-1].out_features // 2  # its last layer gives means, then deviations
weights, biases = ([getattr(layer, name).detach().numpy() for layer in layers] for name in ("weight", "bias"))
policy = Policy(
    weights=(*(weight.T for weight in weights[:-1]), weights[-1][:joints].T),
    biases=(*biases[:-1], biases[-1][:joints]),
    observation_mean=np.zeros(layers[0].in_features),
    observation_variance=np.ones(layers[0].in_features),
    observation_clip=1e6,  # RLlib does not normalise
    observation_epsilon=1e-12,
    action_std=0.0,
    metadata=PolicyMetadata(environment=ENVIRONMENT, people="original", steps=UPDATES * STEPS, seed=0),
)
observations = np.random.default_rng(0).normal(size=(100, layers[0].in_features)).astype(np.float32)
expected = module.forward_inference({"obs": torch.as_tensor(observations)})["action_dist_inputs"][:, :joints]
error = np.abs(policy.compute_mean_actions(observations) - expected.detach().numpy()).max()
print(f"largest difference from RLlib's own action: {error:.1e}")
policy.save("rllib.safetensors", overwrite=True)
ray.shutdown()
