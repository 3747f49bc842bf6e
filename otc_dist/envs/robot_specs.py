"""The robots as data: which model, which reward, which partition into agents. No simulator here.

The tasks are gymnasium's `Hopper-v4`, `HalfCheetah-v4` and `Walker2d-v4`, which the D4RL `-v2`
data match (v5 changed the terminal reward). The partitions are those of the paper: contiguous
ascending slices of the action vector, and every agent observes the full state.
"""

from dataclasses import dataclass

import numpy as np

from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.transitions import Float32, Float64

MAX_EPISODE_STEPS = 1000


@dataclass(frozen=True)
class Health:
    """Outside of these open intervals a robot has fallen, and the episode terminates."""

    height: tuple[float, float]  # m, of the torso: qpos[1]
    angle: tuple[float, float]  # rad, of the torso: qpos[2]
    limit: float | None  # bound on |x| of all of the state but qpos[:2]


@dataclass(frozen=True)
class Robot:
    """One planar robot. `joints` counts qpos, and qvel as well; the first three are the torso's.

    reward = forward velocity (m/s) + healthy_reward - control_cost * sum of squared actions
    """

    name: str
    model: str  # file name in `models/`
    joints: int
    actuators: int
    frame_skip: int
    control_cost: float
    healthy_reward: float
    health: Health | None  # None: it cannot fall
    velocity_clip: float | None  # observed velocities are clipped to +- this
    reset_scale: float  # of the noise on the initial state
    reset_normal: bool  # initial velocities: normal noise instead of uniform
    random_return: float  # D4RL's reference returns (Fu et al. 2020, `d4rl/infos.py`)
    expert_return: float

    @property
    def observation_size(self) -> int:
        """qpos without the forward position, then qvel."""
        return 2 * self.joints - 1

    @property
    def state_size(self) -> int:
        """Elapsed steps, qpos, qvel, and the acceleration that warm-starts the solver."""
        return 1 + 3 * self.joints


HOPPER = Robot(
    name="hopper",
    model="hopper.xml",
    joints=6,
    actuators=3,
    frame_skip=4,
    control_cost=1e-3,
    healthy_reward=1.0,
    health=Health(height=(0.7, float("inf")), angle=(-0.2, 0.2), limit=100.0),
    velocity_clip=10.0,
    reset_scale=5e-3,
    reset_normal=False,
    random_return=-20.272305,
    expert_return=3234.3,
)
WALKER2D = Robot(
    name="walker2d",
    model="walker2d.xml",
    joints=9,
    actuators=6,
    frame_skip=4,
    control_cost=1e-3,
    healthy_reward=1.0,
    health=Health(height=(0.8, 2.0), angle=(-1.0, 1.0), limit=None),
    velocity_clip=10.0,
    reset_scale=5e-3,
    reset_normal=False,
    random_return=1.629008,
    expert_return=4592.3,
)
HALFCHEETAH = Robot(
    name="halfcheetah",
    model="half_cheetah.xml",
    joints=9,
    actuators=6,
    frame_skip=5,
    control_cost=0.1,
    healthy_reward=0.0,
    health=None,
    velocity_clip=None,
    reset_scale=0.1,
    reset_normal=True,
    random_return=-280.178953,
    expert_return=12135.0,
)

# Environment id -> the robot and its number of agents. "2x3" reads: 2 agents of 3 actuators.
PARTITIONS: dict[str, tuple[Robot, int]] = {
    f"{robot.name}-{agents}x{robot.actuators // agents}": (robot, agents)
    for robot, agents in (
        (HOPPER, 3),
        (HALFCHEETAH, 2),
        (WALKER2D, 2),
        (HOPPER, 1),
        (HALFCHEETAH, 1),
        (WALKER2D, 1),
    )
}


def single_agent_id(robot: str) -> str:
    """The environment id in which one agent moves all of `robot`; KeyError if there is none."""
    return next(
        env_id
        for env_id, (found, agents) in PARTITIONS.items()
        if (found.name, agents) == (robot, 1)
    )


def team_spec(env_id: str) -> TeamSpec:
    """The team of a robot environment. Raises KeyError for an unknown id."""
    robot, agents = PARTITIONS[env_id]
    size = robot.actuators // agents
    return TeamSpec(
        env_id=env_id,
        agents=tuple(
            AgentSpec(f"agent_{i}", robot.observation_size, (-1.0,) * size, (1.0,) * size)
            for i in range(agents)
        ),
        state_size=robot.state_size,
        max_episode_steps=MAX_EPISODE_STEPS,
    )


def states_of(env_id: str, observations: Float32) -> Float64:
    """Simulator states (N, state_size) in which an agent observes `observations` (N, s), at the
    first step of an episode, at the origin and without the solver's warm start. Velocities that
    were clipped stay clipped. Raises KeyError for an unknown id.
    """
    robot, _ = PARTITIONS[env_id]
    states = np.zeros((len(observations), robot.state_size))
    states[:, 2 : 2 + robot.observation_size] = observations  # after the forward position
    return states


def reference_returns(env_id: str) -> tuple[float, float]:
    """Returns of a random and of an expert team in D4RL. Raises KeyError for an unknown id."""
    robot, _ = PARTITIONS[env_id]
    return robot.random_return, robot.expert_return
