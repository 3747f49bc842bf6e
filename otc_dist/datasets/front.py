"""What `import otc_dist` offers of data sets and environments."""

from collections.abc import Iterable

from otc_dist.datasets import store
from otc_dist.description import user_code
from otc_dist.envs import registry
from otc_dist.envs.base import BatchedEnv
from otc_dist.transitions import Transitions


def load_dataset(
    name: str, agent: str, transitions: int = 0, *, allow: str | Iterable[str] = ()
) -> Transitions:
    """B_0 of one agent: its own <s, a_i, r, s'>, in the order in which they were played.

    It lies in the cache (`$OTC_DIST_CACHE`, or the user's cache folder) and is made, for all
    agents, if it is not there: minutes for a usual size, seconds for a thousand transitions.
    Imported sets (D4RL, Minari, deployment logs) are loaded by the names that they were given.

    Args:
        name: ENVIRONMENT/LEVEL, as "hopper-3x1/medium-replay".
        agent: its name, as "agent_0".
        transitions: size of the set, in joint steps; 0: its usual size.
        allow: `module:function` of an environment of your own that the name begins with.

    Raises:
        UserError: an unknown name, size or agent, a damaged set, no space or right to write.
    """
    user_code.allow_all(allow)
    store.ensure(name, transitions)
    return store.load_agent(store.agent_file(name, agent, transitions), agent)


def make_env(env_id: str, copies: int = 1, *, allow: str | Iterable[str] = ()) -> BatchedEnv:
    """`copies` copies of an environment that step together; none has a state before `reset`.

        env = make_env("hopper-3x1", copies=2)
        env.reset(np.arange(2), seeds=np.array([7, 8]))
        outcome = env.step([policy.act(s) for policy, s in zip(policies, env.observe())])

    Args:
        env_id: one of `otc_dist.envs.registry.env_ids()`, or `module:function`, which makes a
            PettingZoo environment of your own.
        allow: `module:function` where `env_id` is that: a name may come from a file, so nothing is
            imported for being named.

    Raises:
        UserError: an unknown environment, one that is not allowed or not installed.
        ValueError: fewer than one copy.
    """
    user_code.allow_all(allow)
    return registry.make(env_id, copies)
