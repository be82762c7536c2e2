"""What every reader of a result may rely on: the shape of `result.json`, and that its other files are as written.

Entries that are not read back are not checked; null stands for a number that is not known.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from calib.core.base.errors import DataError

_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Count = Annotated[int, Field(strict=True, ge=0)]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True)


class _Parameter(_Part):
    name: str
    unit: str
    nominal: _Number | None
    value: _Number
    std: _Number | None
    low95: _Number | None
    high95: _Number | None
    status: str
    family: str


class _Verdict(_Part):
    grade: Literal["PASS", "CHECK", "FAIL"]
    reasons: list[str]
    grades: list[str] = []
    forced: bool = False

    @model_validator(mode="after")
    def _one_grade_for_each_reason(self) -> _Verdict:
        if "grades" in self.model_fields_set and len(self.grades) != len(self.reasons):
            raise ValueError("there are not as many grades as reasons")
        if self.grade == "FAIL" and not self.reasons:
            raise ValueError("it failed without a reason")
        return self


class _Sizes(_Part):
    rms: _Number | None


class _States(_Part):
    after: _Sizes


class _NoiseOfPart(_Part):
    name: str
    unit: str
    sigma: _Number | None


class _Instrument(_Part):
    name: str
    parts: Annotated[list[_NoiseOfPart], Field(min_length=1)]


class _Outlier(_Part):
    set: str
    pose: str | None
    target: str
    row: _Count | None = None


class _Curve(_Part):
    joint: str
    unit: str
    low: _Number
    high: _Number


class _Terms(_Part):
    asked: str | None
    entries: list[dict[str, Any]]
    curves: list[_Curve]


class _Result(_Part):
    robot: str
    comments: list[str]
    verdict: _Verdict
    next: str = ""
    n_poses: _Count
    n_rows: _Count
    sigma: _Number | None
    degrees_of_freedom: Annotated[_Number, Field(gt=0)]
    interval_degrees_of_freedom: _Number | None
    widened: Annotated[_Number, Field(ge=1)] = 1.0
    joint_error: Annotated[_Number, Field(ge=0)] = 0.0
    shared: Annotated[_Number, Field(gt=0)] | None
    parameters: list[_Parameter]
    errors: dict[str, _States]
    instruments: Annotated[list[_Instrument], Field(min_length=1)]
    outliers: list[_Outlier]
    excluded: list[Any]
    joint_terms: _Terms
    sha256: dict[str, str]


def unchanged(folder: Path | str, name: str, content: Mapping[str, Any]) -> Path:
    """Return the path of a file of a result, which is as the fit wrote it.

    Args:
        folder: Of the result.
        name: Of the file.
        content: What `result.json` holds. Results of earlier versions have digests of the nominal robot alone; their
            tables are believed.

    Raises:
        DataError: The file is missing, or was changed.
    """
    path = Path(folder) / name
    if not path.is_file():
        raise DataError(f"{path}: no such file; run the fit again")
    digest = content.get("sha256", {}).get(name)
    tables_of_earlier = digest is None and path.suffix == ".csv"
    if not tables_of_earlier and hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        raise DataError(f"{path}: was changed after the fit, so the result is no longer valid; run the fit again")
    return path


def damage(content: object) -> str:
    """Return the first thing of a result's content that readers could not read, with its place; empty if there is none.

    Args:
        content: What `result.json` holds.
    """
    try:
        _Result.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in first["loc"]).lstrip(".")
        return f"'{place}': {first['msg'][:1].lower()}{first['msg'][1:]}" if place else "it is not an object"
    return ""
