"""A policy learned on random physics by PPO, then run as a controller like any other.

``pip install "..[rl]"`` in this folder, then::

    python learned_policy.py                      # some two minutes on two cores: policy.zip
    afl-mujoco compare rl.toml --controllers learned_policy:controller lqr adaptive --film

Every episode has other hardware: start, M(t), l(t), delay, noise and friction are drawn from
``[ranges]`` of ``rl.toml``. The policy depends on the version of every package, not only this one.
"""

from __future__ import annotations

from pathlib import Path

from afl_mujoco.simulation.gym_env.environment import CartPoleEnv, policy_controller

HERE = Path(__file__).parent
POLICY = HERE / "policy.zip"
SETTINGS = {"scenario": HERE / "rl.toml", "randomize": True, "force_limit": 32.0}


def train(steps: int = 200_000, file: Path = POLICY) -> None:
    """Learn a policy and save it."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    environments = make_vec_env(CartPoleEnv, n_envs=16, seed=1, env_kwargs=SETTINGS)
    learner = PPO(
        "MlpPolicy", environments, n_steps=256, batch_size=512, learning_rate=1e-3, seed=1,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0}, device="cpu", verbose=1,
    )  # fmt: skip
    learner.learn(steps)
    learner.save(file)


def controller(file: Path = POLICY):
    """Return the policy as a controller ``(time, state, belief) -> force``."""
    from stable_baselines3 import PPO

    return policy_controller(PPO.load(file, device="cpu").predict, CartPoleEnv(**SETTINGS))


if __name__ == "__main__":
    train()
