"""The description: TOML in and out, every mistake one line that helps, digests."""

import json
import tomllib
from pathlib import Path

import pytest

from otc_dist.description import Description, user_code
from otc_dist.description.distances import DISTANCES
from otc_dist.description.sampling import Cost
from otc_dist.terminal.errors import UserError

MINIMAL = 'name = "x"\n[env]\nid = "hopper-3x1"\n[dataset]\nname = "hopper-3x1/medium"\n'


def minimal(*assignments: str) -> Description:
    return Description.build(tomllib.loads(MINIMAL), assignments)


def test_round_trip_through_toml(tmp_path: Path) -> None:
    changed = minimal(
        'summary="quotes \\" and\\nnewlines, é"',
        "algorithm.hidden=[32, 16, 8]",
        "algorithm.actor_learning_rate=3e-4",
        "sampling.adaptive=false",
        "seed=17",
    )
    for description in (minimal(), changed):
        path = tmp_path / "description.toml"
        path.write_text(description.to_toml(), encoding="utf-8")
        again = Description.load(path)
        assert again == description
        assert again.digest() == description.digest()
        assert again.to_toml() == description.to_toml()
    assert changed.algorithm.hidden == (32, 16, 8)


def test_the_papers_numbers_are_otcs_defaults() -> None:
    d = minimal("sampling.name=otc")
    assert (d.sampling.candidates, d.sampling.references, d.algorithm.batch_size) == (
        512,
        2000,
        128,
    )
    assert (d.algorithm.discount, d.embedding.size) == (0.99, 10)
    assert (d.deployment.count, d.deployment.fraction) == (10, 0.01)
    assert (d.sampling.alpha, d.sampling.adaptive, d.sampling.matching) == (1.0, True, "minibatch")


def test_the_default_is_what_is_shown_to_help() -> None:
    d = minimal()
    assert (d.algorithm.name, d.sampling.name, d.offline.updates) == ("td3bc", "uniform", 50_000)


@pytest.mark.parametrize(
    ("name", "hidden", "updates", "rates"),
    [
        ("bcq", (64, 64), 4000, {"actor": 1e-4, "critic": 1e-4}),
        ("awac", (64, 64), 4000, {"actor": 1e-4, "critic": 5e-4}),
        ("bremen", (256, 256), 2000, {"actor": 1e-4, "model": 5e-4}),
        ("cql", (256, 256), 2000, {"actor": 1e-4, "critic": 1e-4}),
        ("discrete-cql", (256, 256), 2000, {"critic": 1e-4}),
        ("td3bc", (256, 256), 2000, {"actor": 3e-4, "critic": 3e-4}),
    ],
)
def test_table_3(name: str, hidden: tuple[int, ...], updates: int, rates: dict[str, float]) -> None:
    algorithm = minimal(f"algorithm.name={name}").algorithm
    assert (algorithm.hidden, algorithm.tuning_updates) == (hidden, updates)
    for network, rate in rates.items():
        assert getattr(algorithm, f"{network}_learning_rate") == rate


def test_another_algorithm_brings_its_own_defaults() -> None:
    large = minimal("algorithm.batch_size=64").with_assignments("algorithm.name=td3bc")
    assert (large.algorithm.hidden, large.algorithm.batch_size) == ((256, 256), 64)


def test_another_algorithm_keeps_no_setting_that_it_has_not() -> None:
    models = minimal("algorithm.name=bremen", "algorithm.improvements=1", "algorithm.batch_size=64")
    other = models.with_assignments("algorithm.name = 'awac'")
    assert other.algorithm.batch_size == 64 and not hasattr(other.algorithm, "improvements")
    with pytest.raises(UserError, match=r"unknown key 'algorithm\.improvements'"):
        models.with_assignments("algorithm.name=awac", "algorithm.improvements=2")


def test_a_file_is_taken_with_another_algorithm_and_strategy_than_its_own() -> None:
    """What only the old ones have is left out; what nobody has is told, whoever wrote it."""
    file = tomllib.loads(
        f'{MINIMAL}\n[algorithm]\nname = "bremen"\nimprovements = 1\ndiscount = 0.9\n'
        "[sampling]\nonline_share = 0.5\n"
    )
    other = ("algorithm.name=awac", "sampling.name=balanced")
    taken = Description.build(file, other)
    assert taken.algorithm.discount == 0.9 and "improvements" not in taken.to_toml()
    assert taken.sampling.model_dump()["online_share"] == 0
    with pytest.raises(UserError, match="online_share is for 'otc' and 'uniform'"):
        Description.build(file, (*other, "sampling.online_share=0.5"))
    file["algorithm"]["discout"] = 0.8
    with pytest.raises(UserError, match=r"did you mean 'algorithm\.discount'"):
        Description.build(file, other)


def test_a_file_of_the_package_works_where_a_user_copies_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its section has a name, and is found by another."""
    monkeypatch.setattr(user_code, "_allowed", set())
    name = "otc_dist.algorithms.awac:Awac"
    copied = minimal(f"algorithm.name={name}", "algorithm.temperature=2").trusted()
    assert (copied.algorithm.name, copied.with_assignments("seed=1").algorithm.name) == (name, name)
    assert f'name = "{name}"' in copied.to_toml()


def test_scores_once_a_deployment_cost_no_update_anything() -> None:
    """Of a distance that no minibatch can be matched by, and of any by another rule than rank."""
    for text in ("typical", "dynamics"):
        cost = minimal(f"sampling.distance={text}", "sampling.acceptance=rank").sampling.cost
        assert cost == Cost(scoring=DISTANCES[text].scoring)
    rank = ("sampling.distance=value", "sampling.acceptance=rank")
    assert minimal(*rank).sampling.cost == Cost(update=DISTANCES["value"].selection)


@pytest.mark.parametrize(
    ("assignments", "name"),
    [
        ((), "uniform"),
        (("sampling.distance=value",), "otc"),
        (("sampling.share = 0.2", "sampling.alpha=2"), "otc"),
        (("sampling.online_share=0.5",), "uniform"),
        (("sampling.temperature=2",), "balanced"),
        (("sampling.alpha=2", "sampling.name=uniform"), "uniform"),
        (("sampling.aplha=2",), None),
    ],
)
def test_a_setting_of_a_strategy_asks_for_it(
    assignments: tuple[str, ...], name: str | None
) -> None:
    if name is None:
        with pytest.raises(UserError, match=r"did you mean 'sampling\.alpha'"):
            minimal(*assignments)
        with pytest.raises(UserError, match=r"did you mean 'sampling\.alpha'"):
            minimal().with_assignments(*assignments)
        return
    assert minimal(*assignments).sampling.name == name
    assert minimal().with_assignments(*assignments).sampling.name == name


def test_assignments_reach_sections_and_keep_the_rest() -> None:
    description = minimal("sampling.distance=value", "sampling.alpha = 0.5", "name=y-z")
    assert description.sampling.distance == "value"
    assert description.sampling.alpha == 0.5
    assert description.name == "y-z"
    more = description.with_assignments("sampling.alpha=2", "env.copies=8")
    assert (more.sampling.alpha, more.sampling.distance, more.env.copies) == (2, "value", 8)
    assert description.sampling.alpha == 0.5


MISTAKES = {
    "sampling.aplha=1": "unknown key 'sampling.aplha'; did you mean 'sampling.alpha'?",
    "samplings.alpha=1": "unknown key 'samplings'; did you mean 'sampling'?",
    "sampling.distance=valeu": "unknown sampling.distance 'valeu'; did you mean 'value'?",
    "sampling.acceptance=shared": "unknown sampling.acceptance 'shared'; did you mean 'share'?",
    "sampling.online_share=1": "sampling.online_share: input should be less than 1",
    "sampling.share=0": "sampling.share: input should be greater than 0, not 0",
    "sampling.name=onlineonly": "did you mean 'online-only'?",
    "engine.name=cuda": "did you mean 'cuda-graph'?",
    "algorithm.name=dqn": "unknown algorithm.name 'dqn'; known: awac, bcq, bremen, ",
    "sampling.alpha=-1": "sampling.alpha: input should be greater than or equal to 0, not -1",
    "sampling.alpha=nan": "sampling.alpha: input should be a finite number, not nan",
    "algorithm.critic_learning_rate=inf": "should be a finite number",
    "sampling.alpha=much": "sampling.alpha: input should be a valid number",
    "seed=1.5": "seed: input should be a valid integer",
    "seed=-1": "seed: input should be greater than or equal to 0, not -1",
    "algorithm.hidden=[64, 0]": "algorithm.hidden.1: input should be greater than 0, not 0",
    "sampling=3": "sampling is a section: write sampling.KEY",
    "name.first=1": "'name' is a value, not a section",
    "sampling.alpha": "write section.key=value, like sampling.share=0.2",
    "=3": "write section.key=value",
    "": "write section.key=value",
    "..=1": "write section.key=value",
}


@pytest.mark.parametrize(("assignment", "expected"), MISTAKES.items())
def test_a_mistake_is_one_line_that_helps(assignment: str, expected: str) -> None:
    with pytest.raises(UserError) as caught:
        minimal(assignment)
    message = str(caught.value)
    assert expected in message
    assert "\n" not in message and len(message) < 400


def test_what_cannot_go_together_is_one_line() -> None:
    conformal = ("sampling.acceptance=conformal", "sampling.level=0.01")
    with pytest.raises(UserError, match="needs deployments of at least 99 transitions, not 98"):
        minimal(*conformal, "deployment.transitions=98")
    minimal(*conformal, "deployment.transitions=99")
    with pytest.raises(UserError, match=r"must not exceed sampling.candidates \(512\)"):
        minimal("sampling.acceptance=rank", "algorithm.batch_size=513")
    minimal("algorithm.batch_size=513")
    for name in ("balanced", "online-only"):
        with pytest.raises(UserError, match=f"{name} chooses its online data itself"):
            minimal(f"sampling.name={name}", "sampling.online_share=0.5")


def test_any_batch_size_without_otc() -> None:
    assert (
        minimal("algorithm.batch_size=4096", "sampling.name=uniform").algorithm.batch_size == 4096
    )


FILES = {
    b"name = ": "is not valid TOML",
    b"\xff\xfe": "is not valid TOML",
    b'name = "x"\n[dataset]\nname = "y"\n': "env is missing: it has no default",
    b"[env]\n[dataset]\n": "name is missing: it has no default",
    MINIMAL.encode() + b"[evn]\n": "unknown key 'evn'; did you mean 'env'?",
}


@pytest.mark.parametrize(("content", "expected"), FILES.items())
def test_a_bad_file_is_named_in_one_line(content: bytes, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        Description.load(path)
    assert expected in str(caught.value) and str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["absent.toml", "."])
def test_a_file_that_cannot_be_read_is_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot read the description"):
        Description.load(tmp_path / name)


def test_a_task_for_any_number_of_agents() -> None:
    data = {"name": "x", "env": {"id": "flock-4"}, "dataset": {"name": "random"}}
    four = Description.build(data)
    assert (four.env.id, four.dataset.name) == ("flock-4", "flock-4/random")
    six = four.with_assignments("env.agents=6")
    assert (six.env.id, six.dataset.name) == ("flock-6", "flock-6/random")
    three = Description.build(data, ["env.agents=6", "dataset.name=flock-3/random"])
    assert three.dataset.name == "flock-3/random"  # as it was asked for: refused, not replaced
    with pytest.raises(UserError, match=r"env.agents is not for hopper-3x1"):
        minimal("env.agents=4")
    with pytest.raises(UserError, match=r"env.agents: input should be greater than 0"):
        four.with_assignments("env.agents=0")
    assert Description.build(tomllib.loads(six.to_toml())) == six


def test_a_summary_is_not_kept_for_something_else() -> None:
    data = {
        "name": "x",
        "summary": "two of a flock",
        "env": {"id": "flock-2"},
        "dataset": {"name": "random"},
    }
    assert Description.build(data, ["sampling.alpha=2.0"]).heading == "two of a flock"
    three = Description.build(data, ["env.agents=3"])
    assert three.heading == "flock-3/random: td3bc tuned by uniform sampling"
    uniform = Description.build(data, ["sampling.name=uniform"])
    assert uniform.heading == "flock-2/random: td3bc tuned by uniform sampling"
    assert Description.build(data, ["env.agents=3", "summary=mine"]).heading == "mine"


def leaves(value: object, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    if isinstance(value, dict):
        return [leaf for key, part in value.items() for leaf in leaves(part, (*path, key))]
    return [path]


OTHER = {
    "name": "other",
    "summary": "other",
    "env.id": "walker2d-2x3",
    "dataset.name": "other",
    "algorithm.name": "bcq",
    "algorithm.hidden": [3],
    "sampling.density_hidden": [3],
    "deployment.exploration": "sequential",
    "deployment.exploration_rate": 0.5,
    "deployment.keep": "best",
    "offline.policies": "0123456789abcdef",
    "sampling.name": "balanced",
    "sampling.distance": "value",
    "sampling.matching": "exact",
    "sampling.normaliser": "paper",
    "engine.name": "eager",
    "embedding.hidden": [3],
    "dynamics.hidden": [3],
    "dynamics.correction_hidden": [3],
    "sampling.acceptance": "rank",
    "sampling.corrects": "all",
    "sampling.share": 0.5,
    "sampling.level": 0.5,
    "sampling.online_share": 0.5,
    "offline.rows": "typical",
    "offline.share": 0.5,
    "bus.router": "tls/192.0.2.1:7447",
    "engine.products": "torch",
}
OFFLINE = (
    "seed",
    "env.id",
    "dataset",
    "algorithm",
    "embedding",
    "dynamics",
    "offline",
    "engine",
)


@pytest.mark.parametrize(
    "path", [".".join(p) for p in leaves(minimal().model_dump(exclude={"env": {"agents"}}))]
)
def test_digests_depend_on_every_setting_and_the_offline_one_on_its_own(path: str) -> None:
    before = minimal().with_assignments()
    value: object = before.model_dump(mode="json")
    for key in path.split("."):
        assert isinstance(value, dict)
        value = value[key]
    if path in OTHER:
        value = OTHER[path]
    elif isinstance(value, bool):
        value = not value
    elif isinstance(value, int | float):
        value = value + 1 if value != 0.99 and value != 0.75 else value / 2
    if value is None or path == "algorithm.target_rate" or path == "deployment.fraction":
        value = 0.5
    after = before.with_assignments(f"{path}={json.dumps(value)}")
    assert (after.digest() != before.digest()) is (path != "bus.router")
    hosts_agree = path in ("bus.router", "engine.name", "engine.products")
    assert (after.shared_digest() == before.shared_digest()) is hosts_agree
    later = {f"deployment.{key}" for key in ("count", "keep", "confirm", "floor", "approve")}
    assert (after.tuning_digest() == before.tuning_digest()) is (path in {"bus.router", *later})
    offline = path.startswith(OFFLINE)
    assert (after.offline_digest() != before.offline_digest()) is offline
