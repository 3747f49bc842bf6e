"""After how many offline updates is the team's return on its plateau?

    python benchmarks/offline_plateau.py 3agent_hopper [--set offline.updates=150000]

Trains every agent offline as the description says, all cores at work, and then plays greedy
episodes with the team's policies of every 10,000 updates.
"""

import argparse
import multiprocessing
import os
import tempfile
from pathlib import Path

import numpy as np

from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.launch.plan import descriptions
from otc_dist.launch.run.resolve import resolve
from otc_dist.learner import team
from otc_dist.learner.learner import SAVE_EVERY, Learner, Progress
from otc_dist.terminal.errors import run_main


def learner(description: Description, agent: str) -> Learner:
    spec = registry.team_spec(description.env.id)
    dataset = description.dataset
    data = store.load_agent(store.agent_file(dataset.name, agent, dataset.transitions), agent)
    task = registry.task(description.env.id)
    return Learner(description, spec.agents[spec.index(agent)], data, task)


def train(description: Description, agent: str, folder: Path) -> None:
    """Keep a checkpoint of `agent` every SAVE_EVERY updates."""
    brain = learner(description, agent)
    done = 0

    def report(progress: Progress) -> None:
        nonlocal done
        done = progress.update

    def save() -> None:
        brain.save(folder / f"{agent}_{done}.safetensors")
        print(f"{agent}: {done:,} updates", flush=True)

    brain.pretrain(report, save)
    brain.save(folder / f"{agent}_{done}.safetensors")


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("name", help="a shipped description's name, or a TOML file")
    parser.add_argument("--set", action="append", default=[], metavar="section.key=value")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    # Sampling plays no part offline; uniform needs no embedding.
    changes = [*arguments.set, "sampling.name=uniform"]
    description = resolve(descriptions.load(arguments.name, changes, arguments.seed, quick=False))
    store.ensure(description.dataset.name, description.dataset.transitions)
    agents = registry.team_spec(description.env.id).names
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with multiprocessing.get_context("spawn").Pool(os.cpu_count()) as pool:
            pool.starmap(train, [(description, agent, folder) for agent in agents], chunksize=1)
        brains = [learner(description, agent) for agent in agents]
        print(f"updates  return of {description.evaluation.episodes} greedy episodes")
        for updates in range(SAVE_EVERY, description.offline.updates + 1, SAVE_EVERY):
            for brain in brains:
                brain.load(folder / f"{brain.spec.name}_{updates}.safetensors")
            returns = team.evaluate(brains, 0).episode_returns
            print(f"{updates:7,}  {np.mean(returns):8.1f} ± {np.std(returns):.1f}", flush=True)
    return 0


if __name__ == "__main__":
    run_main(main)
