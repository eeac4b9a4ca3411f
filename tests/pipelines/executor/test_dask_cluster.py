from __future__ import annotations

import queue
import socket
import sys
from collections import deque
from concurrent.futures import CancelledError
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import pytest

from quadlog.errors import ClusterUnusable, ClusterWorkersDied, VersionsDiffer
from quadlog.pipelines.executor import dask_cluster
from quadlog.pipelines.executor import dask_cluster as dask_task
from quadlog.pipelines.executor.dask_cluster import open_cluster
from quadlog.pipelines.executor.executor import open_engine


def nothing(_):
    """Nobody listens."""


def test_a_task_whose_worker_is_killed_is_done_by_another(tasks, cluster, tmp_path):
    with open_cluster(cluster.scheduler_address, nothing) as opened:
        assert isinstance(opened.submit(tasks.die_once, tmp_path).result(), int)
    assert (tmp_path / "died").exists()


def test_a_task_that_kills_every_worker_is_named_and_the_others_are_done(tasks, cluster):
    with open_engine(1, cluster.scheduler_address, nothing) as engine:
        ended = dict(engine.done(tasks.die_if, deque([0, 1, 0.0, ""]), [].append))
    error = ended.pop(1).exception()
    assert isinstance(error, ClusterWorkersDied)
    assert "tcp://127.0.0.1" in error.how
    assert [future.result() for future in ended.values()] == ["alive"] * len(ended)


def test_what_a_task_says_and_its_error_come_back(tasks, cluster):
    heard = queue.Queue()
    with open_cluster(cluster.scheduler_address, heard.put) as opened:
        assert opened.submit(tasks.talk, ["one", "two"]).result() == 2
        assert [heard.get(), heard.get()] == ["one", "two"]
        error = opened.submit(tasks.fail, "named").exception()
        assert (type(error).__name__, error.choices) == ("UnknownName", ["astar"])


def test_a_process_of_two_threads_replays_one_at_a_time(tasks, cluster, gate):
    heard = queue.Queue()
    with open_cluster(cluster.scheduler_address, heard.put) as opened:
        (worker,) = [name for name, _ in zip(opened._client.nthreads(), range(1), strict=False)]
        opened._executor._kwargs["workers"] = [worker]
        path = gate("gate")
        first = opened.submit(tasks.held, path, "first")
        assert heard.get()["begun"] == "first"
        second = opened.submit(tasks.talk, ["second"])
        while opened._client.run(tasks.count_executing, workers=[worker])[worker] < 2:
            assert not second.done()
        assert heard.empty()
        assert opened._client.run(tasks.is_replaying, workers=[worker])[worker]
        path.write_bytes(b"")
        assert (first.result()[0], second.result()) == ("first", 1)
        assert heard.get() == "second"


def test_what_runs_ends_when_it_is_stopped_and_the_rest_is_cancelled(tasks, cluster, gate):
    pipe = gate("pipe")
    with open_cluster(cluster.scheduler_address, nothing) as opened:
        running = opened.submit(tasks.talk_on, pipe)
        with pipe.open("rb") as until_its_end:
            opened.stop()
            assert until_its_end.read() == b""
        with pytest.raises(CancelledError):
            running.result()


def test_other_versions_are_refused_with_both_named(cluster, monkeypatch):
    mine = dask_task.own_versions()
    monkeypatch.setattr(dask_cluster, "own_versions", lambda: mine | {"quadlog": "9.9", "Python": "3.99"})
    with pytest.raises(VersionsDiffer) as caught, open_cluster(cluster.scheduler_address, nothing):
        pass
    assert f"Python {mine['Python']} instead of 3.99, quadlog {mine['quadlog']} instead of 9.9" in str(caught.value)
    assert "tcp://127.0.0.1" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_package_that_a_worker_lacks_is_another_version(cluster, monkeypatch):
    mine = dask_task.own_versions()
    monkeypatch.setattr(dask_cluster, "own_versions", lambda: mine | {"quadlog-no-such-package": "1.0"})
    with (
        pytest.raises(VersionsDiffer, match="quadlog-no-such-package none instead of 1"),
        open_cluster(cluster.scheduler_address, nothing),
    ):
        pass


def test_a_worker_that_comes_later_with_other_versions_refuses_by_itself(cluster):
    with open_cluster(cluster.scheduler_address, nothing) as opened:
        opened._versions |= {"numba": "0.1"}
        error = opened.submit(abs, 1).exception()
    assert isinstance(error, VersionsDiffer)
    assert error.differing[0][0] == "numba"
    assert error.differing[0][2] == "0.1"


@pytest.mark.parametrize(
    ("address", "says"),
    [("garbage", "is no address of a Dask scheduler"), ("foo://host:1", "is no address"), ("", "is no address")],
)
def test_what_is_no_address_is_said_in_one_line(address, says):
    with pytest.raises(ClusterUnusable, match=says) as caught, open_cluster(address, nothing):
        pass
    assert "\n" not in str(caught.value)


def test_who_does_not_answer_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(dask_cluster, "ANSWER_S", 0.2)
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        address = f"tcp://127.0.0.1:{deaf.getsockname()[1]}"
        with pytest.raises(ClusterUnusable, match="no Dask scheduler has answered"), open_cluster(address, nothing):
            pass


def test_a_worker_is_not_taken_for_the_scheduler(cluster):
    worker = next(iter(cluster.scheduler_info["workers"]))
    with pytest.raises(ClusterUnusable, match="is a Dask worker, not the scheduler"), open_cluster(worker, nothing):
        pass


def test_without_dask_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterUnusable, match=r"pip install distributed"), open_cluster("tcp://h:1", nothing):
        pass


def test_a_scheduler_without_a_dashboard_has_no_address_to_tell(empty_cluster):
    with empty_cluster() as cluster, open_cluster(cluster.scheduler_address, nothing) as opened:
        assert opened.greeting == "0 workers"


@pytest.mark.parametrize("plots", [b'{"Individual Progress": "/individual-progress"}', b"no JSON", None])
def test_the_address_of_a_dashboard_is_told_also_when_it_is_out_of_reach(empty_cluster, monkeypatch, pages, plots):
    """Bokeh is not among what tests need, so its pages are ours."""
    with empty_cluster() as cluster, open_cluster(cluster.scheduler_address, nothing) as opened:
        page = pages(plots)
        monkeypatch.setattr(type(opened._client), "dashboard_link", page)
        assert opened.greeting == f"0 workers; dashboard: {page}"


@pytest.fixture
def pages():
    """Starts a server that answers with the plots of a dashboard, or, for None, does not; returns its page."""
    with ExitStack() as stack:

        def start(plots):
            class Answer(BaseHTTPRequestHandler):
                def do_GET(self):
                    self.send_response(200 if self.path == "/individual-plots.json" else 404)
                    self.send_header("Content-Type", "application/json")
                    self.end_headers()
                    self.wfile.write(plots)

                def log_message(self, *_):
                    """Nobody reads it."""

            server = HTTPServer(("127.0.0.1", 0), Answer)
            if plots is None:
                server.server_close()
            else:
                thread = Thread(target=server.serve_forever)
                thread.start()
                stack.callback(thread.join)
                stack.callback(server.server_close)
                stack.callback(server.shutdown)
            return f"http://127.0.0.1:{server.server_port}/status"

        yield start
