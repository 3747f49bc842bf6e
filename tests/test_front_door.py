"""What `import otc_dist` offers: all of it, typed and told, and nothing loaded before its time."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import otc_dist

HEAVY = ("mujoco", "pandas", "pydantic", "scipy", "torch", "zenoh")
LOADS = {  # each name, and what of HEAVY it may load
    "__version__": set(),
    "UserError": set(),
    "Transitions": set(),
    "Description": {"pydantic"},
    "read_log": {"pydantic"},
    "Log": {"pydantic"},
    "load_dataset": {"pydantic"},
    "make_env": {"pydantic"},
    "Policy": {"pydantic", "torch"},
    "Learner": {"pydantic", "torch"},
}


def test_every_name_is_there_and_told() -> None:
    assert set(LOADS) == set(otc_dist.__all__) <= set(dir(otc_dist))
    for name in set(otc_dist.__all__) - {"__version__"}:
        found = getattr(otc_dist, name)
        assert found.__doc__ and found.__name__ == name
        assert name == "Log" or f"    {name} " in (otc_dist.__doc__ or "")
    with pytest.raises(AttributeError, match="'otc_dist' has no attribute 'Polcy'"):
        _ = otc_dist.Polcy  # type: ignore[attr-defined]
    assert (Path(otc_dist.__file__).parent / "py.typed").exists()


def test_nothing_heavy_is_loaded_before_it_is_needed() -> None:
    """One process, in the order of what they load: a name that loaded more would show."""
    names = sorted(LOADS, key=lambda name: (len(LOADS[name]), name))
    code = "\n".join(
        (
            f"import sys, otc_dist; heavy = {HEAVY}",
            *(
                f"otc_dist.{name}; print({name!r}, *[m for m in heavy if m in sys.modules])"
                for name in names
            ),
        )
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = {line.split()[0]: set(line.split()[1:]) for line in done.stdout.splitlines()}
    assert found == LOADS


def test_data_sets_and_environments_by_name() -> None:
    data = otc_dist.load_dataset("navigation/random", "agent_0", transitions=200)
    assert isinstance(data, otc_dist.Transitions) and len(data) == 200
    env = otc_dist.make_env("navigation", copies=3)
    env.reset(np.arange(3), np.array([1, 2, 3]))
    (seen,) = env.observe()
    assert seen.shape == (3, data.observations.shape[1])
    env.close()
    for call in (otc_dist.make_env, lambda name: otc_dist.load_dataset(f"{name}/random", "x")):
        with pytest.raises(otc_dist.UserError, match="allow='somebodys_module:make'"):
            call("somebodys_module:make")
