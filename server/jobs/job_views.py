"""Bodies of the HTTP interface for bulk jobs; points are in frame `machine`, as targets are."""

from datetime import datetime
from enum import StrEnum
from typing import Literal, Self

from pydantic import Base64Bytes, Field, model_validator

from bulk.job_file import ContainerPlace, JobFile
from bulk.material import Material
from machine.conventions import DEFAULT_PACE_RATIO, LINE_PATTERN, Mode
from server.schemas.console import Request, View

MAX_SURVEY_LENGTH = 6_000_000
"""Bytes of a survey: as CSV some 250 000 points."""
LandedBy = Literal["measured", "predicted", "entered"]
JobStatus = Literal["open", "ended"]


class PlanningState(StrEnum):
    """Where the plan of the next loads stands."""

    PLANNING = "planning"
    READY = "ready"
    NOTHING_LEFT = "nothing_left"
    """No load would bring the surface nearer to the goal."""
    FAILED = "failed"


class SurveyRequest(Request):
    """Brings a survey, or none."""

    survey_csv: str | None = Field(default=None, max_length=MAX_SURVEY_LENGTH)
    """Lines `x_m,y_m,z_m`."""
    survey_base64: Base64Bytes | None = Field(default=None, max_length=MAX_SURVEY_LENGTH)
    """In its place the bytes of a GeoTIFF, LAS, LAZ or CSV file."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if self.survey_csv is not None and self.survey_base64 is not None:
            raise ValueError("give a survey as survey_csv or as survey_base64, not as both")
        return self

    @property
    def survey(self) -> bytes | None:
        """Content of the survey's file."""
        return self.survey_base64 if self.survey_csv is None else self.survey_csv.encode()


class JobRequest(SurveyRequest):
    """Begin a job. `file.survey` names the survey that is sent with it."""

    machine_id: str = Field(max_length=32)
    file: JobFile
    """Without objects, zones and landing scatter: those are the machine's own."""

    @model_validator(mode="after")
    def _check_file(self) -> Self:
        if self.file.objects or self.file.zones or self.file.landing:
            raise ValueError("objects, zones and landing are the machine's own; leave them out")
        if "\x00" in self.file.name:
            raise ValueError("the name has a NUL character")
        if (self.file.survey is None) != (self.survey is None):
            raise ValueError("a survey is sent with the job, and file.survey names it")
        return self


class JobChange(Request):
    """Changes a job as it was shown."""

    version_count: int = Field(ge=1)
    """Of the job that the change was made for; another one is refused."""


class JobSkipRequest(JobChange):
    """Pass a proposal over until the next load."""

    proposal_count: int = Field(ge=1, le=3)


class JobMoveRequest(JobSkipRequest):
    """Move a proposal."""

    x_m: float = Field(ge=-60.0, le=60.0)
    y_m: float = Field(ge=-60.0, le=60.0)


class JobLoadRequest(JobChange):
    """Record a throw, or a load that was placed otherwise, as a load of the job."""

    throw_id: str | None = Field(default=None, pattern=r"^[A-Za-z0-9_-]{1,64}$")
    x_m: float | None = Field(default=None, ge=-60.0, le=60.0)
    y_m: float | None = Field(default=None, ge=-60.0, le=60.0)
    volume_m3: float | None = Field(default=None, gt=0.0, le=3.0)
    """Of a throw: left out, that of the proposal that it was aimed at, else a full grab."""

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        by_hand = (self.x_m, self.y_m, self.volume_m3)
        if self.throw_id is None and None in by_hand:
            raise ValueError("give throw_id, or x_m, y_m and volume_m3")
        if self.throw_id is not None and (self.x_m, self.y_m) != (None, None):
            raise ValueError("a throw has its own place; leave x_m and y_m out")
        return self


class JobSurveyRequest(JobChange, SurveyRequest):
    """Put a surveyed surface in place of the computed one.

    Cells that it leaves out keep their height; the goal has to be covered.
    """

    @model_validator(mode="after")
    def _check_survey(self) -> Self:
        if self.survey is None:
            raise ValueError("give the survey as survey_csv or as survey_base64")
        return self


class JobEndRequest(JobChange):
    """End a job."""

    reason: str = Field(default="", max_length=300, pattern=LINE_PATTERN)


class JobProgress(View):
    """How far a job is."""

    wanted_m3: float
    missing_m3: float
    placed_m3: float
    spilled_m3: float
    unevenness_m: float
    """Standard deviation of the surface about the wanted one."""
    filled_ratio: float
    spill_ratio: float


class JobProposal(View):
    """A load that is proposed; a person aims and holds it in Operate."""

    proposal_count: int
    """Its number, from 1."""
    mode: Mode
    pace_ratio: float = DEFAULT_PACE_RATIO
    x_m: float
    y_m: float
    z_m: float
    """Height that a preview takes there: that of the material, unless the site cannot hold it."""
    surface_m: float
    """Height of the material there."""
    volume_m3: float
    spill_ratio: float
    sentence: str


class JobLoadView(View):
    """A load that was thrown, or entered."""

    load_count: int
    """Its number in the job, from 1."""
    throw_id: str | None
    x_m: float
    y_m: float
    volume_m3: float
    spread_m: tuple[float, float] | None
    """Standard deviations of its places as measured, along the longest axis and across."""
    landed_by: LandedBy
    recorded_by: str
    at_utc: datetime
    is_withdrawn: bool
    filled_ratio: float | None
    """Of the job after it; null for withdrawn ones and those before the last survey."""
    spill_ratio: float | None


class JobSummary(View):
    """One line of the list of jobs."""

    job_id: str
    machine_id: str
    name: str
    status: JobStatus
    version_count: int
    created_utc: datetime
    created_by: str
    ended_utc: datetime | None
    ended_by: str | None
    filled_ratio: float
    load_count: int
    """Loads that count."""


class JobPage(View):
    """Jobs, newest first; pass `next_cursor` to go on."""

    items: tuple[JobSummary, ...]
    next_cursor: str | None


class JobView(JobSummary):
    """A job with its progress, what is proposed next, and its loads, oldest first."""

    end_reason: str
    file: JobFile
    """With the objects of the site when it began."""
    material: Material
    grab_kg: float
    progress: JobProgress
    thrown_m3: float
    loads_per_s: float | None
    time_left_s: float | None
    plan_state: PlanningState
    plan_error: str | None
    landing_by: Literal["measured", "predicted"] | None
    """Where the plan has the scatter of the landings from."""
    next: tuple[JobProposal, ...]
    loads: tuple[JobLoadView, ...]


class JobSurface(View):
    """A job's ground; heights (rows along y, columns along x), to the millimetre."""

    version_count: int
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    height_m: tuple[tuple[float, ...], ...]
    wanted_m: tuple[tuple[float, ...], ...]
    start_m: tuple[tuple[float, ...], ...]
    region: tuple[tuple[bool, ...], ...]
    """Cells of the goal."""
    containers: tuple[ContainerPlace, ...]
