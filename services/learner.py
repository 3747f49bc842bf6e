"""A learner: one agent's brain on the bus. It reads its own agent's files and keys, no others.

It trains offline, then answers the env host's questions. What it must know to answer, it knows
or catches up on: an answer by pi_k needs D_1 .. D_k, which it gathers from the answers' outcomes
or, after a restart, asks of the env host's log.
"""

import logging
from typing import TYPE_CHECKING

from otc_dist.bus.history import History
from otc_dist.bus.lockstep import GaveUpError, LearnerLockstep
from otc_dist.bus.messages import Action, Observation
from otc_dist.bus.session import Session
from otc_dist.bus.wire import Rejections
from otc_dist.datasets import inputs
from otc_dist.description import user_code
from otc_dist.envs import registry
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError, unknown

from .gathering import Gathering
from .learner_bus import open_bus
from .learner_report import LearnerReport
from .process import FailureError, Run, check_endpoints, parser, serve
from .recommender import Recommender

if TYPE_CHECKING:
    from otc_dist.learner.learner import Learner

log = logging.getLogger(__name__)

_LOOK = 0.5  # seconds between two looks at whether the env host still lives
_FAREWELL = 10.0  # seconds to wait for the env host's end after the last answer


class LearnerService:
    """One agent's learner: pi_0, then whatever the env host asks, until it says done."""

    def __init__(
        self, run: Run, agent: AgentSpec, session: Session, rejections: Rejections
    ) -> None:
        self._run, self._agent, self._name = run, agent, agent.name
        self._folder = run.folder
        self._report = LearnerReport(session, run.keys, run.folder, agent.name, rejections)
        self.heartbeat = self._report.heartbeat
        self._lockstep = LearnerLockstep(session, run.keys, agent, run.copies, rejections)
        copies, deadline = run.description.env.copies, run.description.bus.answer_deadline
        self._history = History(session, run.keys, agent, copies, deadline, rejections)
        schedule, index = run.schedule, run.team.index(agent.name)
        self._steps, self._own = schedule.steps, schedule.own(index)
        self._explores = [schedule.exploring(step)[index] for step in range(schedule.steps)]
        self._gathering = Gathering(copies, self._own, self._history.fetch)
        # By a clock another action may have been executed than was answered: the log knows.
        self._gathers = run.description.deployment.rate_hz is None
        self._recommender = Recommender(run, agent.name, self._history.fetch)
        self._last = run.description.deployment.count  # no tuning follows what comes after it
        self._buffer_complete = True  # whether the learner's buffer holds D_1 .. D_tuned
        self._answered: Action | None = None
        session.declare_alive(run.keys.alive(agent.name))

    def serve(self) -> None:
        """Train offline on B_0, then answer until the run is done."""
        self._task = registry.task(self._run.team.env_id)
        self._load(self._last)
        if self._learner.tuned < 0:
            self._pretrain()
        self._ready()
        done = False
        while not done:
            question = self._lockstep.question(_LOOK)
            if question is not None:
                done = self._respond(question)
            else:
                self._check_host()
        self._leave()

    def _load(self, newest: int) -> None:
        """A learner with the newest sound checkpoint up to pi_newest; a fresh one if none is."""
        self._learner = self._fresh()
        paths = [self._folder.checkpoint(self._name, k) for k in range(newest, -1, -1)]
        paths.append(self._folder.offline_checkpoint(self._name))
        for path in (path for path in paths if path.exists()):
            try:
                self._learner.load(path)
                log.info("loaded %s", path.name)
                break
            except UserError as error:
                log.warning("%s; trying an older one", error)
                self._learner = self._fresh()
        else:
            if self._run.description.offline.policies:
                first = self._folder.checkpoint(self._name, 0)
                raise UserError(
                    f"{first} is missing or damaged: this run did not train it but took it from"
                    " another one (--from); begin a new run"
                )
        self._buffer_complete = self._learner.tuned <= 0
        self._digest = self._learner.policy_digest()

    def _fresh(self) -> "Learner":
        """A learner with B_0 from its agent's file, the only data file that this process opens.

        The file is read again for another one: holding its content would double the memory.
        """
        # Imported here: with torch it takes seconds, in which the heartbeat beats already.
        from otc_dist.datasets import store
        from otc_dist.learner.learner import Learner

        dataset, agent = self._run.description.dataset, self._agent
        path = store.agent_file(dataset.name, agent.name, dataset.transitions)
        data = store.load_agent(path, agent.name)
        team = self._run.team
        place = (team.index(agent.name), len(team.agents))
        return Learner(self._run.description.trusted(), agent, data, self._task, place)

    def _pretrain(self) -> None:
        offline = self._folder.offline_checkpoint(self._name)
        self._learner.pretrain(self._report.trained, lambda: self._learner.save(offline))
        self._trained()
        offline.unlink(missing_ok=True)

    def _respond(self, question: Observation) -> bool:
        """Answer a question, training first if it asks for a later policy; whether all is done."""
        moment = question.moment
        if self._answered is not None and self._answered.moment == moment:
            self._lockstep.answer(self._answered)  # it was lost, or came too late
            return False
        if moment.phase == "done" or question.observations is None:
            tuned = min(moment.policy, self._last)
            self._reach(tuned)
            self._repair(tuned)
            self._recommender.recommend(moment.deployment, tuned)
            self._answer(Action(moment, None, self._digest))
            return True
        if moment.phase == "deployment" and moment.step == self._steps:
            # Everybody's last step is logged: say so at once, then train.
            self._gathering.take(question)
            self._answer(Action(moment, None, self._digest))
            if moment.deployment <= self._last:
                self._reach(moment.deployment)
            else:
                self._recommender.take(moment.deployment, self._gathering.all(moment.deployment))
            return False
        self._reach(moment.policy)
        gathers = moment.phase == "deployment" and self._gathers
        if gathers:
            self._gathering.take(question)
        observations = question.observations
        actions = self._learner.act(
            observations,
            moment.phase,
            moment.deployment,
            moment.step,
            exploring=moment.phase == "deployment" and self._explores[moment.step],
        )
        self._answer(Action(moment, actions, self._digest))
        if gathers:
            self._gathering.acted(moment, observations, actions)
        return False

    def _answer(self, action: Action) -> None:
        self._answered = action
        self._lockstep.answer(action)

    def _reach(self, policy: int) -> None:
        """Hold pi_policy: tune on what is missing, or go back to an older checkpoint."""
        if self._learner.tuned > policy:
            # The env host has lost the end of its log (a power cut), and plays it again.
            self._load(policy)
        while self._learner.tuned < policy:
            if self._learner.tuned < 0:
                self._pretrain()
            else:
                self._tune(self._learner.tuned + 1)

    def _repair(self, tuned: int) -> None:
        """Make again what the disk has damaged of its checkpoints since they were written.

        Nobody has read them since, and the env host, whose log that takes, is about to leave.
        """
        paths = [self._folder.checkpoint(self._name, k) for k in range(tuned + 1)]
        for k, path in enumerate(paths):
            try:
                self._learner.check(path)
            except UserError as error:
                log.warning("%s: it and what follows are made again", error)
                for later in paths[k:]:
                    later.unlink(missing_ok=True)
                self._load(k - 1)
                return self._reach(tuned)

    def _tune(self, k: int) -> None:
        """Line 5 to 16 of Algorithm 1: D_k joins the buffer, alpha adapts, L updates follow.

        Where it is to go on from an earlier policy whose checkpoint is lost, it holds an older one
        afterwards: ask again.
        """
        if not self._buffer_complete:
            own, fetched = (self._own.start, self._own.stop), []
            for j in range(1, k):  # which may take long: it is seen to get further
                self._report.enter("starting", k, j, k - 1)
                fetched.append(self._history.fetch(j, *own))
            self._learner.restore(fetched)
            self._buffer_complete = True
        data = self._gathering.all(k)
        self._recommender.take(k, data)
        if (best := self._recommender.reverted(k)) is not None:
            log.info("deployment %d fell short: tuning continues from policy %d", k, best)
            try:
                self._learner.revert(self._folder.checkpoint(self._name, best))
            except UserError as error:
                log.warning("%s; it and what follows are made again", error)
                self._load(best)
                return
        self._learner.tune(k, data, self._report.trained)
        self._trained()
        self._ready()

    def _trained(self) -> None:
        self._digest = self._learner.policy_digest()
        self._learner.save(self._folder.checkpoint(self._name, self._learner.tuned))
        self.heartbeat.publish()

    def _ready(self) -> None:
        self._report.enter("ready", max(self._learner.tuned, 0))
        self.heartbeat.publish()

    def _check_host(self) -> None:
        silence, deadline = self._lockstep.host_silence(), self._run.description.bus.answer_deadline
        if silence > deadline:
            raise GaveUpError(f"nothing was heard of the env host for {deadline:g} s")

    def _leave(self) -> None:
        """Answer once more if asked, until the env host says that it has heard everybody."""
        self._report.enter("done", self._learner.tuned)
        while self._lockstep.host_phase != "done" and self._lockstep.host_silence() < _FAREWELL:
            question = self._lockstep.question(_LOOK / 5)
            if question is not None:
                self._respond(question)


def main() -> None:
    """Entry point of `python -m otc_dist.services.learner`."""
    command = parser(
        "learner",
        "Trains one agent of a run and acts for it: offline on its own data set, then online.",
        "The launcher starts one of these per agent beside the env host. By hand:\n"
        "  python -m otc_dist.services.env_host --run runs/my_run\n"
        "  python -m otc_dist.services.learner --run runs/my_run --agent agent_0\n"
        "Killed or stopped, it continues from its newest checkpoint when it is started again.\n"
        "Exit status: 0 done, 1 failed, 2 a mistake to fix, 128 + n stopped by signal n.",
    )
    command.add_argument("--agent", required=True, metavar="NAME", help="whose learner, as agent_0")
    command.add_argument(
        "--connect",
        metavar="ENDPOINT",
        help="the env host's Zenoh endpoint, or a router's (default: this run's private socket)",
    )
    arguments = command.parse_args()

    def body() -> None:
        check_endpoints(arguments)
        run = Run.open(arguments.run)
        if arguments.agent not in run.team.names:
            raise unknown("agent", arguments.agent, run.team.names)
        agent = run.team.agents[run.team.index(arguments.agent)]
        run.check(inputs.data(run.description, [agent.name]) | inputs.code(run.description))
        rejections = Rejections()
        with open_bus(run, agent.name, arguments, rejections) as session:
            own = (FailureError, GaveUpError)
            with user_code.answers_for(*run.description.parts, but=own):
                service = LearnerService(run, agent, session, rejections)
                with service.heartbeat:
                    service.serve()

    serve(body)


if __name__ == "__main__":
    main()
