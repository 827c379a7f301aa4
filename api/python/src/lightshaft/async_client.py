"""The client for asyncio."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Self

from ._api.artifacts import Artifacts
from ._api.farm import Farm
from ._api.jobs import Jobs
from ._api.scenes import Scenes
from ._api.service import Service
from ._api.webhooks import Webhooks
from ._io import AsyncIo, Connection


class Calls(Scenes, Jobs, Artifacts, Farm, Webhooks, Service):
    """Every call, over any `Io`."""

    async def close(self) -> None:
        """Close all connections."""
        await self._io.close()


class AsyncClient(Calls):
    """A Lightshaft service at one address. Connections are kept; `async with` closes them."""

    def __init__(
        self,
        url: str | None = None,
        *,
        timeout_s: float = 60.0,
        retries: int = 4,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        """Connect to `url`, such as `http://127.0.0.1:8080`; from LIGHTSHAFT_SERVER where it is left out.

        `timeout_s` is the longest pause within an answer, and until it begins. `retries` says how often a call
        that failed for a passing reason is repeated; only those that do nothing twice are.
        """
        connection = Connection.to(url, timeout_s, headers)
        super().__init__(AsyncIo(connection), connection.url, retries)

    async def __aenter__(self) -> Self:
        """Give the client itself."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close all connections."""
        await self.close()
