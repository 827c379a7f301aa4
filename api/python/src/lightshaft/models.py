"""What the service takes and answers. Written by generate.py from api/openapi.json: do not edit."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, TypeAlias

#: A layer of the EXR. The first ten tell of the first hit of the ray through the pixel's centre, the others what Line
#: Spaces did for all rays of the pixel's first sample.
AovName = Literal[
    "depth",
    "position",
    "geometric_normal",
    "shading_normal",
    "albedo",
    "instance_id",
    "primitive_id",
    "material_id",
    "box_tests",
    "triangle_tests",
    "line_space_gamma",
    "line_space_answer",
    "line_space_look_ups",
    "line_space_skipped",
]

#: Which Line Spaces policy `exact` asks before the structure of their mesh is walked. The answers are the same.
Ask = Literal["where_it_pays", "always"]

#: How an attempt ended; the failures are the retry classes of `RetryClass`.
AttemptOutcome = Literal[
    "running",
    "succeeded",
    "worker",
    "task",
    "transient",
    "interrupted",
    "expired",
    "cancelled",
]

#: Tables of Keul's dissertation (2020, "Efficient ray tracing with line space").
BenchmarkPreset = Literal[
    "keul-4.1",
    "keul-4.2",
    "keul-5.1",
    "keul-6.1",
    "keul-7.2",
    "keul-7.3",
    "keul-7.4",
    "keul-8.1",
    "keul-8.2",
    "keul-8.3",
]

#: What Line Spaces are used for in one bounce.
BouncePolicy = Literal["exact", "approximate_occlusion", "adaptive", "representative"]

BuildQuality = Literal["fast", "medium", "high"]

#: The kind of device that built something.
BuiltOn = Literal["cpu", "gpu"]

CacheSource = Literal["built", "memory", "disk", "fetched"]

CameraChoice: TypeAlias = "int | str | CustomCamera | dict[str, Any]"

CaseState = Literal["rendering", "confirming", "finished", "cancelled"]

ConfirmationState = Literal["not_needed", "running", "confirmed", "refuted", "impossible"]

DecisionKind = Literal["approved", "rejected", "reset"]

DeliveryState = Literal["waiting", "delivered", "given_up"]

DeviceChoice = Literal["auto", "cpu", "gpu"]

DeviceKind = Literal["cpu", "gpu"]

#: What is rendered. The scene is lit the same for all configurations: see each.
Effect: TypeAlias = "dict[str, Any]"

#: A number (grey radiance), `[r, g, b]`, or a map uploaded to `/v1/blobs`.
Environment: TypeAlias = "float | list[float] | EnvironmentMap | dict[str, Any]"

EventKind = Literal[
    "job.created",
    "job.changed",
    "job.started",
    "job.progress",
    "job.preview",
    "job.succeeded",
    "job.failed",
    "job.cancelled",
    "job.retried",
    "job.deleted",
    "task.leased",
    "task.succeeded",
    "task.failed",
    "task.retried",
    "task.expired",
    "task.cancelled",
]

FarmJobPhase = Literal["warm_up", "sample", "a", "b"]

#: No pixel may differ.
Identical = Literal["identical"]

#: `"identical"`, or the limits of what still passes. A picture whose decoded pixels are those of an accepted one
#: always passes.
ImageTolerance: TypeAlias = "Identical | dict[str, Any]"

ImageVerdict = Literal["identical", "within_tolerance", "changed", "missing", "failed"]

Integrator = Literal["aov", "ao", "direct", "whitted", "path"]

JobKind = Literal["render", "benchmark", "build", "compare"]

JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]

LightKind = Literal["point", "spot", "directional"]

LineSpaceBuilder = Literal["mask", "clip", "ray_cast", "layered"]

#: What is stored for a shaft: all lines between two patches.
LineSpacePayload = Literal["binary", "candidate", "tri_state", "coverage"]

#: Times are kept, but not judged.
Off = Literal["off"]

#: What to do where a Line Space needs more than its budget.
OnOverBudget = Literal["refuse", "shrink", "skip"]

#: What is done in the box in which an occlusion ray starts.
OriginNode = Literal["exact", "skip"]

#: How an object is met by rays that start in its box.
OriginObject = Literal["exact", "line_space"]

Output = Literal["png", "exr"]

#: What a worker is at within a task.
Phase = Literal["fetch", "import", "structures", "prepare", "render", "output"]

#: Which file a case is judged by: the EXR (linear, as it was computed) where there is one.
PictureSource = Literal["exr", "png"]

#: What Line Spaces are used for.
Policy: TypeAlias = 'Literal["exact", "approximate_occlusion", "adaptive", "representative"] | dict[str, Any]'

#: What is done in the box in which an indirect ray starts.
RepresentativeOrigin = Literal["exact", "approximate"]

RunKind = Literal["check", "calibration"]

RunState = Literal["running", "finished", "cancelled"]

ServiceState = Literal["active", "idle", "waiting", "inoperable"]

#: Settings of a render of which only some are given, over others: field by field.
SettingsPatch: TypeAlias = "dict[str, Any]"

Split: TypeAlias = "dict[str, Any]"

StructureKind = Literal["two_level", "bvh", "grid", "octree", "ntree"]

TaskState = Literal[
    "blocked",
    "ready",
    "leased",
    "succeeded",
    "failed",
    "cancelled",
    "dead",
]

#: What a task does.
TaskWork: TypeAlias = "dict[str, Any]"

#: Which of a job's metrics is the time of a case.
TimeMetric = Literal["render_s", "build_s", "prepare_s", "total_s"]

#: `"off"`, or how much longer a case may take.
TimeTolerance: TypeAlias = "Off | dict[str, Any]"

TimeVerdict = Literal["faster", "same", "slower", "too_noisy_to_say"]

ToneMap = Literal["pbr_neutral", "agx", "none"]

#: The run of `run.finished`, the decision of `decision.made`, the case of the others.
WebhookData: TypeAlias = "dict[str, Any]"

#: What a webhook can be told of. Calibrations are no news.
WebhookEvent = Literal[
    "run.finished",
    "case.changed",
    "case.missing",
    "case.failed",
    "case.slower",
    "decision.made",
]

WorkerState = Literal["idle", "busy", "draining", "gone"]


@dataclass(kw_only=True)
class Acceleration:
    """Which spatial structure rays are traced over. All give the same picture; what differs is time and memory."""

    #: Of policy `adaptive`.
    adaptive: Adaptive | dict[str, Any] | None = None
    #: Of `grid`, `octree` and `ntree`: a structure that would need more is refused; 1048576 (1 MiB) and more, 4 GiB
    #: when null.
    budget_bytes: int | None = None
    #: Of `grid`: cells for each primitive, 1 to 64; 4 when neither this nor `resolution` is given.
    cells_per_primitive: int | None = None
    #: Levels of subdivision. Of `ntree`: 1 to 6, 3 when null. Of `octree`: 1 to 16, 12 when null.
    depth: int | None = None
    #: Of `two_level` and `ntree`, on the CPU: what is known of the lines through each mesh, or each node; null for
    #: nothing.
    line_space: LineSpace | dict[str, Any] | None = None
    #: Of `ntree` and `octree`: cells with at most so many primitives are not subdivided, 0 to 1024; 8 when null.
    max_leaf: int | None = None
    #: Of `ntree`: cells of a node on each axis, 2 to 16; 6 when null.
    n: int | None = None
    #: Of policy `approximate_occlusion`, with boxes below the mesh's own: what is done in the box in which a ray
    #: starts.
    origin_node: OriginNode | None = None
    #: Of the same: boxes nearer to a ray's start or end than so many of their longest edges count as the one in which
    #: it starts, 0 to 16. Without (0), a surface darkens itself along the borders of boxes, and lamps stand in their
    #: own light.
    origin_reach: float | None = None
    #: What `line_space` is used for.
    policy: Policy | None = None
    #: Of BVHs.
    quality: BuildQuality | None = None
    #: Of policy `representative`.
    representative: Representative | dict[str, Any] | None = None
    #: Of `grid`: cells on the longest axis instead, 1 to 4096.
    resolution: int | None = None
    #: Of BVHs: a triangle may stand in several leaves where that pays.
    spatial_splits: bool | None = None
    structure: StructureKind | None = None


@dataclass(frozen=True, kw_only=True)
class AcceptedPicture:
    """Any of a case's accepted pictures is right."""

    accepted_at: datetime
    artifacts: list[Artifact]
    #: Id of the decision.
    decision: str
    label: str
    #: BLAKE3 of the decoded pixels.
    pixels: str
    source: PictureSource


@dataclass(frozen=True, kw_only=True)
class AcceptedTimes:
    """The times of an accepted run."""

    accepted_at: datetime
    decision: str
    label: str
    metric: TimeMetric
    samples_s: list[float]
    #: What rendered it: versions of engine, structures and build.
    versions: dict[str, str]


@dataclass(kw_only=True)
class Adaptive:
    """The usage heuristic: `gamma` is the distance of an object's box in diagonals of it, times the size of the
    light by its distance (1 for ambient occlusion and the sky, 0 for punctual lights), times `delta`. Below 1
    the object is exact; at 1 the deepest boxes answer, and each further 1 takes one level less.
    """

    #: 0 to 1000000; 0 gives the exact picture.
    delta: float | None = None
    #: Ambient-occlusion rays are moved at random within a disc before their shaft is looked up.
    disc_sampling: bool | None = None
    #: Between two depths one is chosen at random, by the fraction.
    interpolate: bool | None = None
    origin_object: OriginObject | None = None


@dataclass(frozen=True, kw_only=True)
class Artifact:
    bytes: int
    #: BLAKE3 of the content; also its ETag.
    hash: str
    href: str
    media_type: str
    name: str


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One lease of one task. Never overwritten."""

    error: str | None = None
    finished_at: datetime | None = None
    id: str
    #: From 1.
    number: int
    outcome: AttemptOutcome
    #: The last phase that a heartbeat told of.
    phase: Phase | None = None
    started_at: datetime
    task: str
    worker: str
    worker_name: str


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """What a case has to be like, on a class of devices."""

    baseline: str
    case: str
    device_class: str
    pictures: list[AcceptedPicture]
    #: Name of the suite.
    suite: str
    times: list[AcceptedTimes]


@dataclass(kw_only=True)
class BenchmarkSettings:
    """Every configuration renders every effect from every view of every scene, in turn with the reference."""

    #: Part of the GPU adapter's name, case-insensitive; any adapter when null.
    adapter: str | None = None
    #: What is compared, 1 to 32. With a preset: empty.
    configurations: list[Configuration | dict[str, Any]] | None = None
    #: One device for all configurations; `auto` is a GPU if there is a real one that can walk all of them.
    device: DeviceChoice | None = None
    #: What is rendered, at most 16. With a preset: empty.
    effects: list[Effect] | None = None
    #: Pixels, 16 to 4096; likewise.
    height: int | None = None
    #: A configuration renders a frame as often as it takes for one time to be at least so long; 0.001 to 60.
    min_sample_s: float | None = None
    #: Samples per pixel of the pictures that are compared, 1 to 65536.
    picture_spp: int | None = None
    #: A table of Keul's work: it gives effects, configurations, references and the picture's size. Null: they are
    #: given here.
    preset: BenchmarkPreset | None = None
    #: Name of the configuration that the others are compared with; the first when null.
    reference: str | None = None
    #: Rounds in which each configuration is timed once, 3 to 1000.
    repetitions: int | None = None
    #: Ids of further scenes, beside the job's own; at most 16.
    scenes: list[str] | None = None
    seed: int | None = None
    #: Samples per pixel of a timed frame, 1 to 1024.
    spp: int | None = None
    #: At most 16. Empty: the scene's cameras, at most three of them, or three views around it where it has none.
    views: list[CameraChoice] | None = None
    #: Pixels, 16 to 4096; 512, or as in the preset's table, when null.
    width: int | None = None


@dataclass(frozen=True, kw_only=True)
class Bounds:
    max: list[float]
    min: list[float]


@dataclass(kw_only=True)
class BuildSettings:
    """Makes the structures of a scene's meshes, so that later jobs find them ready."""

    acceleration: Acceleration | dict[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class CacheReport:
    #: What built it; null where it was not built for this job. Both devices build the same, bit for bit.
    built_on: BuiltOn | None = None
    bytes: int
    #: Hash of the mesh; of a structure over all instances, a hash over their meshes and transforms.
    mesh: str
    seconds: float
    source: CacheSource
    #: Structure kind and parameters.
    structure: str


@dataclass(frozen=True, kw_only=True)
class CacheStatus:
    """What a worker's structure cache holds."""

    disk_bytes: int
    entries: int
    memory_budget_bytes: int
    memory_bytes: int


@dataclass(frozen=True, kw_only=True)
class Calibration:
    cases: list[CalibrationCase]
    created_at: datetime
    finished_at: datetime | None = None
    #: Also the id of its run: `GET /v1/farm/runs/{id}` tells of its jobs.
    id: str
    label: str
    labels: dict[str, str]
    state: RunState
    suite: str
    suite_name: str
    times: int


@dataclass(frozen=True, kw_only=True)
class CalibrationCase:
    case: str
    device_class: str | None = None
    #: The median of each run of the case that has ended.
    medians_s: list[float]
    metric: TimeMetric
    #: How far two of them lie apart, as a ratio less 1, in 19 of 20 pairs; null until the case has finished.
    noise_floor: float | None = None
    #: Whether all pictures were the same to the pixel; null until the case has finished. If not, `identical` is no fit
    #: tolerance.
    steady: bool | None = None


@dataclass(frozen=True, kw_only=True)
class CameraSummary:
    #: `perspective` or `orthographic`.
    kind: str
    name: str


@dataclass(frozen=True, kw_only=True)
class CaseNews:
    """A case that does not pass."""

    baseline: str
    #: Name of the case.
    case: str
    device_class: str | None = None
    image_verdict: ImageVerdict
    label: str
    #: Why, in words.
    reason: str | None = None
    #: Id of the run.
    run: str
    #: Name of the suite.
    suite: str
    time_verdict: TimeVerdict | None = None


@dataclass(frozen=True, kw_only=True)
class CompareReport:
    """Figures of a comparison, `b` against the reference `a`. Colours are linear; other layers have their own
    units, and are spread over their common range for SSIM and FLIP.
    """

    #: Pixels that differ in any channel by more than the tolerance, or are NaN or infinite in one picture only.
    differing_pixels: int
    flip_mean: float
    #: The error that 99 % of the pixels do not exceed.
    flip_p99: float
    #: Null where it was not wanted.
    hdr_flip: HdrFlipFigures | None = None
    height: int
    #: Mean absolute difference.
    mae: float
    #: Column and row of the first pixel with the largest difference; null when none differs.
    max_at: list[int] | None = None
    #: Largest difference of any channel.
    max_difference: float
    max_flip: float | None = None
    max_hdr_flip: float | None = None
    max_rmse: float | None = None
    #: Mean luminance of `b` over that of `a`; null when `a` is black.
    mean_ratio: float | None = None
    #: Pixels with a NaN or an infinity in either picture; left out of the means. An id that is "none" counts as one.
    non_finite_pixels: int
    #: The limits that are not kept, in words.
    over_limits: list[str]
    #: Whether every limit is kept. A figure that is not a number keeps none.
    passed: bool
    pixels: int
    #: In dB, of the pictures as a display shows them; null where they are the same there.
    psnr: float | None = None
    #: Mean of `(b - a)² / (a² + 0.01)`.
    rel_mse: float
    #: Root of the mean squared difference over all channels of all pixels.
    rmse: float
    ssim: float
    width: int


@dataclass(kw_only=True)
class CompareRequest:
    """Body of `POST /v1/compare`, and settings of a job of kind `compare`."""

    #: The reference.
    a: PictureChoice | dict[str, Any] | None = None
    #: The picture to judge, of the same size.
    b: PictureChoice | dict[str, Any] | None = None
    #: Stops by which both are brightened before FLIP and SSIM, -32 to 32. Only for colour.
    exposure: float | None = None
    #: Whether HDR-FLIP is wanted too, and drawn by the heat map: of linear colour only (OpenEXR, Radiance). It takes
    #: several exposures, and so many times as long as FLIP.
    hdr: bool | None = None
    #: Not passed when the mean FLIP error is above this.
    max_flip: float | None = None
    #: Not passed when the mean HDR-FLIP error is above this; as if `hdr` were set.
    max_hdr_flip: float | None = None
    #: Not passed when the root mean square error is above this.
    max_rmse: float | None = None
    #: Difference of a channel up to which a pixel counts as equal, in the layer's units.
    tolerance: float | None = None


@dataclass(frozen=True, kw_only=True)
class ComparedPicture:
    #: BLAKE3 of the file.
    hash: str
    layer: str


@dataclass(kw_only=True)
class Configuration:
    """One of the things that are compared."""

    acceleration: Acceleration | dict[str, Any] | None = None
    #: 1 to 64 letters, digits, spaces and `.,_+()-`; each different.
    name: str


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """The interleaved re-run of a suspected slow-down: baseline and this run in turns, on one worker, structures
    warm.
    """

    #: Seconds of the baseline's side, without the warm-up.
    a_s: list[float]
    #: Seconds of this run's side.
    b_s: list[float]
    #: Of this run's to the baseline's.
    ratio: TimeRatio | None = None
    #: In words; null when not needed.
    reason: str | None = None
    state: ConfirmationState


@dataclass(frozen=True, kw_only=True)
class CurrentWork:
    job: str
    task: str


@dataclass(kw_only=True)
class CustomCamera:
    #: Vertical field of view; 40 when neither this nor `half_height` is given.
    fov_y_deg: float | None = None
    #: Orthographic instead: half the height of the view in world units.
    half_height: float | None = None
    position: list[float]
    target: list[float]
    up: list[float] | None = None


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What somebody decided. Never changed, never deleted."""

    at: datetime
    baseline: str
    #: Null of a reset of all cases.
    case: str | None = None
    device_class: str | None = None
    id: str
    kind: DecisionKind
    label: str | None = None
    #: Identity of the picture that was decided of.
    pixels: str | None = None
    #: Null of a reset. A run may have been deleted since.
    run: str | None = None
    #: Name of the suite.
    suite: str
    who: str
    why: str


@dataclass(frozen=True, kw_only=True)
class DeliveryAttempt:
    at: datetime
    #: Null when the message was taken: the status was 200 to 299.
    error: str | None = None
    #: How long it took.
    seconds: float
    #: What the receiver answered; null when it did not.
    status: int | None = None


@dataclass(frozen=True, kw_only=True)
class Device:
    backend: str
    #: `DiscreteGpu`, `IntegratedGpu`, `VirtualGpu` or `Cpu`.
    device_type: str
    driver: str
    kind: DeviceKind
    name: str


@dataclass(kw_only=True)
class EnvironmentMap:
    intensity: float | None = None
    #: Hash of an equirectangular .hdr or .exr in the blob store.
    map: str
    #: About +Y.
    rotation_deg: float | None = None


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Bytes from what is known of the scene and the settings, seconds from what was measured of jobs like it."""

    #: All of these that are known.
    bytes: int
    #: Line Spaces at most, of an N-tree roughly; 0 without, and null of kinds that neither render nor build.
    line_space_bytes: int | None = None
    #: What `render_s` rests on.
    measured: MeasuredJobs | None = None
    #: The picture with its layers in single precision, while it is rendered; 0 for kinds that do not render.
    picture_bytes: int
    #: Rendering alone, without fetching and building; null while nothing like it was measured.
    render_s: float | None = None
    #: Geometry, textures and structures in a worker's memory, roughly.
    scene_bytes: int


@dataclass(frozen=True, kw_only=True)
class Event:
    """One event; `id` is also the SSE id, so that `Last-Event-ID` resumes after it."""

    at: datetime
    #: `task`, `attempt`, `worker`, `error`, `class`, `progress` (of the task), `job_progress`, `phase`, `spp`, `href`:
    #: what the kind has to say.
    data: Any
    #: Null for `job.progress` and `job.preview`: those are not kept, and a stream that resumes does not repeat them.
    id: int | None = None
    job: str
    kind: EventKind


@dataclass(frozen=True, kw_only=True)
class FarmJob:
    """A job of a case. It may have been deleted since."""

    job: str
    phase: FarmJobPhase
    #: From 0, in its phase.
    position: int
    #: The metric that the case is timed by; null until the job has succeeded.
    time_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class FieldError:
    detail: str
    #: JSON pointer into the request body (`/settings/width`), `query/<name>`, `header/<name>`, or a position in an
    #: uploaded file (`file/meshes/0/primitives/1`).
    pointer: str


@dataclass(kw_only=True)
class Ground:
    albedo: list[float] | None = None
    #: Half side length; 20 scene radii when null.
    half_size: float | None = None
    #: World height; the scene's lowest point when null.
    height: float | None = None
    roughness: float | None = None


@dataclass(frozen=True, kw_only=True)
class HdrFlipFigures:
    """HDR-FLIP: each pixel's largest error at any of several exposures, through the tone mapper of ACES."""

    #: How many were tried, evenly from start to stop.
    exposures: int
    mean: float
    #: The error that 99 % of the pixels do not exceed.
    p99: float
    #: Stops at which the brightest pixel of `a` is just not blown out.
    start_exposure: float
    #: Stops at which half of the pixels of `a` are.
    stop_exposure: float


@dataclass(frozen=True, kw_only=True)
class History:
    """A case over its labels, oldest first."""

    baseline: str
    case: str
    #: Indices into `points` at which the times change to another level (E-divisive, 99 % confidence).
    change_points: list[int]
    #: Newest first.
    decisions: list[Decision]
    device_class: str
    #: Every class that the case was rendered on.
    device_classes: list[str]
    #: Of unchanged runs; null without a calibration.
    noise_floor: float | None = None
    pictures: list[AcceptedPicture]
    points: list[HistoryPoint]
    #: Name of the suite.
    suite: str


@dataclass(frozen=True, kw_only=True)
class HistoryPoint:
    at: datetime
    confirmation: ConfirmationState
    image: ImageVerdict
    label: str
    labels: dict[str, str]
    lower_quartile_s: float | None = None
    median_s: float | None = None
    metric: TimeMetric
    ok: bool
    #: Where its picture is, as PNG.
    picture: str | None = None
    pixels: str | None = None
    run: str
    time: TimeVerdict | None = None
    upper_quartile_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class ImageFigures:
    differing_pixels: int
    flip_mean: float
    #: The FLIP error that 99 % of the pixels do not exceed.
    flip_p99: float
    #: Mean HDR-FLIP error; null where the case has no limit on it.
    hdr_flip_mean: float | None = None
    #: Mean absolute error of linear colour.
    mae: float
    #: Column and row of the pixel with the largest difference; null when nothing differs.
    max_at: list[int] | None = None
    #: Of any channel.
    max_difference: float
    pixels: int
    #: In dB, of the pictures as a display shows them; null where they are the same there.
    psnr: float | None = None
    rel_mse: float
    #: Of linear colour.
    rmse: float
    ssim: float


@dataclass(frozen=True, kw_only=True)
class ImageLimits:
    """What still passes; a picture must keep to every limit that is given."""

    #: Share of the pixels that differ at all, 0 to 1.
    max_differing: float | None = None
    #: Mean FLIP error, 0 to 1.
    max_flip: float | None = None
    #: Mean HDR-FLIP error, 0 to 1: what is seen at the exposure that shows it best. Of cases whose outputs have `exr`.
    max_hdr_flip: float | None = None
    #: Root mean square error of linear colour.
    max_rmse: float | None = None
    #: For sampled effects: repetitions are rendered with other seeds, and their mean is tested pixel by pixel.
    z_test: ZTest | None = None


@dataclass(frozen=True, kw_only=True)
class ImageResult:
    """A case's picture against the accepted one that is closest to it."""

    #: Identity of the accepted picture that it was compared with: the closest by mean FLIP. Null when there is none.
    accepted: str | None = None
    #: Null when the pictures are identical, differ in size, or there is nothing to compare with.
    figures: ImageFigures | None = None
    #: BLAKE3 of the decoded pixels: the picture's identity. Null without a picture.
    pixels: str | None = None
    #: Why it failed or changed, in words: the limits that it passes.
    reason: str | None = None
    source: PictureSource | None = None
    #: Whether repetitions gave different pixels although their seed was the same.
    unsteady: bool
    verdict: ImageVerdict
    z_test: ZTestFigures | None = None


@dataclass(frozen=True, kw_only=True)
class JobSummary:
    """One line of the list of jobs."""

    cancel_requested: bool
    created_at: datetime
    #: What a failed job failed of.
    error: str | None = None
    finished_at: datetime | None = None
    id: str
    kind: JobKind
    labels: dict[str, str]
    paused: bool
    priority: int
    #: 0 to 1 over all tasks.
    progress: float
    scene: str
    scene_name: str
    started_at: datetime | None = None
    state: JobState
    #: Succeeded tasks.
    tasks_done: int
    tasks_total: int
    #: W3C trace id, 32 hex digits, the same in every log line from submit to done.
    trace_id: str


@dataclass(kw_only=True)
class Light:
    #: Linear colour.
    color: list[float] | None = None
    #: Where it shines to; required for directional and spot.
    direction: list[float] | None = None
    #: Spot cone half angles, 0 <= inner < outer <= 90.
    inner_cone_deg: float | None = None
    #: Candela (point, spot) or lux (directional).
    intensity: float | None = None
    kind: LightKind
    outer_cone_deg: float | None = None
    #: World space; required for point and spot.
    position: list[float] | None = None
    range: float | None = None


@dataclass(frozen=True, kw_only=True)
class LightSummary:
    #: `point`, `spot` or `directional`.
    kind: str
    name: str


@dataclass(kw_only=True)
class LineSpace:
    """A Line Space for each mesh of the scene, or for each node of its N-tree: the faces of a box are cut into
    patches, and something is stored for each pair of patches. Those of meshes are cached and shared by mesh, as
    structures are.
    """

    ask: Ask | None = None
    #: Of `coverage`: bits for each shaft, 2 to 8; 8 when null.
    bits: int | None = None
    #: How it is made. Of `binary`: `mask` (when null), `clip` or `ray_cast`. Of `tri_state`: `layered`. Of the others:
    #: `ray_cast`.
    builder: LineSpaceBuilder | None = None
    #: Levels of the structure below its root whose boxes have Line Spaces. Of `two_level`: 0, the mesh's own box, when
    #: null. Of `ntree`: with policy `exact` those of all levels down to it, 1 when null, the nodes right below the
    #: root; with others the nodes at that depth, when null the deepest, or of `candidate` 1.
    depth: int | None = None
    #: Of `tri_state`: a tree that is fine only where shafts are undecided, instead of a table. Needs an `n` of 4, 8,
    #: 16 or 32, and is true for those when null.
    hierarchical: bool | None = None
    #: What all Line Spaces of the job may take, 1024 and more; 4 GiB when null.
    job_budget_bytes: int | None = None
    #: What the Line Space of one mesh may take, 1024 and more; 256 MiB when null.
    mesh_budget_bytes: int | None = None
    #: Patches along the edge of a face. Of `tri_state`: 1 to 32, 16 when null. Of `binary`: 1 to 12 with builder
    #: `mask`, 1 to 32 with the others, 8 when null. Of `candidate`: 1 to 32, 6 when null. Of `coverage`: 1 to 32, 8
    #: when null. With masks in an `ntree`: at most its own `n`, for patches are whole cells wide; when null two cells
    #: right below the root and four cells below that, and one cell with an approximate policy.
    n: int | None = None
    on_over_budget: OnOverBudget | None = None
    payload: LineSpacePayload | None = None
    #: Of `coverage`: lines cast for each shaft, 1 to 1024; 16 when null.
    rays: int | None = None
    #: Of `tri_state`: voxels along each axis while it is built: 16, 32, 64, 128 or 256; 128 when null.
    resolution: int | None = None


@dataclass(frozen=True, kw_only=True)
class LineSpaceUse:
    """Of a job with Line Spaces. One ray may ask those of several meshes, and counts each time."""

    #: Of all those, the ones that policy `approximate_occlusion` answered without proof.
    approximated: int
    #: Of those, the ones that are asked: where it pays.
    asked: int
    #: Whose line passes the mesh's box by.
    beside: int
    #: Whose shaft is empty: the mesh was skipped.
    empty: int
    #: Meshes that have one.
    meshes: int
    #: Of whose shaft nothing is certain: the structure was walked.
    mixed: int
    #: Nodes of an N-tree whose shaft was looked up, by all rays.
    node_look_ups: int
    #: Whose shaft is blocked throughout; an occlusion ray that crosses the whole box was answered.
    opaque: int
    #: Rays that asked: the sum of those below.
    rays: int
    #: Of those, the ones that were passed by with all below them.
    skipped_nodes: int
    #: That start in the mesh's box: the structure was walked.
    starts_inside: int
    #: That start too far away for single precision: the structure was walked.
    too_far: int


@dataclass(frozen=True, kw_only=True)
class MeasuredJobs:
    """Jobs with the same integrator on one device."""

    device: str
    jobs: int
    #: Median.
    mrays_per_s: float
    #: Rays of all kinds for each sample of a pixel, median.
    rays_per_sample: float
    #: Whether they rendered the same scene.
    same_scene: bool


@dataclass(frozen=True, kw_only=True)
class Mesh:
    hash: str
    spheres: int
    structures: list[Structure]
    triangles: int


@dataclass(frozen=True, kw_only=True)
class MeshSummary:
    #: In object space.
    bounds: Bounds | None = None
    hash: str
    instances: int
    name: str
    spheres: int
    triangles: int


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Measured by the worker; summed over a job's tasks."""

    #: Getting every structure: built, loaded or fetched.
    build_s: float
    cache: list[CacheReport]
    device: str
    device_kind: str
    #: From the same moment until its first tile began to be rendered; without a service, from the start.
    first_tile_s: float | None = None
    #: What Line Spaces were asked and answered; null in a job without.
    line_space: LineSpaceUse | None = None
    line_space_bytes: int
    #: On a GPU, the longest that it was held at a stretch, once its kernels were compiled; 0 on a CPU.
    longest_submit_s: float
    #: Rays of all kinds over `render_s`.
    mrays_per_s: float
    #: Encoding and uploading pictures.
    output_s: float
    #: Highest resident memory of the worker process.
    peak_bytes: int
    #: Packing and uploading to the device.
    prepare_s: float
    #: From when the first task could run, most often the submission, until a worker leased it; null without a service.
    queue_s: float | None = None
    rays: RayCounts
    render_s: float
    #: Fetching and decoding the scene.
    scene_s: float
    spp: int
    structure_bytes: int
    #: Nodes of all structures: of BVHs those of the binary trees, of grids one.
    structure_nodes: int
    total_s: float
    #: Engine, driver and shader versions.
    versions: dict[str, str]
    warnings: list[str]


@dataclass(frozen=True, kw_only=True)
class NewJob:
    """Body of `POST /v1/jobs`."""

    #: `render` when left out.
    kind: JobKind
    #: At most 32, keys up to 64 and values up to 256 characters.
    labels: dict[str, str]
    #: Attempts at each task, 1 to 20; 3 when null.
    max_attempts: int | None = None
    #: Higher runs first; -100 to 100.
    priority: int
    #: Scene id. Of `compare` it may be left out where a picture is a job's: then it is that job's scene.
    scene: str
    #: Of the kind.
    settings: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class NewRun:
    """Body of `POST /v1/farm/runs`."""

    #: The name of the baseline that it is judged against; it need not be there yet.
    baseline: str
    #: Only these cases; all when empty.
    cases: list[str]
    #: What is judged, as people call it: most often a commit. 1 to 200 characters.
    label: str
    #: `commit`, `build`, `driver`, and whatever else there is to know; as a job's labels.
    labels: dict[str, str]
    #: Settings that go before those of every case: to see the farm find what they break.
    overrides: SettingsPatch
    #: Of its jobs, -100 to 100.
    priority: int
    #: Ids or hashes of the scenes that the suite calls by a name.
    scenes: dict[str, str]
    #: Id of a suite.
    suite: str


@dataclass(kw_only=True)
class PictureChoice:
    """A picture: the artifact of a job, a blob, or (neither) the uploaded part of this name."""

    #: Name of the job's artifact; `image.exr` by default, or `image.png` when there is none.
    artifact: str | None = None
    #: Hash of a blob, as answers name pictures; beside a job, that of its artifact.
    blob: str | None = None
    job: str | None = None
    #: `color` by default. `GET /v1/jobs/{id}/artifacts/{name}/layers` lists what there is.
    layer: str | None = None


@dataclass(frozen=True, kw_only=True)
class RayCounts:
    ao: int
    indirect: int
    primary: int
    shadow: int


@dataclass(kw_only=True)
class RenderSettings:
    acceleration: Acceleration | dict[str, Any] | None = None
    #: Part of the GPU adapter's name, case-insensitive; any adapter when null.
    adapter: str | None = None
    #: Reach of ambient occlusion in world units; a tenth of the scene's diagonal when null.
    ao_distance: float | None = None
    #: Rays of ambient occlusion per pixel sample, 1 to 1024.
    ao_samples: int | None = None
    #: Layers for the EXR.
    aovs: list[AovName] | None = None
    #: A camera of the scene by name or number, or one given here; null takes the scene's first, or frames the scene.
    camera: CameraChoice | None = None
    device: DeviceChoice | None = None
    #: Constant radiance or a map; null is black, or a grey sky of 1 where the scene has no light: textures of emission
    #: are none.
    environment: Environment | None = None
    #: Stops: the picture is multiplied by `2^exposure` before tone mapping; -32 to 32.
    exposure: float | None = None
    ground: Ground | dict[str, Any] | None = None
    #: Pixels, 1 to 16384; width times height at most 67108864.
    height: int | None = None
    integrator: Integrator | None = None
    #: Lights beside the scene's own.
    lights: list[Light | dict[str, Any]] | None = None
    #: Longest path after the first hit (path), or longest chain of mirrors (whitted); 0 to 64.
    max_bounces: int | None = None
    outputs: list[Output] | None = None
    seed: int | None = None
    #: Cut the job into tasks that several workers can share; null renders it as one.
    split: Split | None = None
    #: Samples per pixel, 1 to 1048576.
    spp: int | None = None
    #: Stop after the pass in which this much time has passed, with the samples there are; null for no limit.
    time_limit_s: float | None = None
    tone_map: ToneMap | None = None
    #: Pixels, 1 to 16384.
    width: int | None = None


@dataclass(kw_only=True)
class Representative:
    """When a candidate counts as hit: its triangle stands for its whole plane."""

    #: Greatest angle between the normal, extrapolated beyond the triangle, and the triangle's mean normal; 0 to 180
    #: (any).
    angle_threshold_deg: float | None = None
    origin_node: RepresentativeOrigin | None = None
    #: By how much of its diagonal a box grows before hits outside it are dropped, 0 to 1.
    range_slack: float | None = None


@dataclass(frozen=True, kw_only=True)
class RunCase:
    """One case of a run."""

    #: `image.png`, `image.exr`; of a changed picture also `heat-map.png`, `difference.png`, and `accepted.png`,
    #: `accepted.exr`: what it was compared with.
    artifacts: list[Artifact]
    #: What somebody decided of it last.
    decision: Decision | None = None
    #: Null until its first job has ended.
    device_class: str | None = None
    #: Null until it has finished.
    image: ImageResult | None = None
    jobs: list[FarmJob]
    name: str
    #: Whether it passes or was approved; null until it has finished.
    ok: bool | None = None
    repeat: int
    #: Id of the scene.
    scene: str
    #: As rendered, the run's overrides included.
    settings: dict[str, Any]
    state: CaseState
    #: Null until it has finished, and without a picture.
    time: TimeResult | None = None
    time_tolerance: TimeTolerance
    tolerance: ImageTolerance
    #: Of what rendered it: engine, structures, and the hash of the program.
    versions: dict[str, str]
    #: The worker that renders all of it, once it is known.
    worker: str | None = None


@dataclass(frozen=True, kw_only=True)
class RunCounts:
    """How many cases of a run are what."""

    cases: int
    changed: int
    failed: int
    faster: int
    #: Cases with a verdict.
    finished: int
    identical: int
    missing: int
    #: Finished ones that pass, or were approved.
    ok: int
    rejected: int
    same: int
    slower: int
    too_noisy_to_say: int
    #: Finished ones that do not pass, and of which nobody has decided.
    undecided: int
    within_tolerance: int


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """A run in a list."""

    baseline: str
    counts: RunCounts
    created_at: datetime
    finished_at: datetime | None = None
    id: str
    kind: RunKind
    label: str
    labels: dict[str, str]
    #: Whether every case passes or was approved; null until it has finished. A calibration passes when nothing failed.
    ok: bool | None = None
    state: RunState
    suite: str
    suite_name: str


@dataclass(frozen=True, kw_only=True)
class SceneSource:
    """A file beside the suite, or a scene of the generator."""

    #: Path, relative to the suite's file.
    file: str | None = None
    #: What follows `lightshaft scene generate`: a kind, and options.
    generate: str | None = None


@dataclass(frozen=True, kw_only=True)
class SceneSummary:
    """What a scene holds: found on import."""

    #: World-space bounds of all instances; null for a scene with nothing in it.
    bounds: Bounds | None = None
    cameras: list[CameraSummary]
    #: Triangles and spheres that emit, over all instances.
    emitters: int
    #: Geometry, textures and structures in memory, roughly.
    estimated_bytes: int
    instances: int
    lights: list[LightSummary]
    materials: list[str]
    meshes: list[MeshSummary]
    spheres_total: int
    texture_pixels: int
    textures: int
    #: Over all instances.
    triangles_instanced: int
    #: Over unique meshes.
    triangles_total: int
    warnings: list[str]


@dataclass(frozen=True, kw_only=True)
class Schedule:
    #: When it was last due. Times that passed while the service was down count once.
    begun_at: datetime | None = None
    created_at: datetime
    cron: str
    #: Why the last run could not begin; null when it did.
    error: str | None = None
    id: str
    #: Id of the last run that it began; the run may have been deleted since.
    last_run: str | None = None
    name: str
    #: Null while it is paused, and when the pattern has no next time.
    next_at: datetime | None = None
    #: Whether it begins nothing until it is resumed.
    paused: bool
    run: NewRun


@dataclass(frozen=True, kw_only=True)
class Spread:
    lower_quartile_s: float
    median_s: float
    samples: int
    upper_quartile_s: float


@dataclass(frozen=True, kw_only=True)
class StateCounts:
    cancelled: int
    failed: int
    queued: int
    running: int
    succeeded: int


@dataclass(frozen=True, kw_only=True)
class Status:
    blob_bytes: int
    jobs: StateCounts
    scenes: int
    state: ServiceState
    tasks_leased: int
    tasks_ready: int
    uptime_s: float
    version: str
    workers: WorkerCounts


@dataclass(frozen=True, kw_only=True)
class StoredBlob:
    """Answer to storing a blob."""

    bytes: int
    hash: str


@dataclass(frozen=True, kw_only=True)
class Structure:
    """A built structure. Identified by mesh, kind, parameters and builder version."""

    #: BLAKE3 of the encoded structure in the blob store.
    blob: str
    build_s: float
    builder_version: int
    #: When a worker told of it.
    built_at: datetime
    bytes: int
    kind: str
    parameters: str
    #: Ids of workers that hold it warm.
    workers: list[str]


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A version of a suite."""

    cases: list[SuiteTestCase]
    created_at: datetime
    description: str
    #: BLAKE3 of the content: the version.
    hash: str
    id: str
    name: str
    scenes: dict[str, SceneSource]


@dataclass(frozen=True, kw_only=True)
class SuiteSummary:
    cases: int
    created_at: datetime
    description: str
    #: BLAKE3 of the content: the version.
    hash: str
    id: str
    name: str


@dataclass(frozen=True, kw_only=True)
class SuiteTestCase:
    """A case with every default filled in."""

    device_class: str | None = None
    image: ImageTolerance
    name: str
    repeat: int
    scene: str
    settings: dict[str, Any]
    time: TimeTolerance


@dataclass(frozen=True, kw_only=True)
class Task:
    #: Attempts spent.
    attempt: int
    #: What it failed of where no attempt says it: no worker has the device that it demands.
    error: str | None = None
    id: str
    index: int
    max_attempts: int
    progress: float
    #: From when on a waiting task may run: in the future after a failure that is worth a pause.
    ready_at: datetime | None = None
    state: TaskState
    work: TaskWork


@dataclass(frozen=True, kw_only=True)
class TimeLimit:
    #: The median may be this many times the baseline's before it is suspected; more than 1, at most 100. Where
    #: calibration found more noise than that, the noise counts.
    max_ratio: float
    metric: TimeMetric


@dataclass(frozen=True, kw_only=True)
class TimeRatio:
    high: float
    #: Between these it lies with a confidence of 95 % (percentile bootstrap).
    low: float
    #: Of the Mann-Whitney test that both sides are alike, two-sided.
    p: float
    value: float


@dataclass(frozen=True, kw_only=True)
class TimeResult:
    """A case's times against the baseline's."""

    #: Of the baseline's samples.
    baseline: Spread | None = None
    confirmation: Confirmation
    #: A ratio beyond this is suspected: the tolerance, or the noise where that is more.
    limit: float | None = None
    metric: TimeMetric
    #: How far the medians of unchanged runs lie apart, as a ratio less 1, in 19 of 20 cases; null without a
    #: calibration.
    noise_floor: float | None = None
    #: This run's median over the baseline's.
    ratio: TimeRatio | None = None
    #: The verdict in words, or why there is none.
    reason: str
    #: Seconds of each repetition, in the order in which they ran; without the warm-up.
    samples_s: list[float]
    spread: Spread | None = None
    #: Null when it is not judged: the tolerance is `off`, or the baseline has no times of this metric.
    verdict: TimeVerdict | None = None


@dataclass(frozen=True, kw_only=True)
class ValidatedJob:
    """Answer to `POST /v1/jobs?validate_only=true`: the job as it would be made, every default filled in."""

    estimate: Estimate
    job: NewJob
    #: How many tasks it would have.
    tasks: int


@dataclass(frozen=True, kw_only=True)
class Webhook:
    created_at: datetime
    #: When one was last taken.
    delivered_at: datetime | None = None
    #: What the last attempt failed of; null after a success, and before the first.
    error: str | None = None
    #: All when empty.
    events: list[WebhookEvent]
    id: str
    suite: str | None = None
    url: str
    #: Messages that are still to be delivered.
    waiting: int


@dataclass(frozen=True, kw_only=True)
class WebhookDelivery:
    """A message on its way to a webhook."""

    #: In their order.
    attempts: list[DeliveryAttempt]
    #: As in `webhook-id`.
    id: str
    message: WebhookMessage
    #: When it is sent next; null when it is not.
    next_at: datetime | None = None
    state: DeliveryState


@dataclass(frozen=True, kw_only=True)
class WebhookMessage:
    """What is sent, with the headers of Standard Webhooks: `webhook-id` stays the same when a message is sent
    again, `webhook-timestamp` is the time of the attempt in seconds, and `webhook-signature` is `v1,` and the
    base64 of HMAC-SHA256 over `id.timestamp.body`.
    """

    data: WebhookData
    #: When it happened.
    timestamp: datetime
    type: WebhookEvent


@dataclass(frozen=True, kw_only=True)
class Worker:
    cache: CacheStatus
    #: Job and task that it works on.
    current: CurrentWork | None = None
    devices: list[Device]
    draining: bool
    id: str
    last_seen_at: datetime
    name: str
    registered_at: datetime
    state: WorkerState
    tags: list[str]
    tasks_done: int
    version: str


@dataclass(frozen=True, kw_only=True)
class WorkerCounts:
    busy: int
    draining: int
    gone: int
    idle: int


@dataclass(frozen=True, kw_only=True)
class ZTest:
    """The per-pixel test of the mean of a run's repetitions against that of the baseline's, by how far repetitions
    scatter; of blocks of 2, 4, 8 and so on pixels on a side too, where what is faint and wide shows. Takes at
    least 4 repetitions; 6 or more tell small changes.
    """

    #: Share of the single pixels that may fail nevertheless, 0 to 0.1. No block may: what changes a region changes
    #: blocks.
    max_failing: float
    #: The chance that an unchanged picture fails anywhere, over all pixels and blocks together (corrected after
    #: Sidak); 1e-6 to 0.5.
    significance: float


@dataclass(frozen=True, kw_only=True)
class ZTestBlocks:
    """The test of the means of all blocks of one size."""

    blocks: int
    critical_z: float
    failing: int
    max_z: float
    #: Pixels on a side of a block.
    side: int


@dataclass(frozen=True, kw_only=True)
class ZTestFigures:
    """A per-pixel Z-test with Sidak's correction, on every level of an image pyramid."""

    #: Blocks of 2, 4, 8 and so on pixels on a side, up to one that is the whole picture. Empty of runs of older
    #: versions.
    blocks: list[ZTestBlocks]
    #: A statistic beyond this fails.
    critical_z: float
    #: Pixels that fail.
    failing_pixels: int
    #: Largest statistic of any channel of any pixel, in standard deviations.
    max_z: float
    pixels: int


@dataclass(frozen=True, kw_only=True)
class Compared(CompareReport):
    """How far two pictures are apart. The figures are also what `lightshaft compare --json` prints."""

    a: ComparedPicture
    b: ComparedPicture
    #: Address of the absolute difference as a picture.
    difference: str
    #: Address of the FLIP error (HDR-FLIP where that was wanted) of every pixel as a picture (magma: 0 is black, 1
    #: pale yellow) with a scale bar to the right; `&scale=false` leaves that out.
    heat_map: str
    #: Address of the page that shows both.
    page: str


@dataclass(frozen=True, kw_only=True)
class Job(JobSummary):
    """A whole job."""

    artifacts: list[Artifact]
    attempts: list[Attempt]
    #: Attempts at each task.
    max_attempts: int
    metrics: Metrics | None = None
    #: Where the picture so far is, while the job runs and a worker has sent one.
    preview: str | None = None
    settings: dict[str, Any]
    tasks: list[Task]
    #: Why none of its tasks runs, while the job waits.
    waiting: str | None = None


@dataclass(frozen=True, kw_only=True)
class Run(RunSummary):
    """A whole run."""

    #: In the suite's order.
    cases: list[RunCase]
    overrides: SettingsPatch
    priority: int
    #: Scenes by the names that the suite gives them.
    scenes: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class Scene(SceneSummary):
    #: Bytes of the upload.
    bytes: int
    created_at: datetime
    #: BLAKE3 of the uploaded bytes (multipart: of the canonical file list), 64 hex digits.
    hash: str
    id: str
    name: str
    #: Where the thumbnail is, once its job has succeeded.
    thumbnail: str | None = None
