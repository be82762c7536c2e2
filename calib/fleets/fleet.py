"""A fleet: results of robots of one model, and the prior of the next robot (`calib.fleets.hierarchy`)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.contributions import Contribution, Contributions, Uncertainty, names_of
from calib.core.base.errors import DataError, InputError, nearest
from calib.core.base.files import write_files
from calib.core.base.parameter import Parameter
from calib.core.base.sections import COMPONENTS
from calib.core.base.words import as_data, count_noun, distinct_names, listing, plain_text, text_table
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.results.loaded_result import LoadedResult
from calib.core.results.result_reading import load_result
from calib.core.robots.description import description_yaml
from calib.core.robots.robot import Robot
from calib.fleets.comparing_results import require_one_model
from calib.fleets.contradicted_prior import (
    evidence_of_fit,
    scales_of,
    section_of,
    shared_parameters,
    without_fleet,
)
from calib.fleets.hierarchy import FleetComparison, Hierarchy, learn_without_odd
from calib.fleets.ur_files import is_calibration, result_of_calibration

_WIDTH = 118
_CONFIRMED = 1.25  # largest ratio of estimated and stated noise, in either direction, that confirms the statement
_MOST_CONFIRMED = 60.0  # largest degrees of freedom, since the next robot's instrument may be another one
_STATEMENT = 8.0
"""Degrees of freedom of a stated noise, whose own uncertainty is 25 %: 1 / (2 * 0.25^2) (jcgm100, G.4.2)."""
_NAMED = 3  # unlike parameters of a robot that are named
_UNPROVEN = {
    "CHECK": "systematic errors of this fit would count as properties of the robot.",
    "FAIL": "errors of this fit may count as properties of the robot: leave the robot out, or fit it again.",
}
_SCREEN = 12  # robots, and parameters, whose tables fit on a screen of 40 lines


@dataclass(frozen=True)
class Member:
    """One robot of a fleet.

    Attributes:
        name: The part of its folder's name that the others do not have.
        folder: Path of its result.
        verdict, n_poses: Verdict and number of poses of its result.
        is_unlike: Whether it is unlike the others; mean and spread are then computed without it.
        combined_rms: Root mean square deviation from the others' prediction, 1 on average; NaN if not tested.
        p_value: Probability of such a deviation, over all tests of this robot; NaN if not tested.
        unlike_parameters: Parameters of an unlike robot with significant deviations, the largest first, in standard
            deviations of the prediction.
    """

    name: str
    folder: str
    verdict: str
    n_poses: int
    is_unlike: bool
    combined_rms: float
    p_value: float
    unlike_parameters: tuple[tuple[str, float], ...]

    def sentence(self) -> str:
        """Return a text that says whether it is like the others."""
        if np.isnan(self.p_value):
            return "not tested"
        if not self.is_unlike:
            return "like the others"
        words = listing([f"{name} ({away:+.0f} sigma)" for name, away in self.unlike_parameters[:_NAMED]])
        return f"UNLIKE the others: {words or 'many small differences'}"


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(ReadOnlyArrays):
    """Robots of one model.

    Attributes:
        robot: The first robot, nominal, with the prior of the next robot in its description.
        members: The robots.
        parameters: Shared parameters, with the sigmas of the description.
        nominal: Nominal values, (n,) [SI].
        mean, mean_std: Mean over the robots, and its standard deviation, (n,) [SI].
        spread: Standard deviation from robot to robot, (n,) [SI].
        n_determined: Number of robots that determine each parameter, (n,).
        values, stds: Values of each robot, with the others as its prior, (n_robots, n) [SI]; for an unlike robot, from
            its own fit.
        notes: Remarks for users.
        contains: Contributions to `mean_std` and `stds`; empty where results do not say them.
    """

    robot: Robot
    members: tuple[Member, ...]
    parameters: tuple[Parameter, ...]
    nominal: FloatArray
    mean: FloatArray
    mean_std: FloatArray
    spread: FloatArray
    n_determined: FloatArray
    values: FloatArray
    stds: FloatArray
    notes: tuple[str, ...]
    contains: Contributions = frozenset()

    def __repr__(self) -> str:
        odd = [member.name for member in self.members if member.is_unlike]
        ending = f"; unlike the others: {listing(odd)}" if odd else ""
        return f"<fleet of {len(self.members)} robots '{self.robot.name}', {len(self.parameters)} parameters{ending}>"

    def __str__(self) -> str:
        return self.report()

    def report(self, *, verbose: bool = False) -> str:
        """Return the fleet as text: the robots, then the parameters.

        With `verbose`, all of them; else, if there are too many, the robots least like the others, and the parameters
        with the most significant mean.
        """
        robots = text_table(
            ("robot", "verdict", "poses", "off", "p", "comparison"), ("robot", "verdict", "comparison"), plain=True
        )
        some, odd = [*range(len(self.members))], np.array([member.is_unlike for member in self.members])
        if not verbose:
            some = _first(np.nan_to_num([member.p_value for member in self.members], nan=2.0), odd)
        for member in (self.members[k] for k in some):
            off = "-" if np.isnan(member.combined_rms) else f"{member.combined_rms:.2f}"
            chance = "-" if np.isnan(member.p_value) else f"{member.p_value:.2g}"
            robots.add_row(member.name, member.verdict, str(member.n_poses), off, chance, member.sentence())
        others = _hidden_count_lines(len(self.members) - len(some), "robot", "are more like the others")
        heads = ("parameter", "unit", "expected +-", "mean - nominal", "+-", "spread", "robots showing it")
        table, away = text_table(heads, ("parameter", "unit"), plain=True), self.mean - self.nominal
        shown = range(len(away)) if verbose else _first(-np.abs(away) / self.mean_std)
        for k in shown:
            parameter, numbers = self.parameters[k], (away[k], self.mean_std[k], self.spread[k])
            cells = [f"{round(float(number) * parameter.per_si, 4) + 0.0:.4f}" for number in numbers]
            table.add_row(
                parameter.name, parameter.unit, f"{parameter.sigma:.4g}", *cells, f"{self.n_determined[k]:.1f}"
            )
        less = _hidden_count_lines(len(away) - len(shown), "parameter", "differ less clearly from nominal")
        counted = [f"Uncertainty of means: counts {', '.join(names_of(self.contains))}"] if verbose else []
        ending = ("\n" + self.conclusion(), *self.notes, *counted)
        return plain_text([robots, *others, "", table, *less, *ending], _WIDTH, wrap=True)

    def conclusion(self) -> str:
        """Return the result in a sentence."""
        odd = [member.name for member in self.members if member.is_unlike]
        spread = np.median(self.spread / np.array([p.sigma_si for p in self.parameters]))
        left = f" Left out as unlike the others: {listing(odd)}." if odd else ""
        return (
            f"{count_noun(len(self.members) - len(odd), 'robot')} show what to expect of the next one: parameters"
            f" scatter from robot to robot by {spread:.2g} times their prior sigma (median).{left}"
        )

    def to_dict(self) -> dict[str, object]:
        """Return the fleet for `--json`, in the units of tables; null for missing numbers."""
        rows = []
        for k, parameter in enumerate(self.parameters):
            row = {"name": parameter.name, "unit": parameter.unit, "sigma": parameter.sigma}
            row |= {key: getattr(self, key)[k] * parameter.per_si for key in ("nominal", "mean", "mean_std", "spread")}
            row["shown"] = self.n_determined[k]
            rows.append(row | {key: list(getattr(self, key)[:, k] * parameter.per_si) for key in ("values", "stds")})
        members = [
            {
                "name": member.name,
                "folder": member.folder,
                "verdict": member.verdict,
                "n_poses": member.n_poses,
                "odd": member.is_unlike,
                "together": member.combined_rms,
                "p_value": member.p_value,
                "unlike": [{"parameter": name, "distance": away} for name, away in member.unlike_parameters],
            }
            for member in self.members
        ]
        contains = {Uncertainty.COVARIANCE.name.lower(): names_of(self.contains)}
        every = {"robots": members, "parameters": rows, "chance": FALSE_ALARM, "notes": self.notes}
        return as_data(every | {"contains": contains})

    def save(self, path: Path | str, *, force: bool = False) -> None:
        """Write the robot description with the fleet's prior, and its URDF beside it under the same name.

        Args:
            path: YAML file to write.
            force: Whether to replace files that this program did not write, or that were edited.

        Raises:
            InputError: A file cannot be written, or must not be replaced.
        """
        path, urdf = Path(path), urdf_beside(path)
        text = description_yaml(self.robot.description.model_copy(update={"urdf": urdf.name}))
        inputs = (self.robot.path, self.robot.urdf.path)
        write_files({urdf: self.robot.urdf.source, path: text.encode()}, inputs=inputs, force=force)


def _first(order: FloatArray, always: BoolArray | Literal[False] = False) -> list[int]:
    """Indices of the items to show on a screen, ascending: the smallest of `order`, and those in `always`."""
    rank = np.argsort(np.argsort(order, kind="stable"))
    return [int(k) for k in np.flatnonzero((rank < _SCREEN) | always)]


def _hidden_count_lines(count: int, noun: str, why: str) -> list[str]:
    return [f"{count_noun(count, f'more {noun}')} {why}: --verbose prints them"] if count else []


def urdf_beside(path: Path | str) -> Path:
    """Return the path of a description's URDF; `InputError` for a name without .yaml."""
    if Path(path).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{path}: the name of a robot description ends in .yaml")
    return Path(path).with_suffix(".urdf")


def fleet(*results: Path | str) -> Fleet:
    """Make the prior of the next robot of a model from results of others.

    Args:
        results: Two or more result folders, of different robots with the same URDF and parameters; or calibrations of
            Universal Robots (YAML), of robots of one type.

    Raises:
        InputError: Fewer than two results, or a repeated one.
        DataError: A folder holds no result, or a damaged one, or one of another model, with other parameters, or from
            the same readings.
        ComputationError: A result failed, and was not forced.
    """
    if len(results) < 2:
        raise InputError(f"{count_noun(len(results), 'result')} given; give those of two or more robots of one model")
    if len({os.path.realpath(result) for result in results}) < len(results):
        raise InputError("a result folder is given twice; give each robot once")
    if not any(is_calibration(result) for result in results):
        return _fleet([Path(result) for result in results])
    with TemporaryDirectory() as scratch:
        folders = [*map(Path, results)]
        for k, (result, name) in enumerate(zip(results, distinct_names(results), strict=True)):
            if is_calibration(result):
                folders[k] = Path(scratch) / name.replace("/", "_").removesuffix(Path(result).suffix)
                result_of_calibration(result, folders[k])
        learned = _fleet(folders, _STATEMENT)  # these fits have no noise of an instrument
    members = [replace(member, folder=str(result)) for member, result in zip(learned.members, results, strict=True)]
    return replace(learned, members=tuple(members))


def _fleet(folders: Sequence[Path], noise_freedom: float | None = None) -> Fleet:
    """The fleet of these results; if not given, the results tell how far the noise is known."""
    loaded = [load_result(folder) for folder in folders]
    shared = _shared_parameters(loaded)
    _require_different(loaded)
    evidence = []
    for result in loaded:
        uncertainty, freedom = result.uncertainty, float(result.content["degrees_of_freedom"])
        evidence.append(evidence_of_fit(result.robot, uncertainty.free, uncertainty.covariance, freedom, shared))
    learned, odd, compared = learn_without_odd(evidence, _kinds(loaded[0].robot, shared))
    like = [result for k, result in enumerate(loaded) if k not in odd]
    freedom = _confirmed_freedom(like) if noise_freedom is None else noise_freedom
    section = section_of(learned, len(like), shared, freedom)
    bare = without_fleet(loaded[0].robot).with_nominal_values()
    scales, nominal = scales_of(shared)
    values, stds = _values_of_each(loaded, learned, odd, shared)
    return Fleet(
        replace(bare, files={}, description=bare.description.model_copy(update={"fleet": section})),
        tuple(
            _member(name, result, k in odd, compared[k], shared)
            for k, (name, result) in enumerate(zip(distinct_names(folders), loaded, strict=True))
        ),
        shared,
        nominal,
        nominal + learned.mean * scales,
        np.sqrt(np.diag(learned.covariance)) * scales,
        np.sqrt(learned.variance) * scales,
        learned.n_determined,
        values,
        stds,
        tuple(_notes(folders, loaded, odd)),
        frozenset[Contribution]().union(*(result.fit.contains(Uncertainty.COVARIANCE) for result in like)),
    )


def _shared_parameters(results: Sequence[LoadedResult]) -> tuple[Parameter, ...]:
    """Shared parameters of the robots; an error if models or free parameters differ."""
    first, path = shared_parameters(results[0].robot), results[0].path
    if not first:
        raise DataError(f"{path}: has no free parameters that robots share (origins, joint terms); free some")
    require_one_model(results)
    for result in results[1:]:
        both = {path: [p.name for p in first], result.path: [p.name for p in shared_parameters(result.robot)]}
        for less, more in ((result.path, path), (path, result.path)):
            if missing := [name for name in both[more] if name not in both[less]]:
                raise DataError(
                    f"{less}: has no free parameter '{missing[0]}', which {more} has; fit all with the same"
                    f" parametrisation and --terms{nearest(missing[0], both[less])}"
                )
    return first


def _require_different(results: Sequence[LoadedResult]) -> None:
    """Raise `DataError` if two results used the same readings, and so are of one robot."""
    used = [set(result.readings().get("identification", {})) for result in results]
    for k, readings in enumerate(used):
        for other in range(k):
            if readings & used[other]:
                raise DataError(
                    f"{results[k].path}: used {count_noun(len(readings & used[other]), 'reading')} of"
                    f" {results[other].path}: both are of one robot; give each robot once"
                )


def _kinds(robot: Robot, shared: Sequence[Parameter]) -> IntArray:
    """Kind of each parameter: lengths and angles of origins, coefficients of each kind of term."""
    of_terms = {p.name for term in robot.terms for p in term.parameters}
    words = []
    for p in shared:
        origin = p.name.rpartition(".")[2] in COMPONENTS and p.name not in of_terms
        term = "" if p.nominal_si or origin else p.name.partition(".")[2].partition("_")[0]
        words.append(f"{p.dimension} {term}")
    return np.array([list(dict.fromkeys(words)).index(word) for word in words], dtype=np.intp)


def _values_of_each(
    results: Sequence[LoadedResult],
    learned: Hierarchy,
    odd: Sequence[int],
    shared: Sequence[Parameter],
) -> tuple[FloatArray, FloatArray]:
    """Values and standard deviations of each robot, (n_robots, n) [SI]."""
    scales, nominal = scales_of(shared)
    values, stds = np.empty((2, len(results), len(shared)))
    like = [k for k in range(len(results)) if k not in odd]
    values[like], stds[like] = nominal + scales * learned.estimates, scales * learned.deviations
    for k in odd:
        robot, own = results[k].robot, results[k].uncertainty
        place, std = robot.parameters.places(p.name for p in shared), np.zeros(len(robot.values))
        std[own.free] = np.sqrt(np.diag(own.covariance))
        values[k], stds[k] = robot.values[place], std[place]
    return values, stds


def _member(
    name: str, result: LoadedResult, odd: bool, compared: FleetComparison | None, shared: Sequence[Parameter]
) -> Member:
    content, folder = result.content, result.path
    grade, n_poses = str(content["verdict"]["grade"]), int(content["n_poses"])
    if compared is None:
        return Member(name, folder, grade, n_poses, odd, np.nan, np.nan, ())
    n = int(np.sum(np.isfinite(compared.p_values)))
    order = np.argsort(-np.nan_to_num(np.abs(compared.distances)))
    unlike = [(shared[k].name, float(compared.distances[k])) for k in order if n * compared.p_values[k] < FALSE_ALARM]
    named = tuple(unlike) if odd else ()
    return Member(name, folder, grade, n_poses, odd, compared.combined_rms, compared.p_value(), named)


def _confirmed_freedom(results: Sequence[LoadedResult]) -> float:
    """Degrees of freedom with which results confirm the stated noise; 0 if they contradict it."""
    contents = [result.content for result in results]
    stated = [content for content in contents if content.get("sigma_stated") and content["sigma"] is not None]
    freedom = np.array([float(content["degrees_of_freedom"]) for content in stated])
    squares = np.array([(content["sigma"] / content["sigma_stated"]) ** 2 for content in stated])
    if not len(stated) or not 1 / _CONFIRMED < np.sqrt(freedom @ squares / np.sum(freedom)) < _CONFIRMED:
        return 0.0
    return round(min(float(np.sum(freedom)), _MOST_CONFIRMED), 1)


def _notes(folders: Sequence[Path], results: Sequence[LoadedResult], odd: Sequence[int]) -> list[str]:
    notes = []
    named = zip(distinct_names(folders), results, strict=True)
    grades = [(name, str(result.content["verdict"]["grade"])) for name, result in named]
    for grade, why in _UNPROVEN.items():
        names = [name for name, verdict in grades if verdict == grade]
        if names:
            notes.append(f"Verdict {grade}: {listing(names)}; {why}")
    if len(folders) - len(odd) < 5:
        notes.append("Spreads of fewer than five robots are uncertain, so the prior of the next robot is wide.")
    if len(folders) == 2:
        notes.append("With two robots, neither can be recognised as unlike the fleet.")
    return notes
