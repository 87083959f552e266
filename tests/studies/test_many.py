"""Studies: nothing finished is lost or computed again, whatever ends a study, and the result is always the same."""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import study_tasks
from forking import Forked, Forks, forks
from killed_studies import (
    DEADLINE,
    TESTS,
    computed,
    is_alive,
    kill_and_resume,
    records,
    result,
    size_of,
    study_process,
    wait_for,
)

from tensegrity_mj.errors import ClusterError, FormatError, MissingLibraryError, OptionError
from tensegrity_mj.studies import store
from tensegrity_mj.studies.many import Study, run_many, task_name
from tensegrity_mj.studies.plain import canonical, difference, digest, plain
from tensegrity_mj.studies.workers import Backend, Workers

pytestmark = pytest.mark.workers
HERE = Workers(backend=Backend.THIS_PROCESS)
TWO = Workers(2)
POINTS = [{"x": x} for x in range(6)]


def known_name(outcome: str) -> str:
    """How the log calls the point of an outcome of `noted`."""
    return str(round(json.loads(outcome)["values"]["third"] * 3))


def test_kill_9_again_and_again(tmp_path: Path) -> None:
    code = "run_many(study_tasks.noted, [{'x': x, 'seconds': 0.01} for x in range(300)], folder, workers=Workers(2))"
    folder = tmp_path / "study"
    hits = kill_and_resume(code, folder, tmp_path, kills=5, seed=3, pause=0.05, name_of=known_name)
    assert hits >= 2  # the others came before the first new point
    counted = Counter(key for key, _ in records(folder))
    assert len(counted) == 300
    assert set(counted.values()) == {1}
    run_many(study_tasks.noted, [{"x": x, "seconds": 0.01} for x in range(300)], tmp_path / "whole", workers=HERE)
    assert result(folder) == result(tmp_path / "whole")


# Torn and damaged records ----------------------------------------------------------------------------------------


def test_a_record_torn_anywhere_is_computed_again(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    run_many(study_tasks.noted, POINTS, folder, workers=HERE)
    whole, expected = (folder / store.POINTS).read_bytes(), result(folder)
    last = whole.rstrip(b"\n").rfind(b"\n") + 1
    lengths = [*range(last, len(whole), 11), len(whole) - 3, len(whole) - 2, len(whole) - 1]
    for length in lengths:  # what a write can leave of the last line
        (folder / store.POINTS).write_bytes(whole[:length])
        assert run_many(study_tasks.noted, POINTS, folder, workers=HERE).computed == 1
        assert (folder / store.POINTS).read_bytes() == whole
    assert result(folder) == expected


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line.replace(b"0.3333", b"0.3334"),
        lambda line: b"\0" * (len(line) - 1) + b"\n",
        lambda line: line[: len(line) // 2] + b"\n",
        lambda line: b"[]\n",
        lambda line: b'{"check": 1}\n',
        lambda line: b"\xff\xfe\n",
    ],
    ids=["changed", "zeros", "half", "list", "empty", "no text"],
)
def test_a_damaged_record_is_recognised(damage: Any, tmp_path: Path) -> None:
    folder = tmp_path / "study"
    run_many(study_tasks.noted, POINTS, folder, workers=HERE)
    expected = result(folder)
    lines = (folder / store.POINTS).read_bytes().splitlines(keepends=True)
    assert damage(lines[1]) != lines[1]
    (folder / store.POINTS).write_bytes(b"".join([lines[0], damage(lines[1]), *lines[2:]]))
    (folder / store.RESULT).unlink()
    assert run_many(study_tasks.noted, POINTS, folder, workers=HERE).computed == 1
    assert result(folder) == expected
    assert run_many(study_tasks.noted, POINTS, folder, workers=HERE).computed == 0


def test_files_that_a_kill_left_half_written_are_removed(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    points = [{"how": "files"}]
    run_many(study_tasks.troubled, points, folder, workers=HERE)
    for left in (folder / ".new-abc.part.json", folder / store.FILES / ".new-abc.part.txt"):
        left.write_text("half")
    run_many(study_tasks.troubled, points, folder, workers=HERE)
    assert not list(folder.rglob(".new-*"))
    # A start that was killed before it wrote anything else leaves no foreign folder.
    (tmp_path / "fresh").mkdir()
    (tmp_path / "fresh" / ".new-abc.part.json").write_text("half")
    (tmp_path / "fresh" / store.LOCK).write_text("")
    assert run_many(study_tasks.troubled, points, tmp_path / "fresh", workers=HERE).computed == 1


# One result -----------------------------------------------------------------------------------------------------


TROUBLES = [{"how": how} for how in ("well", "infeasible", "mistake", "killed", "exit", "no dict", "not plain")]
TROUBLES += [{"how": "well", "more": number} for number in range(8)]


def check_troubles(study: Study) -> None:
    """What becomes of each trouble."""
    reported = {
        point["how"]: (outcome.get("error"), outcome.get("reason"), "traceback" in outcome)
        for point, outcome in zip(study.points, study.outcomes, strict=True)
    }
    assert reported["well"] == (None, None, False)
    assert reported["infeasible"] == ("InfeasibleError", "no admissible u", False)
    assert reported["mistake"] == ("ZeroDivisionError", "division by zero", True)
    assert reported["exit"] == ("SystemExit", "leaving", True)
    assert reported["no dict"][:2] == ("OptionError", "the task returned a list; it must return a dict of plain values")
    assert reported["not plain"][0] == "OptionError"
    assert "the task's result['x']['y']" in (reported["not plain"][1] or "")
    if "killed" in reported:
        assert reported["killed"][0] == "WorkerDied"
    assert all(outcome["status"] == "done" for outcome in study.outcomes[7:])


def test_troubles_are_data_and_the_result_is_the_same_on_a_cluster(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    for number in (1, 2):
        study = run_many(study_tasks.troubled, TROUBLES, tmp_path / f"processes{number}", workers=Workers(number))
        check_troubles(study)
        assert study.computed == len(TROUBLES)
    import dask

    with (
        # Dask itself would give a point that kills its worker to three more of them first.
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        address = cluster.scheduler_address
        for name, workers in {
            "client": Workers(backend=Backend.CLUSTER, client=client),
            "address": Workers(1, Backend.CLUSTER, address=address),
        }.items():
            check_troubles(run_many(study_tasks.troubled, TROUBLES, tmp_path / name, workers=workers))
    results = {result(folder) for folder in tmp_path.iterdir()}
    assert len(results) == 1
    assert b"Traceback" not in results.pop()
    trace = next(outcome for _, outcome in records(tmp_path / "client") if outcome.get("error") == "ZeroDivisionError")
    assert "in troubled" in trace["traceback"]
    assert "workers.py" not in trace["traceback"]


@pytest.fixture(scope="module")
def with_dask() -> Iterator[Forks]:
    """Processes that have imported Dask, which takes longer than all that they do."""
    pytest.importorskip("distributed")
    with forks("import distributed, tensegrity_mj.studies.many\n") as found:
        yield found


@pytest.fixture
def dask_processes(tmp_path: Path, with_dask: Forks) -> Iterator[tuple[str, dict[str, Forked]]]:
    """A scheduler and two workers of one thread, each a process of its own: (address, processes)."""
    distributed = pytest.importorskip("distributed")
    environment = {"PYTHONPATH": str(TESTS), "STUDY_LOG": str(tmp_path / "log")}
    with contextlib.ExitStack() as stack:

        def start(kind: str, options: str) -> Forked:
            process = with_dask.start(tmp_path, f"distributed.cli.dask_{kind}", *options.split(), **environment)
            stack.callback(process.kill)
            return process

        file = tmp_path / "scheduler.json"
        processes = {"scheduler": start("scheduler", "--scheduler-file scheduler.json --host 127.0.0.1 --port 0")}
        wait_for(lambda: file.exists() and file.read_text().endswith("}"))
        address = json.loads(file.read_text())["address"]
        for name in ("worker0", "worker1"):
            processes[name] = start("worker", f"{address} --no-nanny --nthreads 1 --no-dashboard")
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=DEADLINE)
        yield address, processes


SLOW_POINTS = [{"x": x, "seconds": 0.25} for x in range(16)]


def test_a_lost_workers_points_are_done_again(tmp_path: Path, dask_processes: Any) -> None:
    address, processes = dask_processes
    lost = processes["worker0"]

    def at_work() -> bool:
        return any(pid == lost.pid for _, pid in computed(tmp_path / "log"))

    killer = threading.Thread(target=lambda: (wait_for(at_work), lost.kill()))
    killer.start()
    study = run_many(study_tasks.noted, SLOW_POINTS, workers=Workers(backend=Backend.CLUSTER, address=address))
    killer.join()
    assert study.failed == []
    assert study.values("third") == [point["x"] / 3 for point in SLOW_POINTS]
    begun = Counter(key for key, _ in computed(tmp_path / "log"))
    assert len(begun) == len(SLOW_POINTS)
    # Begun twice: what the worker that was killed had begun, and a result that it still had.
    assert 1 <= sum(begun.values()) - len(begun) <= 2


@pytest.mark.parametrize(
    ("names", "number", "said"),
    [
        (["scheduler"], signal.SIGKILL, "does not answer any more"),
        (["scheduler"], signal.SIGSTOP, "does not answer any more"),
        (["worker0", "worker1"], signal.SIGKILL, "has had no worker for 1 s"),
    ],
    ids=["scheduler killed", "scheduler frozen", "all workers killed"],
)
def test_a_lost_cluster_ends_the_study_and_what_is_finished_is_kept(
    tmp_path: Path, dask_processes: Any, monkeypatch: pytest.MonkeyPatch, names: Any, number: Any, said: str
) -> None:
    from tensegrity_mj.studies import workers

    # As short as what is lost; what still lives has its usual time, however slow the machine is.
    for limit in ["WORKER_TIMEOUT"] if "worker0" in names else ["ANSWER_TIMEOUT", "CLOSE_TIMEOUT"]:
        monkeypatch.setattr(workers, limit, 5 if limit == "ANSWER_TIMEOUT" else 1)
    address, processes = dask_processes
    folder = tmp_path / "study"

    def end() -> None:
        wait_for(lambda: len(records(folder)) >= 2)
        for name in names:
            processes[name].send_signal(number)

    killer = threading.Thread(target=end)
    killer.start()
    with pytest.raises(ClusterError, match=said) as caught:
        run_many(study_tasks.noted, SLOW_POINTS, folder, workers=Workers(backend=Backend.CLUSTER, address=address))
    killer.join()
    finished = len(records(folder))
    assert 2 <= finished < len(SLOW_POINTS)
    assert f"{finished} of 16 points are finished and kept in {folder}; run the same again" in str(caught.value)
    study = run_many(study_tasks.noted, SLOW_POINTS, folder, workers=TWO)
    assert study.computed == len(SLOW_POINTS) - finished
    assert study.values("third") == [point["x"] / 3 for point in SLOW_POINTS]


def test_a_cluster_that_cannot_import_the_task_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        (tmp_path / "only_here.py").write_text("def task(point):\n    return point\n")
        monkeypatch.syspath_prepend(tmp_path)
        import only_here  # type: ignore[import-not-found]

        with pytest.raises(OptionError, match="the cluster cannot import 'only_here'"):
            run_many(only_here.task, [{"x": 1}], workers=Workers(backend=Backend.CLUSTER, client=client))


def test_this_process_gives_the_same_result(tmp_path: Path) -> None:
    troubles = [point for point in TROUBLES if point["how"] != "killed"]
    check_troubles(run_many(study_tasks.troubled, troubles[:3] + TROUBLES[4:], tmp_path / "here", workers=HERE))
    run_many(study_tasks.troubled, troubles, tmp_path / "processes", workers=TWO)
    assert result(tmp_path / "here") == result(tmp_path / "processes")


def test_a_worker_that_dies_once_costs_nothing_but_time(tmp_path: Path) -> None:
    points = [
        *POINTS,
        {"how": "killed once", "mark": str(tmp_path / "mark")},
        *({"how": "well", "n": n} for n in range(5)),
    ]
    points = [point if "how" in point else {"how": "well", **point} for point in points]
    study = run_many(study_tasks.troubled, points, tmp_path / "study", workers=TWO)
    assert study.failed == []
    assert study.values("x")[6] == 2
    assert set(Counter(key for key, _ in records(tmp_path / "study")).values()) == {1}


def test_workers_have_one_thread() -> None:
    study = run_many(study_tasks.troubled, [{"how": "threads"}], workers=TWO)
    assert study.outcomes[0]["values"] == {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


# What is given and what comes back ------------------------------------------------------------------------------


def test_workers_find_modules_where_the_process_is_now(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_many(
        study_tasks.noted, [{"x": 1, "seconds": 0.0}], tmp_path / "before", workers=TWO
    )  # whose workers wait for more
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "task_of_now.py").write_text("def task(values):\n    return {'y': 2 * values['x']}\n", encoding="utf-8")
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    task = importlib.import_module("task_of_now").task
    study = run_many(task, [{"x": 1}, {"x": 2}], tmp_path / "now", workers=TWO)
    assert [one["values"] for one in study.outcomes] == [{"y": 2}, {"y": 4}]


def test_outcomes_are_in_the_order_of_the_points_and_equal_points_are_computed_once(tmp_path: Path) -> None:
    points = [{"x": x, "seconds": 0.03 if x == 0 else 0.0} for x in (0, 5, 3, 5, 1)]
    study = run_many(study_tasks.noted, points, tmp_path / "study", workers=TWO)
    assert study.values("third") == [0.0, 5 / 3, 1.0, 5 / 3, 1 / 3]
    assert study.computed == 4
    data = json.loads(result(tmp_path / "study"))
    assert [entry["point"]["x"] for entry in data["points"]] == [0, 5, 3, 5, 1]
    assert data["task"] == "study_tasks.noted"


def test_values_come_back_as_they_were() -> None:
    (outcome,) = run_many(study_tasks.troubled, [{"how": "well"}], workers=HERE).outcomes
    assert outcome["values"]["x"] == 0.1
    assert outcome["values"]["list"] == [0, 1, 2]
    assert math.isnan(outcome["values"]["nan"])


def test_common_values_reach_the_task_and_belong_to_the_study(tmp_path: Path) -> None:
    study = run_many(study_tasks.noted, [{}, {"seconds": 0.0}], tmp_path, common={"x": 9}, workers=HERE)
    assert study.values("third") == [3.0, 3.0]
    with pytest.raises(OptionError, match="'x' is in `common` too"):
        run_many(study_tasks.noted, [{"x": 1}], common={"x": 9}, workers=HERE)


def test_files_are_kept_with_their_point(tmp_path: Path) -> None:
    points = [{"how": "well"}, {"how": "files"}]
    study = run_many(study_tasks.troubled, points, tmp_path, workers=TWO)
    path = study.file(1, "note.txt")
    assert path == tmp_path / "files" / "000001-note.txt"
    assert path.read_bytes() == b"kept"
    assert study.file(0, "note.txt") is None
    assert run_many(study_tasks.troubled, points, workers=HERE).file(1, "note.txt") is None


def test_no_points_at_all(tmp_path: Path) -> None:
    assert run_many(study_tasks.noted, [], tmp_path).outcomes == ()


def test_the_bar_shows_what_is_left(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class Terminal(StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    run_many(study_tasks.noted, POINTS, tmp_path, workers=HERE, progress=True, label="thirds")
    assert "thirds 100%" in terminal.getvalue()
    assert "6/6" in terminal.getvalue()


def test_nothing_is_shown_unless_requested(capfd: pytest.CaptureFixture[str]) -> None:
    run_many(study_tasks.noted, POINTS, workers=TWO)
    assert capfd.readouterr() == ("", "")


# Whose folder it is ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"task": study_tasks.troubled}, 'task is "study_tasks.noted" there and "study_tasks.troubled" here'),
        ({"points": [*POINTS[:5], {"x": 9}]}, r"points\[5\].x is 5 there and 9 here"),
        ({"points": POINTS[:5]}, "points has 6 entries there and 5 here"),
        ({"points": [{**point, "y": 1} for point in POINTS]}, r"points\[0\].y is given here only"),
        ({"identity": {"version": "2"}}, 'identity.version is "1" there and "2" here'),
        ({"common": {"seconds": 0}}, "common.seconds is 0.0 there and 0 here"),
    ],
    ids=["task", "point", "fewer", "more values", "version", "common"],
)
def test_the_folder_of_another_study_is_refused(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    same: dict[str, Any] = {"task": study_tasks.noted, "points": POINTS, "identity": {"version": "1"}}
    same |= {"common": {"seconds": 0.0}, "folder": tmp_path, "workers": HERE}
    run_many(**same)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.name != store.LOCK}
    with pytest.raises(OptionError, match=rf"holds another study \(({said})\); choose another folder"):
        run_many(**{**same, **change})
    assert before == {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.name != store.LOCK}
    assert run_many(**same).computed == 0


def test_a_folder_that_is_no_study_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "letters.txt").write_text("mine")
    with pytest.raises(OptionError, match=r"no study, and not empty \(it holds letters.txt\)"):
        run_many(study_tasks.noted, POINTS, tmp_path, workers=HERE)
    assert [path.name for path in tmp_path.iterdir()] == ["letters.txt"]
    with pytest.raises(OptionError, match="no study can be kept there"):
        run_many(study_tasks.noted, POINTS, tmp_path / "letters.txt", workers=HERE)


def test_a_study_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    (tmp_path / store.STUDY).write_text('{"format": 1, ')
    with pytest.raises(FormatError, match=r"study\.json: it cannot be read"):
        run_many(study_tasks.noted, POINTS, tmp_path, workers=HERE)


def test_two_processes_on_one_folder_are_refused(tmp_path: Path) -> None:
    code = "run_many(study_tasks.noted, [{'x': x, 'seconds': 0.05} for x in range(2000)], folder, workers=Workers(1))"
    points = [{"x": x, "seconds": 0.05} for x in range(2000)]
    with study_process(code, tmp_path / "study", tmp_path / "log") as process:
        wait_for(lambda: size_of(tmp_path / "study" / store.POINTS) > 0)
        with pytest.raises(OptionError, match=f"process {process.pid} works on this study"):
            run_many(study_tasks.noted, points, tmp_path / "study", workers=HERE)
        process.kill()
        process.wait()
    # The lock went with its holder: another study is what is refused now.
    with pytest.raises(OptionError, match="another study"):
        run_many(study_tasks.noted, POINTS, tmp_path / "study", workers=HERE)


# Stopping -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("who", ["Workers(2)", "Workers(backend=Backend.THIS_PROCESS)"])
def test_an_interrupt_stops_cleanly(number: signal.Signals, who: str, tmp_path: Path) -> None:
    folder, log = tmp_path / "study", tmp_path / "log"
    code = f"""
    from tensegrity_mj.studies.workers import Backend
    try:
        run_many(study_tasks.noted, [{{'x': x, 'seconds': 0.02}} for x in range(120)], folder, workers={who})
    except KeyboardInterrupt as interrupt:
        print(interrupt, file=__import__('sys').stderr)
        raise SystemExit(7)
    """
    with study_process(code, folder, log) as process:
        wait_for(lambda: len(records(folder)) >= 5 or process.poll() is not None)
        process.send_signal(number)
        _, err = process.communicate(timeout=DEADLINE)
    finished = len(records(folder))
    assert process.returncode == 7, err
    assert err.splitlines() == [
        f"{finished} of 120 points are finished and kept in {folder}; run the same again to go on from there"
    ]
    wait_for(lambda: not any(is_alive(pid) for _, pid in computed(log)))
    points = [{"x": x, "seconds": 0.02} for x in range(120)]
    assert run_many(study_tasks.noted, points, folder, workers=TWO).computed == 120 - finished
    assert set(Counter(key for key, _ in records(folder)).values()) == {1}


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)]
    for workers in (HERE, TWO):
        run_many(study_tasks.noted, POINTS, workers=workers)
        assert [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)] == before


# What is refused ------------------------------------------------------------------------------------------------


def inner() -> Any:
    def task(point: dict[str, Any]) -> dict[str, Any]:
        return point

    return task


@pytest.mark.parametrize(
    ("task", "said"),
    [
        (lambda point: point, "at the top of its module"),
        (inner(), "at the top of its module"),
        (str.upper, "must be a function of a module"),
        ("noted", "must be a function of a module"),
        (Study.values, "at the top of its module"),
    ],
    ids=["lambda", "inner", "method of str", "text", "method"],
)
def test_tasks_that_workers_cannot_import_are_refused(task: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        run_many(task, POINTS)


def test_a_task_of_a_script_is_refused() -> None:
    code = "def task(point): return point\nrun_many(task, [{}], folder)"
    with study_process(code, Path("/nowhere"), Path("/nowhere")) as process:
        _, err = process.communicate(timeout=DEADLINE)
    assert "task task: it belongs to the script that runs; put it in a module" in err


def test_the_name_of_a_task() -> None:
    assert task_name(study_tasks.noted) == "study_tasks.noted"


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([1], r"points\[0\] = 1; it must be a dict"),
        ([{}, {"x": {1, 2}}], r"points\[1\]\['x'\] is of type set; it must be a plain value"),
        ([{"x": [0, object]}], r"points\[0\]\['x'\]\[1\]"),
        ([{1: 2}], "key 1 must be a text"),
        ([{"x": 1j}], "plain value"),
    ],
)
def test_points_that_are_not_plain_are_refused(points: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        run_many(study_tasks.noted, points, workers=HERE)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"count": 0}, "count = 0"),
        ({"count": True}, "count = True"),
        ({"count": 1.5}, "count = 1.5"),
        ({"backend": "dask"}, "must be one of Backend.PROCESSES"),
        ({"backend": Backend.CLUSTER}, "needs the address"),
        ({"backend": Backend.CLUSTER, "address": "tcp://a:1", "client": 1}, "not both"),
        ({"address": "tcp://a:1"}, "address belongs to Backend.CLUSTER"),
        ({"backend": Backend.THIS_PROCESS, "count": 2}, "one point at a time"),
    ],
)
def test_workers_that_cannot_be_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(OptionError, match=said):
        Workers(**options)


def test_a_cluster_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    from tensegrity_mj.studies import workers

    monkeypatch.setattr(workers, "CONNECT_TIMEOUT", 0.2)
    with pytest.raises(OptionError, match=r"no Dask scheduler answers at .tcp://127\.0\.0\.1:9"):
        run_many(study_tasks.noted, POINTS, workers=Workers(backend=Backend.CLUSTER, address="tcp://127.0.0.1:9"))
    with pytest.raises(OptionError, match=r"client = 1; it must be a dask\.distributed\.Client"):
        run_many(study_tasks.noted, POINTS, workers=Workers(backend=Backend.CLUSTER, client=1))


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingLibraryError, match=r"a cluster needs distributed.*python -m pip install .dask"):
        run_many(study_tasks.noted, POINTS, workers=Workers(backend=Backend.CLUSTER, address="tcp://a:1"))


# Plain values ---------------------------------------------------------------------------------------------------


def test_one_text_for_one_value() -> None:
    value = {"b": (1, np.float64(2.5)), "a": {"d": np.array([1, 2]), "c": None}}
    assert canonical(value) == '{"a":{"c":null,"d":[1,2]},"b":[1,2.5]}'
    assert plain(value, "it") == {"b": [1, 2.5], "a": {"d": [1, 2], "c": None}}
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    # 1 and 1.0 may be different options; 0.1 is what it is to the last bit.
    assert len({digest(x) for x in (1, 1.0, 0.1, np.nextafter(0.1, 1), True, "1", math.nan, math.inf)}) == 8
    assert math.isnan(plain({"x": math.nan}, "it")["x"])


def test_differences_are_found_where_they_are() -> None:
    assert difference({"a": [1, {"b": 2}]}, {"a": [1, {"b": 2}]}) is None
    assert difference({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}]}) == "a[1].b is 3 there and 2 here"
    assert difference({"a": math.nan}, {"a": math.nan}) is None
    assert difference({}, {"a": 1}) == "a is given there only"
    assert len(difference({"a": "x" * 500}, {"a": 1}) or "") < 120
    long = "x = 1\n" * 50
    assert (
        difference({"a": f"{long}y = 2\n"}, {"a": f"{long}y = 3\n"}) == 'a, lines[50] is "y = 3" there and "y = 2" here'
    )
    assert difference({"a": "x\n"}, {"a": "x"}) == "a has other line ends"


def test_what_an_interrupt_meets_while_it_is_written_is_finished_if_its_record_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(file: int) -> None:
        raise KeyboardInterrupt

    for cut, finished in ((0, 1), (5, 0)):
        with store.opened(tmp_path / f"cut {cut}", {}) as kept:
            with monkeypatch.context() as patched:
                patched.setattr("os.fsync", interrupted)
                with pytest.raises(KeyboardInterrupt):
                    kept.add("point", {"values": {}}, {})
            path = tmp_path / f"cut {cut}" / store.POINTS
            os.truncate(path, path.stat().st_size - cut)
            assert kept.stopped("{} are finished").startswith(f"{finished} are finished and kept in ")
        with store.opened(tmp_path / f"cut {cut}", {}) as kept:
            assert len(kept.outcomes) == finished


def test_a_full_disk_is_reported_with_the_file_and_nothing_finished_is_lost(tmp_path: Path) -> None:
    points = [{"x": number} for number in range(60)]
    script = (
        "import resource, sys, study_tasks, tensegrity_mj as tmj\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))\n"  # study.json has less than that, points.jsonl more
        "points = [{'x': number} for number in range(60)]\n"
        "here = tmj.studies.Workers(backend=tmj.studies.Backend.THIS_PROCESS)\n"
        "tmj.studies.run_many(study_tasks.noted, points, sys.argv[1], workers=here)\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "study")]
    reported = subprocess.run(command, cwd=TESTS, capture_output=True, text=True, check=False)
    assert "FormatError" in reported.stderr.splitlines()[-1]
    assert re.search(r"points\.jsonl: cannot be written \(File too large\); make room there", reported.stderr)
    whole = (tmp_path / "study" / store.POINTS).read_bytes().count(b"\n")
    assert 10 < whole < 60
    study = run_many(study_tasks.noted, points, tmp_path / "study", workers=HERE)
    assert study.computed == 60 - whole
    assert study.failed == []


def test_a_link_in_place_of_the_lock_is_refused_and_its_target_stays(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear reader")
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / ".lock").symlink_to(tmp_path / "letter.txt")
    with pytest.raises(OptionError, match="no study can be kept there"):
        run_many(study_tasks.noted, POINTS, folder, workers=HERE)
    assert (tmp_path / "letter.txt").read_text() == "dear reader"
