import os
import signal
import sys
from pathlib import Path

import pytest

from otc_dist.launch.supervise import job_order, standstill
from otc_dist.launch.supervise import jobs as jobs_module
from otc_dist.launch.supervise.health import LIMIT
from otc_dist.launch.supervise.jobs import FailedError, Job, ProgressLines, StoppedError, run_jobs

PATIENCE = 60.0  # seconds; only a test that fails waits as long
MAKE = "import sys, pathlib; pathlib.Path(sys.argv[1]).touch()"


def job(folder: Path, name: str, code: str = MAKE, needs: tuple[Path, ...] = ()) -> Job:
    command = (sys.executable, "-c", code, str(folder / name))
    return Job(name, command, folder / name, folder / f"{name}.log", needs)


def ends(jobs: list[Job], workers: int) -> dict[str, float]:
    """Job -> when it would end."""
    chains, now, ended, running = (
        job_order.chains(jobs),
        0.0,
        dict[str, float](),
        dict[str, float](),
    )
    made = {job.product: job.name for job in jobs}
    while len(ended) < len(jobs):
        begun = ended.keys() | running.keys()
        waiting = [job for job in jobs if job.name not in begun]
        ready = [job for job in waiting if all(made[path] in ended for path in job.needs)]
        if ready and len(running) < workers:
            left = sum(job.seconds for job in jobs if job.name not in ended)
            job = job_order.next_job(ready, chains, left, workers)
            running[job.name] = now + job.seconds
            continue
        name = min(running, key=running.__getitem__)
        now = ended[name] = running.pop(name)
    return ended


def test_cores_are_busy_to_the_end_and_seeds_are_complete_early() -> None:
    jobs: list[Job] = []

    def add(name: str, seconds: float, *needs: Job) -> Job:
        path = Path(name)
        jobs.append(Job(name, (), path, path, tuple(job.product for job in needs), seconds))
        return jobs[-1]

    for seed in range(5):
        pi_0 = [add(f"{seed} agent_{index}", 200) for index in range(2)]
        evaluated = add(f"{seed} evaluated", 15, *pi_0)
        for arm, seconds in (("short", 100), ("also short", 100), ("long", 400)):
            add(f"{seed} {arm}", seconds, evaluated)
    found, ideal = ends(jobs, 2), sum(job.seconds for job in jobs) / 2
    assert max(found.values()) <= 1.03 * ideal  # by the given order alone 1.1
    assert max(when for name, when in found.items() if name[0] == "0") <= 830  # the first possible


def test_jobs_run_when_what_they_need_is_there(tmp_path: Path) -> None:
    first = job(tmp_path, "first")
    look = "import sys, pathlib; p = pathlib.Path(sys.argv[1]); (p.parent / 'first').rename(p)"
    finished: list[str] = []
    run_jobs(
        [job(tmp_path, "second", look, (first.product,)), first],
        2,
        lambda done: finished.append(done.name),
        PATIENCE,
    )
    assert finished == ["first", "second"]


def test_finished_jobs_are_skipped(tmp_path: Path) -> None:
    (tmp_path / "old").touch()
    finished: list[str] = []
    run_jobs(
        [job(tmp_path, "old", "raise SystemExit(1)"), job(tmp_path, "new")],
        1,
        lambda done: finished.append(done.name),
        PATIENCE,
    )
    assert finished == ["new"]


@pytest.mark.parametrize(
    ("code", "status", "expected"),
    [
        ("raise SystemExit('error: no such thing')", 1, "with status 1: no such thing"),
        ("import sys; print('error: fix it'); sys.exit(2)", 2, "bad: fix it"),
        ("import os; os.kill(os.getpid(), 9)", 1, "was killed by SIGKILL"),
        ("pass", 1, "exited with status 0: it printed nothing"),  # and left no product
    ],
)
def test_a_failure_is_one_line_that_names_the_job(
    tmp_path: Path, code: str, status: int, expected: str
) -> None:
    waits = job(tmp_path, "waits", "import signal; signal.pause()")
    with pytest.raises(FailedError) as failed:
        run_jobs([waits, job(tmp_path, "bad", code)], 2, lambda done: None, PATIENCE)
    assert failed.value.status == status
    message = str(failed.value)
    assert message.startswith("bad: ") and expected in message and "\n" not in message


@pytest.mark.parametrize(
    ("what", "patience", "why"),
    [
        ("os.kill(os.getpid(), signal.SIGKILL)", PATIENCE, ""),
        ("os.kill(os.getpid(), signal.SIGSTOP)", PATIENCE, ", since it is frozen"),
        ("signal.pause()", 1.0, ", since it has done nothing for 1 s"),
    ],
)
def test_what_is_killed_or_stands_still_is_begun_again_and_the_others_go_on(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    what: str,
    patience: float,
    why: str,
) -> None:
    monkeypatch.setattr(standstill, "FROZEN_AFTER", 0.5)
    monkeypatch.setattr(jobs_module, "LOOK_EVERY", 0.05)
    mark = tmp_path / "mark"
    once = f"import os, signal, pathlib; mark = pathlib.Path({str(mark)!r})\n"
    once += f"if not mark.exists():\n    mark.touch(); {what}\n{MAKE}"
    finished: list[str] = []
    run_jobs(
        [job(tmp_path, "odd", once), job(tmp_path, "other", needs=(mark,))],
        2,
        lambda done: finished.append(done.name),
        patience,
    )
    assert sorted(finished) == ["odd", "other"]
    newest = [line for line in capsys.readouterr().out.splitlines() if "done in" not in line]
    assert newest == [f"odd: was killed by SIGKILL{why}; starts again (1 of {LIMIT})"]


def test_an_interrupt_leaves_no_process(tmp_path: Path) -> None:
    newest = tmp_path / "pid"
    code = f"import os, signal, pathlib; pathlib.Path({str(newest)!r}).write_text(str(os.getpid()))"
    interrupt = job(tmp_path, "interrupt", f"import os; os.kill({os.getpid()}, {signal.SIGINT:d})")
    waits = job(tmp_path, "waits", f"{code}; open(r'{tmp_path}/up', 'w'); signal.pause()")
    jobs = [waits, Job(**{**vars(interrupt), "needs": (tmp_path / "up",)})]
    with pytest.raises(StoppedError, match="SIGINT") as stopped:
        run_jobs(jobs, 2, lambda done: None, PATIENCE)
    assert stopped.value.status == 130
    with pytest.raises(ProcessLookupError):
        os.kill(int(newest.read_text()), 0)


def test_what_a_job_tells_is_a_share_and_a_place(capsys: pytest.CaptureFixture[str]) -> None:
    on_progress = ProgressLines()
    on_progress(0.25, "offline 1 of 4")
    on_progress(0.5, "offline 2 of 4")  # too soon after the first
    assert capsys.readouterr().out == "0.2500 offline 1 of 4\n"
