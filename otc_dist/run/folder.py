"""The run folder: one place that names every file of a run."""

from dataclasses import dataclass
from pathlib import Path

from otc_dist.terminal.errors import UserError

# One of them lies beside the description of a run or a comparison.
_BESIDE = ("run.json", "inputs.json", "seeds")


def holding(path: Path) -> Path | None:
    """The folder of a run or of a comparison that `path` is or lies in, or would; None: none."""
    path = path.resolve()
    for folder in (path, *path.parents):
        beside = any((folder / name).exists() for name in _BESIDE)
        if beside and RunFolder(folder).description.exists():
            return folder
    return None


@dataclass(frozen=True)
class RunFolder:
    """Paths of a run's files.

    description.toml                 the resolved description
    run.json                         command line, versions, start, state
    dataset_card.json                what B_0 was
    deployments/deployment_01.mcap   one log a deployment, written by the env host
    evaluations/evaluation_00.json   greedy returns of pi_0, pi_1, ..., written by the env host
    agents/agent_0/                  one learner's own: checkpoints, metrics.jsonl, recommended.json
    output/                          what each process printed
    waiting.json                     for whom the env host waits, while it does
    stop                             made by a person, who stops a deployment in real time by it
    supervision.json                 how each process is, written by the launcher while it runs
    results.json, report.html        written at the end
    tracking/tensorboard/            what a tracker reads, where that was asked for
    """

    root: Path

    @property
    def description(self) -> Path:
        return self.root / "description.toml"

    @property
    def run_json(self) -> Path:
        return self.root / "run.json"

    @property
    def dataset_card(self) -> Path:
        return self.root / "dataset_card.json"

    @property
    def supervision(self) -> Path:
        return self.root / "supervision.json"

    @property
    def waiting(self) -> Path:
        return self.root / "waiting.json"

    @property
    def stop(self) -> Path:
        return self.root / "stop"

    @property
    def results(self) -> Path:
        return self.root / "results.json"

    @property
    def report(self) -> Path:
        return self.root / "report.html"

    def lacks(self, path: Path) -> UserError:
        """That this is no run's folder, since there is no such file in it."""
        if self.description.exists() and (self.root / "seeds").is_dir():
            return UserError(f"{self.root} is the folder of a comparison, not of a run")
        return UserError(f"{self.root} is not a run folder: it has no {path.name}")

    def deployment(self, k: int) -> Path:
        """Log of deployment k = 1..K; while it is being written, `.mcap.partial` is appended."""
        return self.root / "deployments" / f"deployment_{k:02d}.mcap"

    def approval(self, k: int) -> Path:
        """Made by a person who lets deployment k begin, where that is asked for; may be empty."""
        return self.root / "deployments" / f"approved_{k:02d}"

    @property
    def reset_approval(self) -> Path:
        """Made by a person who has reset the devices; taken away when it has been seen."""
        return self.root / "deployments" / "approved_reset"

    def evaluation(self, k: int) -> Path:
        """Greedy returns of the team pi_k, k = 0..K."""
        return self.root / "evaluations" / f"evaluation_{k:02d}.json"

    def agent(self, name: str) -> Path:
        return self.root / "agents" / name

    def checkpoint(self, name: str, k: int) -> Path:
        """Checkpoint of agent `name` after tuning on deployment k (0: after offline training)."""
        return self.agent(name) / f"checkpoint_{k:02d}.safetensors"

    def offline_checkpoint(self, name: str) -> Path:
        """Newest unfinished state of offline training."""
        return self.agent(name) / "offline.safetensors"

    def recommended(self, name: str) -> Path:
        """Which of its policies agent `name` recommends, written by its learner in the end."""
        return self.agent(name) / "recommended.json"

    def metrics(self, name: str) -> Path:
        return self.agent(name) / "metrics.jsonl"

    def tracking(self, tracker: str) -> Path:
        return self.root / "tracking" / tracker

    def output(self, process: str) -> Path:
        return self.root / "output" / f"{process}.log"
