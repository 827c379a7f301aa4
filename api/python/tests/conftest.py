"""Fixtures: one service for all tests, and the two clients behind one face."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from anyio.from_thread import BlockingPortal, start_blocking_portal

from lightshaft import AsyncClient, Client, Scene

from .service import BINARY, Cut, Proxy, Service, generate


def pytest_sessionstart() -> None:
    if not BINARY.is_file():
        pytest.exit(f"{BINARY} is not there: cargo build --bin lightshaft, or set LIGHTSHAFT_BINARY", returncode=3)


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    service = Service(tmp_path_factory.mktemp("service"), "--device", "cpu", "--no-thumbnails")
    yield service
    service.kill()


@pytest.fixture
def own_service(tmp_path: Path) -> Iterator[Callable[..., Service]]:
    """Starts services that a test may do anything to."""
    services: list[Service] = []

    def start(*options: str) -> Service:
        folder = tmp_path / f"service-{len(services)}"
        folder.mkdir()
        services.append(Service(folder, "--device", "cpu", "--no-thumbnails", *options))
        return services[-1]

    yield start
    for service in services:
        service.kill()


@pytest.fixture
def proxy() -> Iterator[Callable[[str, Cut], Proxy]]:
    proxies: list[Proxy] = []

    def start(target: str, cut: Cut) -> Proxy:
        proxies.append(Proxy(target, cut))
        return proxies[-1]

    yield start
    for one in proxies:
        one.close()


class _Blocking:
    """`AsyncClient` as if it blocked: every call runs in an event loop in another thread."""

    def __init__(self, portal: BlockingPortal, client: AsyncClient) -> None:
        self._portal = portal
        self._client = client

    def __getattr__(self, name: str) -> Any:
        call = getattr(self._client, name)
        if not callable(call):
            return call
        if inspect.iscoroutinefunction(call):
            return lambda *args, **options: self._portal.call(lambda: call(*args, **options))
        return lambda *args, **options: self._iterate(call(*args, **options))

    def _iterate(self, items: AsyncIterator[Any]) -> Iterator[Any]:
        while True:
            try:
                yield self._portal.call(lambda: anext(items))
            except StopAsyncIteration:
                return


#: Makes a client of a service.
Connect = Callable[..., Client]


@pytest.fixture(params=["sync", "async"])
def flavour(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def connect(flavour: str) -> Iterator[Connect]:
    """Clients of each kind: what a test says of one holds for all."""
    with contextlib.ExitStack() as stack:
        portal = stack.enter_context(start_blocking_portal()) if flavour == "async" else None

        def make(url: str, **options: Any) -> Client:
            if portal is None:
                return stack.enter_context(Client(url, **options))
            client = portal.call(lambda: _made(url, options))
            stack.callback(lambda: portal.call(client.close))
            return cast(Client, _Blocking(portal, client))

        yield make


async def _made(url: str, options: dict[str, Any]) -> AsyncClient:
    return AsyncClient(url, **options)


@pytest.fixture
def client(connect: Connect, service: Service) -> Client:
    return connect(service.url)


@pytest.fixture(scope="session")
def glb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(tmp_path_factory.mktemp("scenes"), "cornell-box")


@pytest.fixture(scope="session")
def scene(service: Service, glb: Path) -> Scene:
    with Client(service.url) as client:
        return client.upload_scene(glb)
