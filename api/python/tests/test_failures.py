"""A service that is away, connections that break, answers that are lost."""

from __future__ import annotations

import http.server
import re
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from lightshaft import Client, Scene, UnexpectedAnswerError, UnreachableError
from lightshaft.models import Event

from .conftest import Connect
from .service import Cut, Proxy, Service

SMALL = {"width": 32, "height": 24, "spp": 2, "device": "cpu"}

Start = Callable[[str, Cut], Proxy]


def _cuts(**lengths: list[int]) -> Cut:
    """Cuts the first answers to requests whose first line has such a word."""
    left = {word: iter(of_word) for word, of_word in lengths.items()}

    def cut(head: str) -> int | None:
        first_line = re.split(r"\W+", head.partition("\r\n")[0])
        return next((next(left[word], None) for word in first_line if word in left), None)

    return cut


def test_a_service_that_is_not_there(connect: Connect) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UnreachableError, match=url) as error:
            connect(url, retries=1).status()
        assert error.value.url.startswith(url)


@pytest.mark.parametrize("url", ["localhost:8080", "ftp://farm", "http://", "not an address"])
def test_an_address_that_is_none_is_refused_at_once(connect: Connect, url: str) -> None:
    with pytest.raises(ValueError, match="no address of a service"):
        connect(url)


def test_another_kind_of_server_is_told(connect: Connect, tmp_path: Path) -> None:
    (tmp_path / "v1").mkdir()
    (tmp_path / "v1" / "status").write_text('{"state": "active"}')

    class Files(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args: object) -> None:
            super().__init__(*args, directory=str(tmp_path))  # type: ignore[arg-type]

        def log_message(self, *args: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Files) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        client = connect(f"http://127.0.0.1:{server.server_port}")
        with pytest.raises(UnexpectedAnswerError, match="no field `blob_bytes`"):
            client.status()
        with pytest.raises(UnexpectedAnswerError) as error:
            client.workers()
        assert error.value.status == 404
        server.shutdown()


def test_what_does_nothing_twice_is_repeated(connect: Connect, service: Service, scene: Scene, proxy: Start) -> None:
    lossy = proxy(service.url, _cuts(status=[0, 20], POST=[0, 20, 0]))
    client = connect(lossy.url)
    assert client.status().version
    job = client.submit(scene, SMALL, labels={"lost": "twice"})
    keys = [re.search(r"(?i)idempotency-key: (\S+)", head) for head in lossy.requests if head.startswith("POST")]
    assert len(keys) == 4
    assert len({key[1] for key in keys if key}) == 1
    client.wait(job, timeout_s=60)
    mine = [one.id for one in client.iterate_jobs(labels={"lost": "twice"}) if one.created_at >= job.created_at]
    assert mine == [job.id], "the answers were lost, not the job"


def test_what_may_do_something_twice_is_not_repeated(
    connect: Connect, service: Service, scene: Scene, proxy: Start
) -> None:
    lossy = proxy(service.url, _cuts(retry=[20]))
    client = connect(lossy.url)
    job = client.submit(scene, {**SMALL, "width": 512, "height": 512, "spp": 1 << 20})
    client.cancel(job)
    client.wait(job, timeout_s=60, check=False)
    with pytest.raises(UnreachableError):
        client.retry(job)
    assert sum("/retry" in head for head in lossy.requests) == 1
    client.cancel(job)
    client.wait(job, timeout_s=60, check=False)


def test_a_deletion_whose_answer_is_lost_is_done(
    connect: Connect, service: Service, scene: Scene, proxy: Start
) -> None:
    client = connect(proxy(service.url, _cuts(DELETE=[20])).url)
    job = client.wait(client.submit(scene, SMALL), timeout_s=60)
    client.delete_job(job)


def test_waiting_takes_events_up_where_they_broke_off(
    connect: Connect, service: Service, scene: Scene, proxy: Start
) -> None:
    lossy = proxy(service.url, _cuts(events=[900, 1200]))
    client = connect(lossy.url)
    events: list[Event] = []
    job = client.submit(scene, {**SMALL, "spp": 400, "split": {"tiles": [2, 2]}})
    assert client.wait(job, timeout_s=60, on_event=events.append).state == "succeeded"
    heard = [event.id for event in events if event.id is not None]
    assert heard == sorted(set(heard)), "none comes twice"
    resumed = [head for head in lossy.requests if "/events" in head and "last-event-id" in head.lower()]
    assert resumed
    events_again = [event.id for event in client.events(job) if event.id is not None]
    assert set(heard) <= set(events_again)


def test_waiting_asks_where_no_events_get_through(
    connect: Connect, service: Service, scene: Scene, proxy: Start
) -> None:
    deaf = proxy(service.url, lambda head: 0 if "/events" in head else None)
    client = connect(deaf.url, retries=0)
    job = client.submit(scene, {**SMALL, "spp": 1000})
    progress: list[float] = []
    done = client.wait(job, timeout_s=60, on_progress=lambda progressed: progress.append(progressed.fraction))
    assert done.state == "succeeded"
    assert progress == sorted(progress)
    assert progress[-1] == 1.0
    assert sum("/events" in head for head in deaf.requests) <= 2


def test_waiting_outlasts_a_restart_of_the_service(
    connect: Connect, own_service: Callable[..., Service], glb: Path
) -> None:
    service = own_service("--workers", "1", "--lease-ttl-s", "2")
    client = connect(service.url)
    job = client.submit(client.upload_scene(glb), {**SMALL, "spp": 400})
    service.kill()
    restart = threading.Timer(1.0, service.start)
    restart.start()
    done = client.wait(job, timeout_s=60)
    restart.join()
    assert done.state == "succeeded"
    service.kill()
    with pytest.raises(UnreachableError):
        client.wait(job, patience_s=0.5)


def test_a_silent_service_is_given_up_in_time(connect: Connect) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        client = connect(f"http://127.0.0.1:{silent.getsockname()[1]}", timeout_s=0.3, retries=1)
        began = time.monotonic()
        with pytest.raises(UnreachableError, match=r"(?i)time"):
            client.status()
        assert time.monotonic() - began < 5


def test_a_client_can_be_used_by_many_threads(service: Service) -> None:
    with Client(service.url) as client:
        versions: list[str] = []
        threads = [threading.Thread(target=lambda: versions.append(client.status().version)) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(versions) == 8
