"""The env host: plays the environment with all agents in lock-step, and logs every step.

It is the centre of the bus's star. Its log is written ahead of what it publishes, so that it can
be killed at any moment: started again, it continues where the log ends.
"""

import json
import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from otc_dist.bus.endpoints import remove_local_endpoint
from otc_dist.bus.handshake import offer
from otc_dist.bus.keys import HOST
from otc_dist.bus.lockstep import HostLockstep
from otc_dist.bus.messages import Action, Moment, Observation, Phase, Status, StepOutcome
from otc_dist.bus.presence import Presence
from otc_dist.bus.session import Session
from otc_dist.bus.status import Heartbeat
from otc_dist.bus.wire import Rejections
from otc_dist.datasets import inputs
from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.header import LogHeader, versions
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import check_whole
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.run.host_state import HostState
from otc_dist.system import durable
from otc_dist.system.ports import Port
from otc_dist.system.processor import kind
from otc_dist.terminal.amounts import plus_minus
from otc_dist.transitions import Float32, JointStep

from .acting import confirmed
from .deployment_conditions import DeploymentConditions
from .exposition import Counts, exposed
from .history import history_of
from .host_bus import open_bus
from .process import Run, check_endpoints, parser, recording, serve
from .restore import check_begun, resimulate

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
        self._rejections = Rejections()
        self._schedule = run.schedule
        self._state = HostState.begin(self._folder)
        self._presence = Presence(session, run.keys, run.team.names)
        self._lockstep = HostLockstep(
            session,
            run.keys,
            run.team.agents,
            run.copies,
            run.description.bus.answer_deadline,
            self._rejections,
            self._presence.changed,
        )
        self._phase, self._deployment, self._total = "starting", 0, 0
        self._rollout: Rollout | None = None  # of the phase under way
        self._metrics: dict[str, float] = {}
        self._returns: dict[str, float] = {}  # the newest of each kind
        self.heartbeat = Heartbeat(session, run.keys, HOST, self._rejections, self._status)
        for agent in run.team.names:
            session.answer(run.keys.history(agent), history_of(run, agent, self._rejections))
        offer(session, run.keys, run.spec)
        session.declare_alive(run.keys.alive(HOST))

    def serve(self, patience: float | None) -> None:
        """Go through all phases that are not finished yet.

        `patience`: seconds to wait first until all learners have come; None: they will.
        """
        with self.heartbeat:
            if patience is not None:
                self._enter("gathering", 0, 0)
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
            self._enter("done", made, 0)
            self._presence.wait_for_none(_FAREWELL)

    def _evaluate(self, k: int) -> None:
        """Play the episodes that count with pi_k, greedily, and write their returns."""
        path, episodes = self._folder.evaluation(k), self._description.evaluation.episodes
        if episodes == 0 or path.exists():
            return
        env_id, copies = self._run.team.env_id, self._run.copies["evaluation"]
        rounds = math.ceil(episodes / copies)
        self._enter("evaluation", k, rounds * self._run.team.max_episode_steps)
        env = registry.make(env_id, copies, self._description.progress(k))
        rollout = self._rollout = Rollout(env, self._description.seed, "evaluation", k, episodes)
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
        self._metrics, self._returns["greedy"] = {"return": mean}, mean
        if rollout.successes is not None:
            self._metrics["success"] = 100 * sum(rollout.successes) / episodes
        self.heartbeat.publish()
        means = " ".join(f"{name} {value:.2f}" for name, value in self._metrics.items())
        log.info("evaluation of policy %d, means: %s", k, means)

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
            self._enter("approval", k, 0)
            self._conditions.wait_for_approval(k)
        self._enter("deployment", k, self._schedule.steps)
        description = self._description
        env = registry.make(self._run.team.env_id, description.env.copies, description.progress(k))
        rollout = self._rollout = Rollout(env, description.seed, "deployment", k)
        with recording(path, "the steps recorded so far are kept"):
            writer, last = self._open_log(path, k, rollout)
            try:
                while rollout.step < self._schedule.steps:
                    answers = self._ask("deployment", k, rollout.step, rollout.observations, last)
                    self._note_deployed(k, answers)
                    tags = self._schedule.exploring(rollout.step)
                    last = rollout.advance(_actions(answers), tags)
                    self._conditions.check_rewards(last)
                    writer.write(last)
                self._ask("deployment", k, rollout.step, rollout.observations, last)
                writer.finish(self._state.policies)
            finally:
                writer.close()
        env.close()
        log.info("deployment %d: %d steps in %s", k, self._schedule.steps, path.name)
        if found := self._conditions.measured(k):
            self._metrics = {"measured": found.mean, "error": found.error}
            self._returns["measured"] = found.mean
            log.info("deployment %d measured %s", k, plus_minus(found.mean, found.error))
        self.heartbeat.publish()

    def _open_log(self, path: Path, k: int, rollout: Rollout) -> tuple[LogWriter, JointStep | None]:
        """The log to write, and its last step; `rollout` has caught up with it."""
        if partial_path(path).exists():
            writer, steps = LogWriter.resume(path)
            try:
                check_begun(writer.header, self._run.keys.run, k, partial_path(path))
                log.info("deployment %d continues after %d logged steps", k, steps)
                return writer, resimulate(rollout, path, steps, self._run.moved)
            except BaseException:
                writer.close()
                raise
        description = self._description
        header = LogHeader(
            run=self._run.keys.run,
            deployment=k,
            seed=description.seed,
            description=description.to_toml(),
            description_digest=description.tuning_digest(),
            team=self._run.team,
            copies=description.env.copies,
            versions=versions() | dict(rollout.simulator) | {"processor": kind()},
        )
        return LogWriter.create(path, header), None

    def _ask(
        self,
        phase: Phase,
        k: int,
        step: int,
        observations: Sequence[Float32],
        last: JointStep | None,
    ) -> list[Action]:
        """Ask all agents; in a deployment's last question nobody acts any more."""
        moment = Moment(phase, k, self._state.epoch, step)
        questions = [
            Observation(moment, seen, StepOutcome.of(last, index) if last else None)
            for index, seen in enumerate(observations)
        ]
        acting = phase == "evaluation" or step < self._schedule.steps
        return self._lockstep.ask(questions, acting=acting)

    @property
    def _greedy(self) -> tuple[bool, ...]:
        """Behaviour tags: no agent explores."""
        return (False,) * len(self._run.team.agents)

    def _note_deployed(self, k: int, answers: Sequence[Action]) -> None:
        """Note, before the first step is logged, which policies act; they must stay the same."""
        begun = self._state.policies if self._state.deployment == k else {}
        acting = self._confirmed(begun, answers, f"deployment {k}")
        if acting != begun:
            self._state = self._state.deploying(k, acting, self._folder)

    def _confirmed(
        self, begun: Mapping[str, str], answers: Sequence[Action], where: str
    ) -> Mapping[str, str]:
        policies = (answer.policy for answer in answers)
        acting = dict(zip(self._run.team.names, policies, strict=True))
        return confirmed(begun, acting, where, self._run.moved)

    def _enter(self, phase: str, k: int, total: int) -> None:
        self._phase, self._deployment, self._total = phase, k, total
        self._rollout, self._metrics = None, {}
        self.heartbeat.publish()

    def _status(self) -> Status:
        rollout = self._rollout  # one that goes over a log again shows its progress, too
        return Status(
            HOST,
            self._phase,
            self._deployment,
            rollout.step if rollout else 0,
            self._total,
            metrics={"epoch": float(self._state.epoch), **self._metrics},
            awaits=self._lockstep.awaited,
        )

    def counts(self) -> Counts:
        """What is counted and measured, from any thread."""
        lockstep = self._lockstep
        returns, rejected = dict(self._returns), self._rejections.by_reason()
        return Counts(lockstep.answered, lockstep.resent, rejected, returns)


def _actions(answers: Sequence[Action]) -> list[Float32]:
    return [answer.actions for answer in answers if answer.actions is not None]


def main() -> None:
    """Entry point of `python -m otc_dist.services.env_host`."""
    command = parser(
        "env_host",
        "Plays a run's environment with all its learners in lock-step and logs every step.",
        "The launcher starts one of these beside one learner per agent. By hand:\n"
        "  python -m otc_dist.services.env_host --run runs/my_run\n"
        "  python -m otc_dist.services.learner --run runs/my_run --agent agent_0   (and so on)\n"
        "Killed or stopped, it continues where its log ends when it is started again.\n"
        "Exit status: 0 done, 1 failed, 2 a mistake to fix, 128 + n stopped by signal n.",
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
            with exposed(port, run.keys.run, lambda: host.heartbeat.newest, host.counts):
                host.serve(arguments.patience)
        finally:
            session.close()
            if not arguments.connect:
                remove_local_endpoint(run.local_bus.locator)

    serve(body)


if __name__ == "__main__":
    main()
