"""The launch description: everything a run depends on, typed, validated, TOML in and out.

The same description and seed give the same run, to the byte.
"""

import hashlib
import re
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Self

import tomli_w
from pydantic import Field, PlainValidator, SerializeAsAny, ValidationError, model_validator

from otc_dist.description import toml_file, user_code
from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.description.assignments import assign, explain
from otc_dist.description.kinds import ALGORITHMS, STRATEGIES
from otc_dist.description.sampling import SamplingSection
from otc_dist.description.section import Section
from otc_dist.description.sections import (
    BusSection,
    DatasetSection,
    DeploymentSection,
    DynamicsSection,
    EmbeddingSection,
    EngineSection,
    EnvSection,
    EvaluationSection,
    OfflineSection,
)
from otc_dist.names import Name, is_code

# What a summary speaks of.
SUMMARISED = (
    ("env", "id"),
    ("env", "agents"),
    ("dataset", "name"),
    ("algorithm", "name"),
    ("sampling", "name"),
    ("sampling", "distance"),
    ("sampling", "acceptance"),
    ("sampling", "online_share"),
)


_Algorithm = Annotated[
    SerializeAsAny[AlgorithmSection],
    PlainValidator(ALGORITHMS.chosen, json_schema_input_type=AlgorithmSection),
]
_Sampling = Annotated[
    SerializeAsAny[SamplingSection],
    PlainValidator(STRATEGIES.chosen, json_schema_input_type=SamplingSection),
]


class Description(Section):
    """A whole run. `launch/*.toml` are descriptions; the run folder keeps the resolved one."""

    name: Name = Field(description="of the run's folder, with the seed")
    summary: str = Field(default="", description="one line for people; empty: from the settings")
    seed: int = Field(default=0, ge=0, lt=2**31, description="of everything random")
    minibatch_key: int = Field(default=0, ge=0, description="other minibatches while tuning")
    env: EnvSection
    dataset: DatasetSection
    algorithm: _Algorithm = Field(default_factory=lambda: ALGORITHMS.chosen({}))
    embedding: EmbeddingSection = EmbeddingSection()
    dynamics: DynamicsSection = DynamicsSection()
    sampling: _Sampling = Field(default_factory=lambda: STRATEGIES.chosen({}))
    offline: OfflineSection = OfflineSection()
    deployment: DeploymentSection = DeploymentSection()
    evaluation: EvaluationSection = EvaluationSection()
    engine: EngineSection = EngineSection()
    bus: BusSection = BusSection()

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, data: object) -> object:
        """`env.agents` becomes part of the id, and a data set's level a whole name."""
        if not isinstance(data, dict):
            return data
        env, dataset = data.get("env"), data.get("dataset")
        if not isinstance(env, dict) or not isinstance(env.get("id"), str):
            return data
        whole = env["id"]
        if isinstance(agents := env.get("agents"), int) and agents > 0:
            whole, changed = re.subn(r"-\d+$", f"-{agents}", whole)
            if not changed:
                raise ValueError(
                    f"env.agents is not for {whole}, whose number of agents is its own"
                )
            env = {**env, "id": whole, "agents": None}
        data = {**data, "env": env}
        level = dataset.get("name") if isinstance(dataset, dict) else None
        if isinstance(dataset, dict) and isinstance(level, str) and "/" not in level:
            data["dataset"] = {**dataset, "name": f"{whole}/{level}"}
        return data

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self.sampling.check(self.algorithm, self.deployment.transitions)
        if self.deployment.rate_hz is not None:
            self._check_real_time()
        return self

    def _check_real_time(self) -> None:
        if self.env.copies != 1:
            raise ValueError("deployment.rate_hz needs env.copies = 1: devices are not copied")
        if self.evaluation.episodes:
            raise ValueError(
                "deployment.rate_hz needs evaluation.episodes = 0: in real time policies are"
                " measured by their deployments alone"
            )
        if is_code(self.env.id) and self.dataset.name == f"{self.env.id}/random":
            raise ValueError(
                "deployment.rate_hz needs data that were recorded: dataset.name = 'random' would"
                " play the devices at random"
            )

    @classmethod
    def load(cls, path: str | Path, assignments: Iterable[str] = ()) -> Self:
        """Read a TOML file and apply `section.key=value` assignments.

        Raises:
            UserError: the file is missing, is no TOML, or holds an unknown key or a bad value.
        """
        data = toml_file.read(Path(path), "the description")
        return cls.build(data, assignments, source=str(path))

    @classmethod
    def parse(cls, text: str, assignments: Iterable[str] = (), source: str = "description") -> Self:
        """As `load`, from TOML that `source` holds."""
        return cls.build(toml_file.parse(text, source), assignments, source=source)

    @classmethod
    def build(
        cls, data: dict[str, object], assignments: Iterable[str] = (), source: str = "description"
    ) -> Self:
        """Validate `data` after `section.key=value` assignments; errors as in `load`.

        With another algorithm or strategy than that of `data`, what only the old one has is left
        out.
        """
        merged, assignments = dict(data), tuple(assignments)
        asked = _asked(assignments)
        for section, kind in (("algorithm", ALGORITHMS), ("sampling", STRATEGIES)):
            name, settings = asked[section].get("name"), data.get(section, {})
            if isinstance(name, str) and isinstance(settings, dict):
                merged[section] = kind.kept(settings, name)
        for assignment in assignments:
            assign(merged, assignment)
        if merged.get("summary") == data.get("summary") and _summarised(merged) != _summarised(
            data
        ):
            merged["summary"] = ""  # it describes what it was written for
        try:
            return cls.model_validate(merged)
        except ValidationError as error:
            if merged != data and cls._is_valid(data):
                source = "command line"
            raise explain(cls, error.errors()[0], source, merged) from None

    @classmethod
    def _is_valid(cls, data: dict[str, object]) -> bool:
        try:
            cls.model_validate(data)
        except ValidationError:
            return False
        return True

    def with_assignments(self, *assignments: str) -> Self:
        """A copy with `section.key=value` assignments applied; errors as in `load`.

        With another `algorithm.name` the section keeps what is not the old algorithm's default and
        the new one has too; with another environment the data set is the same level of it. A
        setting that the strategy has not asks for the one that has it.
        """
        data = self.model_dump(mode="json")
        data["dataset"]["name"] = self.dataset.name.removeprefix(f"{self.env.id}/")
        changed = self.algorithm.model_dump(mode="json", exclude_defaults=True)
        data["algorithm"] = {"name": self.algorithm.name, **changed}
        asked = _asked(assignments)["sampling"]
        if "name" not in asked and not set(asked) <= set(type(self.sampling).model_fields):
            assignments = (*assignments, f"sampling.name={STRATEGIES.with_settings(asked)}")
        return self.build(data, assignments)

    @property
    def heading(self) -> str:
        """The summary, or one from the names of the settings."""
        return self.summary or (
            f"{self.dataset.name}: {self.algorithm.name} tuned by {self.sampling.title}"
        )

    @property
    def code(self) -> tuple[str, ...]:
        """What of it may name code of the user's own, as module:function or module:Class."""
        return self.env.id, self.dataset.name.rpartition("/")[0], *self.parts

    @property
    def parts(self) -> tuple[str, ...]:
        """The names of what learns: of the algorithm, and of what sampling is made of."""
        return self.algorithm.name, *self.sampling.code

    def trusted(self) -> Self:
        """A copy that is to be run: the code that it names is loaded, and its settings are checked.

        Raises:
            UserError: it cannot be loaded, or has other settings.
        """
        user_code.allow(*self.code)
        return self.with_assignments() if any(map(is_code, self.parts)) else self

    def progress(self, deployment: int) -> float:
        """The share of the deployments gone in deployment and evaluation k, from 0 to 1."""
        return progress(deployment, self.deployment.count)

    def to_toml(self) -> str:
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    def digest(self) -> str:
        """Identifies the description: 16 hexadecimal digits of its canonical form's hash.

        Without the router: where messages pass changes nothing in a run.
        """
        return _hash(self.model_dump_json(exclude={"bus": {"router"}}))

    def tuning_digest(self) -> str:
        """Identifies what pi_k and deployment k depend on, as `digest` does the whole.

        How many deployments there are, and what is done with their outcome, is left out: a run
        that is extended goes on with the checkpoints and logs that it has. Where the environment
        changes in the course of the deployments, their number matters: who extends must know.
        """
        ending = {"count", "keep", "confirm", "floor", "approve", "reset_by_hand"}
        return _hash(self.model_dump_json(exclude={"bus": {"router"}, "deployment": ending}))

    def shared_digest(self) -> str:
        """Identifies what env host and learners must agree on: all but each host's own engine."""
        return _hash(self.model_dump_json(exclude={"bus": {"router"}, "engine": True}))

    def offline_digest(self) -> str:
        """Identifies what the offline policy pi_0 depends on, as `digest` does the whole."""
        parts = {"seed", "dataset", "algorithm", "embedding", "dynamics", "offline", "engine"}
        return _hash(self.model_dump_json(include=parts) + self.env.id)


def _asked(assignments: Iterable[str]) -> defaultdict[str, dict[str, object]]:
    """Section -> setting -> value, of what the assignments alone say. Raises UserError."""
    written: dict[str, object] = {}
    for assignment in assignments:
        assign(written, assignment)
    sections = ((name, dict(one)) for name, one in written.items() if isinstance(one, dict))
    return defaultdict(dict, sections)


def progress(deployment: int, count: int) -> float:
    """The share of `count` deployments gone in deployment and evaluation k, from 0 to 1."""
    return max(deployment - 1, 0) / max(count - 1, 1)


def _summarised(data: dict[str, object]) -> list[object]:
    """The values of `SUMMARISED`, None where a section or a key is missing."""
    sections = [(data.get(section), key) for section, key in SUMMARISED]
    return [section.get(key) if isinstance(section, dict) else None for section, key in sections]


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
