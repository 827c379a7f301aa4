"""Webhooks of the regression farm: who is told of verdicts and decisions."""

from __future__ import annotations

from collections.abc import Sequence

from .._calls import query, segment
from .._io import Request
from .._page import Page
from ..models import Webhook, WebhookDelivery, WebhookEvent
from .base import Base

_PATH = "v1/farm/webhooks"


class Webhooks(Base):
    """Addresses that get signed messages, in the form of Standard Webhooks."""

    async def add_webhook(
        self, url: str, *, secret: str, events: Sequence[WebhookEvent] = (), suite: str | None = None
    ) -> Webhook:
        """Has an address told of events, all when none is named; `suite` is a name. The secret is never shown again."""
        body = {"url": url, "secret": secret, "events": list(events), "suite": suite}
        return await self._caller.json(Webhook, Request("POST", _PATH, json=body, is_repeatable=False))

    async def webhooks(self) -> list[Webhook]:
        """All webhooks, oldest first."""
        return (await self._caller.page(Webhook, Request("GET", _PATH))).items

    async def webhook(self, webhook: str) -> Webhook:
        """A webhook, and how its last attempt went."""
        return await self._caller.json(Webhook, Request("GET", f"{_PATH}/{segment(webhook)}"))

    async def delete_webhook(self, webhook: str) -> None:
        """Deletes a webhook with the messages that wait for it."""
        await self._caller.content(Request("DELETE", f"{_PATH}/{segment(webhook)}"))

    async def resend_delivery(self, webhook: str, delivery: str) -> WebhookDelivery:
        """Sends a message again, now; whatever became of it."""
        path = f"{_PATH}/{segment(webhook)}/deliveries/{segment(delivery)}/resend"
        return await self._caller.json(WebhookDelivery, Request("POST", path))

    async def deliveries(
        self, webhook: str, *, limit: int | None = None, cursor: str | None = None
    ) -> Page[WebhookDelivery]:
        """One page of a webhook's messages with the attempts to deliver them, newest first."""
        request = Request("GET", f"{_PATH}/{segment(webhook)}/deliveries", query(limit=limit, cursor=cursor))
        return await self._caller.page(WebhookDelivery, request)
