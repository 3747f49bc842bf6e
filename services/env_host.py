"""The env host: plays the environment with all agents in lock-step, and logs every step.

It is the centre of the bus's star. Its log is written ahead of what it publishes, so that it can
be killed at any moment: started again, it continues where the log ends.
"""

import json
import logging
import math
from collections.abc import Mapping, Sequence

import numpy as np

from otc_dist.bus.endpoints import remove_local_endpoint
from otc_dist.bus.handshake import offer
from otc_dist.bus.keys import HOST
from otc_dist.bus.lockstep import HostLockstep
from otc_dist.bus.messages import Action, Moment, Observation, Phase, StepOutcome
from otc_dist.bus.presence import Presence
from otc_dist.bus.session import Session
from otc_dist.bus.wire import Rejections
from otc_dist.datasets import inputs
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import check_whole
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.envs.base import BatchedEnv
from otc_dist.envs.rollout import Rollout
from otc_dist.run.host_state import HostState
from otc_dist.system import durable
from otc_dist.system.ports import Port
from otc_dist.transitions import Float32, JointStep

from .acting import confirmed
from .deployment_conditions import DeploymentConditions
from .exposition import exposed
from .history import history_of
from .host_bus import open_bus
from .host_report import HostReport
from .process import Run, check_endpoints, parser, recording, serve
from .real_time import RealTime, at_rest
from .restore import open_log

log = logging.getLogger(__name__)

_FAREWELL = 5.0  # seconds that learners may take to leave once all is done


class EnvHost:
    """One run's env host: evaluation 0, then deployment k and evaluation k for k = 1..K, and a last
    deployment if pi_K is to be confirmed. After one below the floor no other follows.
    """

    def __init__(self, run: Run, session: Session) -> None:
        self._run, self._session = run, session
        self._description, self._folder = run.description, run.folder
        self._settings, self._conditions = run.description.deployment, DeploymentConditions(run)
        rejections = Rejections()
        self._schedule = run.schedule
        self._state = HostState.begin(self._folder)
        self._presence = Presence(session, run.keys, run.team.names)
        self._lockstep = HostLockstep(
            session,
            run.keys,
            run.team.agents,
            run.copies,
            run.description.bus.answer_deadline,
            rejections,
            self._presence.changed,
        )
        self._timed = self._settings.rate_hz is not None
        if self._settings.rate_hz is not None:  # answers are waited for to a tenth of a period
            session.wake_period = min(session.wake_period, 0.1 / self._settings.rate_hz)
        self.report = HostReport(session, run.keys, self._lockstep, rejections, self._state.epoch)
        for agent in run.team.names:
            session.answer(run.keys.history(agent), history_of(run, agent, rejections))
        offer(session, run.keys, run.spec)
        session.declare_alive(run.keys.alive(HOST))

    def serve(self, patience: float | None) -> None:
        """Go through all phases that are not finished yet.

        `patience`: seconds to wait first until all learners have come; None: they will.
        """
        with self.report.heartbeat:
            if patience is not None:
                self.report.enter("gathering", 0, 0)
                self._presence.wait_for_all(patience)
            self._evaluate(0)
            made = 0
            while made < self._settings.total and not self._conditions.below_floor(made + 1):
                made += 1
                self._deploy(made)
                if made <= self._settings.count:
                    self._evaluate(made)
            moment = Moment("done", made, self._state.epoch, 0)
            nothing = [Observation(moment, None, None)] * len(self._run.team.agents)
            self._lockstep.ask(nothing, acting=False)
            self.report.enter("done", made, 0)
            self._presence.wait_for_none(_FAREWELL)

    def _evaluate(self, k: int) -> None:
        """Play the episodes that count with pi_k, greedily, and write their returns."""
        path, episodes = self._folder.evaluation(k), self._description.evaluation.episodes
        if episodes == 0 or path.exists():
            return
        env_id, copies = self._run.team.env_id, self._run.copies["evaluation"]
        rounds = math.ceil(episodes / copies)
        self.report.enter("evaluation", k, rounds * self._run.team.max_episode_steps)
        env = registry.make(env_id, copies, self._description.progress(k))
        rollout = Rollout(env, self._description.seed, "evaluation", k, episodes)
        self.report.rollout = rollout
        policies: Mapping[str, str] = {}
        while not rollout.finished:
            answers = self._ask("evaluation", k, rollout.step, rollout.observations, None)
            policies = self._confirmed(policies, answers, f"evaluation {k}")
            rollout.advance(_actions(answers), self._greedy)
        env.close()
        mean = sum(rollout.episode_returns) / episodes
        result = {
            "evaluation": k,
            "env": env_id,
            "policies": policies,
            "seeds": list(rollout.episode_seeds),
            "returns": list(rollout.episode_returns),
            "successes": None if rollout.successes is None else list(rollout.successes),
            "lengths": list(rollout.episode_lengths),
            "mean_return": mean,
            "normalised_score": registry.normalised_score(env_id, mean),
        }
        with recording(path, "the evaluation is played again"):
            durable.write(path, (json.dumps(result, indent=1) + "\n").encode())
        won = rollout.successes
        self.report.evaluated(k, mean, None if won is None else 100 * sum(won) / episodes)

    def _deploy(self, k: int) -> None:
        """Deployment k: M transitions by pi_{k-1}, every step in the log before the next.

        Raises UserError where its log is there, but not whole: all learn from it.
        """
        path = self._folder.deployment(k)
        if path.exists():
            with OpenLog(path) as made:
                check_whole(made)
            return
        if self._conditions.needs_approval(k):
            self.report.enter("approval", k, 0)
            self._conditions.wait_for_approval(k)
        self.report.enter("deployment", k, self._schedule.steps)
        description = self._description
        env = registry.make(self._run.team.env_id, description.env.copies, description.progress(k))
        with at_rest(env), recording(path, "the steps recorded so far are kept"):
            rollout = Rollout(env, description.seed, "deployment", k, begin=not self._timed)
            self.report.rollout = rollout
            writer, last = open_log(self._run, k, rollout)
            try:
                last = self._play(k, env, rollout, writer, last)
                self._ask("deployment", k, rollout.step, rollout.observations, last)
                writer.finish(self._state.policies)
            finally:
                writer.close()
        log.info("deployment %d: %d steps in %s", k, self._schedule.steps, path.name)
        self.report.deployed(k, self._conditions.measured(k))

    def _play(
        self, k: int, env: BatchedEnv, rollout: Rollout, writer: LogWriter, last: JointStep | None
    ) -> JointStep | None:
        """Play deployment k behind `last`, the last logged step, to its end; its last step."""

        def ask(last: JointStep | None, until: float | None) -> Sequence[Action | None]:
            answers = self._ask("deployment", k, rollout.step, rollout.observations, last, until)
            self._note_deployed(k, answers)
            return answers

        def write(step: JointStep) -> None:
            self._conditions.check_rewards(step)
            writer.write(step)

        if self._timed:
            if rollout.step < self._schedule.steps:
                self._rehearse(k)
            return RealTime(self._run, k, rollout, ask, write, env.close, self.report).play(last)
        while rollout.step < self._schedule.steps:
            answers = ask(last, None)
            last = rollout.advance(_actions(answers), self._schedule.exploring(rollout.step))
            write(last)
        return last

    def _rehearse(self, k: int) -> None:
        """Have everybody act once by pi_{k-1}, of which nothing comes: before devices are set up
        and move, so that nobody trains, or answers for the first time, while they do.
        """
        moment, copies = Moment("evaluation", k - 1, self._state.epoch, 0), self._run.copies
        agents = self._run.team.agents  # to whom every action is available
        seen = [np.ones((copies["evaluation"], x.observation_size), np.float32) for x in agents]
        self._lockstep.ask([Observation(moment, one, None) for one in seen], acting=True)

    def _ask(
        self,
        phase: Phase,
        k: int,
        step: int,
        observations: Sequence[Float32],
        last: JointStep | None,
        until: float | None = None,
    ) -> Sequence[Action | None]:
        """Ask all agents; in a deployment's last question nobody acts any more.

        `until`: as of `HostLockstep.ask_until`; None: all answer.
        """
        moment = Moment(phase, k, self._state.epoch, step)
        questions = [
            Observation(moment, seen, StepOutcome.of(last, index) if last else None)
            for index, seen in enumerate(observations)
        ]
        if until is not None:
            return self._lockstep.ask_until(questions, until)
        acting = phase == "evaluation" or step < self._schedule.steps
        return self._lockstep.ask(questions, acting=acting)

    @property
    def _greedy(self) -> tuple[bool, ...]:
        """Behaviour tags: no agent explores."""
        return (False,) * len(self._run.team.agents)

    def _note_deployed(self, k: int, answers: Sequence[Action | None]) -> None:
        """Note, before the first step is logged, which policies act; they must stay the same."""
        begun = self._state.policies if self._state.deployment == k else {}
        acting = self._confirmed(begun, answers, f"deployment {k}")
        if acting != begun:
            self._state = self._state.deploying(k, acting, self._folder)

    def _confirmed(
        self, begun: Mapping[str, str], answers: Sequence[Action | None], where: str
    ) -> Mapping[str, str]:
        acting = dict(begun)
        for agent, answer in zip(self._run.team.names, answers, strict=True):
            if answer is not None:
                acting[agent] = answer.policy
        return confirmed(begun, acting, where, self._run.moved)


def _actions(answers: Sequence[Action | None]) -> list[Float32]:
    return [answer.actions for answer in answers if answer and answer.actions is not None]


def main() -> None:
    """Entry point of `python -m otc_dist.services.env_host`."""
    command = parser(
        "env_host",
        "Plays a run's environment with all its learners in lock-step and logs every step.",
        "The launcher starts one of these beside one learner per agent. By hand:\n"
        "  python -m otc_dist.services.env_host --run runs/my_run\n"
        "  python -m otc_dist.services.learner --run runs/my_run --agent agent_0   (and so on)\n"
        "Killed or stopped, it continues where its log ends when it is started again.\n"
        "Exit status: 0 done, 1 failed, 2 a mistake to fix, 3 stopped by a person's file,\n"
        "128 + n stopped by signal n.",
    )
    command.add_argument(
        "--listen",
        metavar="ENDPOINT",
        help="Zenoh endpoint, like tls/0.0.0.0:7447 (default: only a private socket of this run)",
    )
    command.add_argument(
        "--connect", metavar="ENDPOINT", help="a Zenoh router's endpoint, instead of listening"
    )
    command.add_argument(
        "--prometheus",
        metavar="[HOST:]PORT",
        help="answer Prometheus there, under /metrics (HOST: the loopback)",
    )
    arguments = command.parse_args()

    def body() -> None:
        check_endpoints(arguments)
        port = Port.parse(arguments.prometheus) if arguments.prometheus else None
        run = Run.open(arguments.run)
        run.check(inputs.sources(run.description))
        session = open_bus(run, arguments)
        try:
            host = EnvHost(run, session)
            report = host.report
            with exposed(port, run.keys.run, lambda: report.heartbeat.newest, report.counts):
                host.serve(arguments.patience)
        finally:
            session.close()
            if not arguments.connect:
                remove_local_endpoint(run.local_bus.locator)

    serve(body)


if __name__ == "__main__":
    main()
