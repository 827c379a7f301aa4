"""
What can go wrong.

- `ProblemError`: the service answered, and said no. Its subclasses are the answers that programs tell apart.
- `UnreachableError`: there was no answer, also after the repetitions that are safe.
- `UnexpectedAnswerError`: an answer that is not in the API's form: most likely not a Lightshaft service.
- `JobFailedError`: a job that was waited for has failed or was cancelled.
- `WaitTimeoutError`: what was waited for did not end in the time that the caller gave.
- `MissingExtraError`: the call needs packages that an extra of this one installs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .models import FieldError

if TYPE_CHECKING:
    from .models import Job


class LightshaftError(Exception):
    """Every error of this package."""


class UnreachableError(LightshaftError):
    """No answer: the service cannot be reached, the connection was cut, or it took too long."""

    def __init__(self, url: str, reason: str) -> None:
        """Tell where, and what the connection said."""
        super().__init__(f"no answer from {url}: {reason}")
        #: What was asked.
        self.url = url
        self.reason = reason


class UnexpectedAnswerError(LightshaftError):
    """An answer that is not in the form of the API."""

    def __init__(self, url: str, status: int, detail: str) -> None:
        """Tell who answered, and what was wrong with it."""
        super().__init__(f"{url} answered {status} in an unexpected form: {detail}")
        self.url = url
        self.status = status
        self.detail = detail


class ProblemError(LightshaftError):
    """A problem document (RFC 9457): the service understood the request, and refused it."""

    def __init__(self, document: Mapping[str, Any], retry_after_s: float | None = None) -> None:
        """Take over what the document says."""
        #: `/problems/<code>`: stable, and the address of its explanation.
        self.type = str(document.get("type", "about:blank"))
        #: The last part of `type`, to branch on.
        self.code = str(document.get("code") or self.type.rsplit("/", 1)[-1])
        self.title = str(document.get("title", ""))
        self.status = int(document.get("status", 0))
        #: What was wrong this time, and what would be right.
        self.detail = str(document.get("detail", ""))
        #: Every field that was wrong.
        self.errors = tuple(
            FieldError(pointer=str(error.get("pointer", "")), detail=str(error.get("detail", "")))
            for error in document.get("errors") or ()
        )
        #: Finds what the service's log knows of it.
        self.request_id: str | None = document.get("request_id")
        #: How long the service asked to wait before the same is asked again.
        self.retry_after_s = retry_after_s
        lines = [f"{self.title} ({self.status}): {self.detail}"]
        lines += [f"  {error.pointer}: {error.detail}" for error in self.errors]
        super().__init__("\n".join(lines))


class InvalidRequestError(ProblemError):
    """400 or 422: something in the request is wrong; `errors` names every field."""


class NotFoundError(ProblemError):
    """404: the id or name is not known (any more)."""


class ConflictError(ProblemError):
    """409: the state of a thing does not allow this."""


class JobFailedError(LightshaftError):
    """A job ended otherwise than by success."""

    def __init__(self, job: Job) -> None:
        """Say why, as far as the job knows."""
        why = f": {job.error}" if job.error else ""
        super().__init__(f"job {job.id} {'was' if job.state == 'cancelled' else 'has'} {job.state}{why}")
        self.job = job


class WaitTimeoutError(LightshaftError, TimeoutError):
    """Time was up; what was waited for goes on."""


class MissingExtraError(LightshaftError, ImportError):
    """The call needs packages that are not installed."""

    def __init__(self, extra: str, package: str) -> None:
        """Name the extra that brings the package."""
        super().__init__(f"this needs {package}: pip install 'lightshaft[{extra}]'", name=package)
        self.extra = extra


def problem(document: Mapping[str, Any], retry_after_s: float | None) -> ProblemError:
    """The exception for a problem document."""
    kinds = {
        400: InvalidRequestError,
        404: NotFoundError,
        409: ConflictError,
        422: InvalidRequestError,
    }
    return kinds.get(int(document.get("status", 0)), ProblemError)(document, retry_after_s)
