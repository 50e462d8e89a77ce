"""sweep beyond one process pool: clusters, folded results, and a file to go on from."""

from __future__ import annotations

import errno
import functools
import os
import pickle
import subprocess
import sys
import textwrap
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from operator import add
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from clusterable import GRID, POLAR, deadly, drawn, gusty, inverse, polar
from statebook import checkpoint
from test_sweep import Inline

QUIET = {"progress": False}


def counted(x, folder):
    with (folder / f"{x}").open("a") as file:
        file.write("called\n")
    if (folder / "stop").exists() and x >= 5:
        raise KeyboardInterrupt
    return x**2


def in_words(total, x):
    return (10 * total + x) % 1_000_003


def in_place(total, x):
    total += x
    return total


def calls(folder):
    return {int(p.name): len(p.read_text().split()) for p in folder.iterdir() if p.name.isdigit()}


@pytest.fixture(scope="module")
def dask():
    distributed = pytest.importorskip("distributed")
    options = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1", "silence_logs": 50}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **options) as cluster:
        with distributed.Client(cluster) as client:
            yield client.get_executor()


def test_on_a_dask_cluster(dask, tmp_path):
    np.testing.assert_array_equal(sb.sweep(polar, GRID, executor=dask, **QUIET), POLAR)
    with pytest.raises(RuntimeError, match=r"failed at \{'x': 0\}: ZeroDivisionError"):
        sb.sweep(inverse, {"x": [2, 1, 0]}, executor=dask, **QUIET)
    grid, fold = {"block": range(6)}, (add, np.zeros(2))
    here = sb.sweep(drawn, grid, executor=Inline(), seed=3, reduce=fold, **QUIET)
    there = sb.sweep(drawn, grid, executor=dask, seed=3, reduce=fold, cache=tmp_path / "c", **QUIET)
    np.testing.assert_array_equal(there, here)
    assert np.sqrt(here[1] / 300) == pytest.approx(np.sqrt(0.5 * 0.5**3 / 3), rel=0.2)
    here = gusty(number=40, chunk=9, executor=Inline())
    np.testing.assert_array_equal(gusty(number=40, chunk=9, executor=dask).states, here.states)


def test_on_mpi(tmp_path):
    pytest.importorskip("mpi4py")
    pytest.importorskip("mpi4py.MPI", exc_type=Exception, reason="there is no MPI library")
    launcher = Path(sys.executable).with_name("mpiexec")
    launcher = str(launcher) if launcher.exists() else "mpiexec"
    script = """
        import numpy as np, statebook as sb
        from mpi4py.futures import MPIPoolExecutor
        from clusterable import GRID, POLAR, gusty, inverse, polar
        if __name__ == "__main__":
            with MPIPoolExecutor() as pool:
                np.testing.assert_array_equal(sb.sweep(polar, GRID, executor=pool), POLAR)
                there = gusty(number=40, chunk=9, executor=pool, reduce="moments")
                here = gusty(number=40, chunk=9, reduce="moments")
                np.testing.assert_array_equal(there.covariance, here.covariance)
                try:
                    sb.sweep(inverse, {"x": [2, 1, 0]}, executor=pool)
                except RuntimeError as error:
                    print(error)
    """
    command = [launcher, "-n", "3", sys.executable, "-m", "mpi4py.futures", "script.py"]
    here = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    (tmp_path / "script.py").write_text(textwrap.dedent(script), encoding="utf-8")
    result = subprocess.run(command, capture_output=True, text=True, env=here, cwd=tmp_path)
    assert "failed at {'x': 0}: ZeroDivisionError" in result.stdout, result.stderr


class Given(Inline):
    """Runs at once; of one task an executor's own error comes back."""

    def __init__(self, error):
        super().__init__()
        self.error = error

    def submit(self, function, *arguments):
        if arguments[2:3] != (4,):
            return super().submit(function, *arguments)
        future = Future()
        future.set_exception(self.error)
        return future


@pytest.mark.parametrize("error", [LookupError("lost"), ValueError("lost"), RuntimeError("lost")])
def test_what_an_executor_gives_up_is_named(error):
    with pytest.raises(RuntimeError, match=r"died at \{'x': 4\}, \{'x': 5\}: killed") as caught:
        sb.sweep(abs_of, {"x": range(9)}, executor=Given(error), chunk=2, **QUIET)
    assert caught.value.__cause__ is error


class Elsewhere(Inline):
    """Workers that have statebook alone."""

    def submit(self, function, *arguments):
        if arguments == (f"{inverse.__module__}:__name__",):
            arguments = ("clusterable_of_nowhere:__name__",)
        future = super().submit(function, *arguments)
        if future.exception() is None:
            pickle.dumps(future.result())
        return future


@pytest.mark.parametrize("function", [inverse, functools.partial(inverse)])
def test_workers_that_cannot_import_the_function_are_named_at_once(function):
    pool = Elsewhere()
    message = (
        r"workers cannot import clusterable \(No module named .*: start them with the folder of"
    )
    with pytest.raises(ImportError, match=message):
        sb.sweep(function, {"x": [1, 2]}, executor=pool, **QUIET)
    assert pool.chunks == []
    np.testing.assert_array_equal(sb.sweep(abs_of, {"x": [1, 2]}, executor=pool, **QUIET), [1, 2])


def abs_of(x):
    return abs(x)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 60), st.integers(1, 9))
def test_a_reduction_is_functools_reduce_in_the_order_of_the_grid(points, chunk):
    options = {"reduce": (in_words, 0), "executor": Inline(), "chunk": chunk, **QUIET}
    total = sb.sweep(abs_of, {"x": np.arange(points) % 10}, **options)
    assert total == int("".join(str(x % 10) for x in range(points))) % 1_000_003


def test_a_reduction_keeps_the_grids_order_and_the_initial_value():
    initial = np.zeros(())
    with ThreadPoolExecutor(4) as pool:
        for _ in range(2):
            total = sb.sweep(
                abs_of,
                {"x": range(500)},
                executor=pool,
                chunk=3,
                reduce=(in_place, initial),
                **QUIET,
            )
            assert total == sum(range(500)) and initial == 0


def test_few_tasks_are_on_their_way_at_a_time():
    pool = ThreadPoolExecutor(1)
    with pool:
        submitted, submit, done = [0], pool.submit, [0]

        def counting(*arguments):
            submitted[0] += 1
            assert submitted[0] - done[0] <= 40
            return submit(*arguments)

        def fold(total, x):
            done[0] += 1
            return total + x

        pool.submit = counting
        total = sb.sweep(
            abs_of, {"x": range(300)}, executor=pool, chunk=1, reduce=(fold, 0), **QUIET
        )
    assert total == sum(range(300)) and done[0] == 300


@pytest.fixture
def folder(tmp_path):
    """Where calls are noted, and the order to kill lies."""
    (tmp_path / "calls").mkdir()
    (tmp_path / "calls" / "kill").touch()
    return tmp_path / "calls"


def goes_on(grid, options):
    """Sweep again: what the cache holds is not called again, and nothing is missing."""
    before = calls(grid["folder"][0])
    with np.load(options["cache"]) as stored:
        kept = [i for first in stored["starts"] for i in range(first, first + stored["size"])]
    result = sb.sweep(deadly, grid, **options)
    np.testing.assert_array_equal(result[:, 0], np.arange(40) ** 2)
    after = calls(grid["folder"][0])
    assert kept and all(after[x] == before[x] for x in kept) and len(after) == 40
    assert after[30] == before[30] + 1


def test_a_killed_worker_of_a_pool_costs_what_was_on_its_way(folder, tmp_path):
    grid = {"x": range(40), "folder": [folder]}
    options = {"cache": tmp_path / "c", "chunk": 2, **QUIET}
    with ProcessPoolExecutor(1) as pool:
        with pytest.raises(RuntimeError, match=r"died at .*'x': 30"):
            sb.sweep(deadly, grid, executor=pool, **options)
    goes_on(grid, options)


def test_a_killed_worker_of_dask(folder, tmp_path):
    """Nobody restarts the workers; where nothing may be tried twice, a point is named."""
    distributed = pytest.importorskip("distributed")
    here = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1", "protocol": "tcp://"}
    command = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-nanny", "--nthreads=1"]
    command += ["--no-dashboard", "--local-directory", str(tmp_path)]
    started = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    started["env"] = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    grid, options = {"x": range(40), "folder": [folder]}, {"chunk": 1, **QUIET}
    with distributed.LocalCluster(n_workers=0, silence_logs=50, **here) as cluster:
        command.append(cluster.scheduler_address)
        workers = [subprocess.Popen(command, **started) for _ in range(2)]
        try:
            with distributed.Client(cluster) as client:
                client.wait_for_workers(2, timeout=60)
                options["executor"] = client.get_executor()
                cluster.scheduler.allowed_failures = 0
                with pytest.raises(RuntimeError, match=r"worker process died at \{'x': \d+, 'fold"):
                    sb.sweep(deadly, grid, cache=tmp_path / "c", **options)
                goes_on(grid, {"cache": tmp_path / "c", **options})
        finally:
            for worker in workers:
                worker.kill()
                worker.wait()


@pytest.mark.parametrize("reduce", [None, (add, 0), (in_place, np.zeros(1))])
def test_an_interrupted_sweep_goes_on(tmp_path, reduce):
    folder = tmp_path / "calls"
    folder.mkdir()
    grid, cache = {"x": range(12), "folder": [folder]}, tmp_path / "sweep.npz"
    options = {"cache": cache, "reduce": reduce, **QUIET}
    (folder / "stop").touch()
    with ThreadPoolExecutor(1) as pool, pytest.raises(KeyboardInterrupt):
        sb.sweep(counted, grid, chunk=2, executor=pool, **options)
    options["executor"] = Inline()
    (folder / "stop").unlink()
    result = sb.sweep(counted, grid, **options)
    expected = np.arange(12.0)[:, None] ** 2
    np.testing.assert_array_equal(result, expected if reduce is None else expected.sum())
    before = calls(folder)
    assert [before[x] for x in range(6)] == [1, 1, 1, 1, 2, 2]
    again = sb.sweep(counted, grid, **options)
    np.testing.assert_array_equal(again, result)
    assert type(again) is type(result) and calls(folder) == before
    assert [p.name for p in tmp_path.iterdir() if p != folder] == ["sweep.npz"]


def test_what_came_out_of_order_is_kept(tmp_path):
    folder = tmp_path / "calls"
    folder.mkdir()
    (folder / "stop").touch()
    grid, cache = {"x": range(11, -1, -1), "folder": [folder]}, tmp_path / "sweep.npz"
    with ThreadPoolExecutor(1) as pool, pytest.raises(KeyboardInterrupt):
        sb.sweep(counted, grid, chunk=1, cache=cache, executor=pool, **QUIET)
    (folder / "stop").unlink()
    result = sb.sweep(counted, grid, cache=cache, executor=Inline(), **QUIET)
    np.testing.assert_array_equal(result[:, 0], np.arange(12)[::-1] ** 2)


def test_random_numbers_are_those_of_a_run_without_interruption(tmp_path):
    def stopping(total, x):
        if x[0] == whole[3, 0] and not resumed:
            raise KeyboardInterrupt
        return total + x

    resumed, grid = [], {"block": range(8)}
    options = {"executor": Inline(), "seed": 5, "chunk": 1, **QUIET}
    whole = sb.sweep(drawn, grid, **options)
    kept = {"reduce": (stopping, np.zeros(2)), "cache": tmp_path / "c"}
    with pytest.raises(KeyboardInterrupt):
        sb.sweep(drawn, grid, **options, **kept)
    resumed.append(True)
    total = sb.sweep(drawn, grid, **options, **kept)
    np.testing.assert_array_equal(total, functools.reduce(add, whole, np.zeros(2)))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"grid": {"x": range(1, 5)}}, "grid"),
        ({"grid": {"y": range(4)}}, "grid"),
        ({"function": inverse, "grid": {"x": range(1, 4)}}, "function, grid"),
        ({"function": functools.partial(abs_of)}, "function"),
        ({"reduce": (add, 0)}, "reduction"),
    ],
)
def test_a_cache_of_another_sweep_is_refused_and_stays(tmp_path, change, named):
    cache = tmp_path / "sweep.npz"
    call = {"function": abs_of, "grid": {"x": range(4)}, "executor": Inline(), "cache": cache}
    sb.sweep(**call, **QUIET)
    before = cache.read_bytes()
    with pytest.raises(ValueError, match=rf"sweep\.npz is of another {named}: delete it"):
        sb.sweep(**{**call, **change}, **QUIET)
    assert cache.read_bytes() == before


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"\x80\x04K\x01.", b"cos\nsystem\n(S'x'\ntR."]
)
def test_a_file_that_is_no_cache_is_refused_and_nothing_unpickled(tmp_path, content):
    cache = tmp_path / "notes"
    cache.write_bytes(content)
    with pytest.raises(ValueError, match="cache must be a file of sweep's"):
        sb.sweep(abs_of, {"x": [1]}, executor=Inline(), cache=cache, **QUIET)
    assert cache.read_bytes() == content


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"reduce": add}, TypeError, r"reduce must be \(function, initial\)"),
        ({"reduce": (0, add)}, TypeError, r"reduce must be \(function, initial\)"),
        ({"reduce": (add, []), "cache": "c"}, TypeError, "must keep a number or an array"),
        ({"reduce": (add, None), "cache": "c"}, TypeError, "must keep a number or an array"),
        ({"cache": "missing/c"}, FileNotFoundError, "missing"),
        ({"function": lambda x: x, "cache": "c"}, TypeError, "function cannot be sent .* def"),
    ],
)
def test_what_cannot_work_is_refused(tmp_path, monkeypatch, options, error, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        sb.sweep(**{"function": abs_of, "grid": {"x": [1]}, "executor": Inline(), **options})


@pytest.mark.parametrize(("cost", "apart"), [(0.0, 1.0), (0.02, 1.0), (0.5, 10.0)])
def test_a_cache_is_written_every_second_or_a_twentieth_of_the_time(
    tmp_path, monkeypatch, cost, apart
):
    now, written, whole = [0.0], [], os.replace

    def replacing(*names):
        whole(*names)
        now[0] += cost
        written.append(now[0])

    monkeypatch.setattr(checkpoint.os, "replace", replacing)
    monkeypatch.setattr(checkpoint, "time", SimpleNamespace(monotonic=lambda: now[0]))
    done = checkpoint.Checkpoint(1)
    done.keep_in(tmp_path / "c", {})
    while now[0] < 60:
        now[0] += 1 / 8
        done.add(len(done.ready), np.array([now[0]]))
    assert len(written) > 5
    assert np.diff(written) == pytest.approx([apart + cost] * (len(written) - 1), abs=1 / 8)


def test_a_full_disk_costs_the_cache_not_the_results(tmp_path, monkeypatch):
    cache, whole = tmp_path / "c", os.replace
    sb.sweep(abs_of, {"x": [1]}, executor=Inline(), cache=cache, **QUIET)

    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    before = cache.read_bytes()
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space"):  # at the start nothing is lost
        sb.sweep(abs_of, {"x": [1]}, executor=Inline(), cache=cache, **QUIET)
    written = []
    monkeypatch.setattr(os, "replace", lambda *a: full() if written else written.append(whole(*a)))
    with pytest.warns(UserWarning, match=r"cache cannot be written: .*No space"):
        result = sb.sweep(abs_of, {"x": [1]}, executor=Inline(), cache=cache, **QUIET)
    assert result == [1]
    assert cache.read_bytes() == before and os.listdir(tmp_path) == ["c"]


def test_a_clock_that_jumps_changes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("time.time", lambda: -1e9)
    options = {"executor": Inline(), "chunk": 1, "cache": tmp_path / "c", **QUIET}
    np.testing.assert_array_equal(sb.sweep(abs_of, {"x": range(9)}, **options), range(9))
