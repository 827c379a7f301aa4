"""What the calls share."""

from __future__ import annotations

from .._calls import Caller, segment
from .._io import Io
from ..models import Job


class Base:
    """A service that is called through one `Io`."""

    def __init__(self, io: Io, url: str, retries: int) -> None:
        self._io = io
        self._url = url
        self._retries = retries
        self._caller = Caller(io, url, retries)

    @property
    def url(self) -> str:
        """The service's address."""
        return self._url


def job_id(job: str | Job) -> str:
    """Of a job, or what is an id already."""
    return job if isinstance(job, str) else job.id


def job_path(job: str | Job) -> str:
    """Where a job is."""
    return f"v1/jobs/{segment(job_id(job))}"
