"""
Client of Lightshaft, the render service.

    from lightshaft import Client

    with Client("http://127.0.0.1:8080") as lightshaft:
        scene = lightshaft.upload_scene("demo.glb")
        job = lightshaft.submit(scene, {"width": 640, "height": 360, "spp": 64})
        lightshaft.wait(job, on_progress=lambda progress: print(f"{progress.fraction:.0%}"))
        lightshaft.download(job, "image.png", "demo.png")

`AsyncClient` has the same calls for asyncio.
"""

from . import models
from ._api.jobs import Settings
from ._page import Page
from ._wait import Progress
from .async_client import AsyncClient
from .client import Client
from .errors import (
    ConflictError,
    InvalidRequestError,
    JobFailedError,
    LightshaftError,
    MissingExtraError,
    NotFoundError,
    ProblemError,
    UnexpectedAnswerError,
    UnreachableError,
    WaitTimeoutError,
)
from .models import (
    Acceleration,
    BenchmarkSettings,
    BuildSettings,
    CompareRequest,
    Job,
    LineSpace,
    PictureChoice,
    RenderSettings,
    Scene,
)

__all__ = [
    "Acceleration",
    "AsyncClient",
    "BenchmarkSettings",
    "BuildSettings",
    "Client",
    "CompareRequest",
    "ConflictError",
    "InvalidRequestError",
    "Job",
    "JobFailedError",
    "LightshaftError",
    "LineSpace",
    "MissingExtraError",
    "NotFoundError",
    "Page",
    "PictureChoice",
    "ProblemError",
    "Progress",
    "RenderSettings",
    "Scene",
    "Settings",
    "UnexpectedAnswerError",
    "UnreachableError",
    "WaitTimeoutError",
    "models",
]
