"""Settings of delta printers: Klipper's `printer.cfg` with its probe's readings; `M665`, `M666` of Marlin and Duet.

Klipper keeps in `[delta_calibrate]` the travel of the motors from the switches, in steps ("stable positions"), with the
nozzle at a known height (`height3`, `height3_pos`), and at both ends of a printed object measured by a caliper
(`distance3`, `distance3_pos1`, `distance3_pos2`). Entries of its command SAVE_CONFIG, after `#*#`, replace earlier
ones.

Endstop k is the height of the nozzle at the centre when the switch of tower k trips; Klipper writes it as
`position_endstop`. In RepRapFirmware (Duet) it is H + e_k, with e_k of M666. Marlin moves down from its switches by
e_k < 0, and includes a probe's offset, Z of M851, in H: there it is H - Z - e_k.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DataError, InputError
from calib.core.base.files import read_text
from calib.core.base.units import from_unit, millimetres, quantity_text
from calib.core.data.table_writing import format_table
from calib.printers.linear_delta import ANGLES, TOWERS, DeltaGeometry, tower_angles
from calib.printers.rows import PrinterFile, PrinterRows, require_plausible, require_steps

_SECTION = re.compile(r"\[([^\]]+)\]\s*$")
_ENTRY = re.compile(r"([\w ]+?)\s*[:=]\s*(.*)$")
_HEIGHT = re.compile(r"(manual_)?height(\d+)$")
_DISTANCE = re.compile(r"distance(\d+)$")
_NUMBER = r"[-+]?[\d.]+"
_WORD = re.compile(rf"\s*([A-Z])\s*({_NUMBER}(?::{_NUMBER})*)(?=\s|[A-Z]|$)")
_AROUND = math.radians(15)  # largest deviation of a tower's angle from its third of the circle
_TRIM = 5.0  # largest trim of a rod [mm]; in Marlin 1.1, B was the radius of calibration


def read_klipper(path: Path | str) -> PrinterFile:
    """Read a `printer.cfg`.

    Raises:
        DataError: The message names file and line: no delta, something missing, positions that do not fit the steps, or
            a number far from the prediction of all others.
    """
    cfg = _Klipper(path)
    if ("printer", "kinematics") not in cfg.entries:
        _require_own_words(path)
    kinematics = cfg.text("printer", "kinematics")
    if kinematics == "rotary_delta":
        raise _rotary_delta(path)
    if kinematics != "delta":
        raise DataError(f"{path}: [printer] kinematics is not 'delta'; only linear deltas can be read here")
    steppers = [f"stepper_{tower}" for tower in TOWERS]
    for stepper in steppers:
        if all(section != stepper for section, _ in cfg.entries):
            raise DataError(f"{path}: no [{stepper}]{cfg.hint or '; a delta has stepper_a, stepper_b and stepper_c'}")

    def three(key: str, default: Sequence[float] = ()) -> list[float]:
        """The number of each tower; where it is missing, its default, or the number of tower a."""
        default = default or [cfg.number(steppers[0], key)] * 3
        return [cfg.number(stepper, key, each) for stepper, each in zip(steppers, default, strict=True)]

    radius = cfg.number("printer", "delta_radius")
    angles = [from_unit(angle, "deg") for angle in three("angle", [math.degrees(angle) for angle in ANGLES])]
    geometry = _geometry(path, radius, angles, three("arm_length"), three("position_endstop"))
    turns, micro, full = three("rotation_distance"), three("microsteps"), three("full_steps_per_rotation", (200.0,) * 3)
    gears = [cfg.ratio(stepper) for stepper in steppers]
    if min(*turns, *micro, *full, *gears) <= 0:
        raise DataError(f"{path}: rotation_distance, microsteps, full_steps_per_rotation must be positive")
    step = [from_unit(t, "mm") / (m * f * g) for t, m, f, g in zip(turns, micro, full, gears, strict=True)]
    printer = PrinterFile(str(path), geometry, cfg.rows(step))
    if printer.rows:
        require_steps(printer, micro)
        require_plausible(printer)
    return printer


def _rotary_delta(path: Path | str) -> DataError:
    return DataError(
        f"{path}: is a rotary delta (arms that turn); only deltas with carriages on towers can be read here. Begin with"
        " calib init --template delta, and give its lengths with --length"
    )


class _Klipper:
    """Entries of a file by section and key, each with its line."""

    def __init__(self, path: Path | str) -> None:
        self.path, self.entries = str(path), dict[tuple[str, str], tuple[str, int]]()
        section, included = "", False
        for number, line in enumerate(read_text(path, "a printer.cfg of Klipper", DataError).split("\n"), 1):
            plain = re.split(r"[#;]", line.removeprefix("#*#"))[0].strip()
            start, entry = _SECTION.match(plain), _ENTRY.match(plain)
            if start:
                section = " ".join(start[1].split()).lower()
                included |= section.startswith("include ")
            elif entry and section:
                self.entries[section, entry[1].strip().lower()] = entry[2].strip(), number
        self.hint = "; it may be in a file that is included: give one file with all of it" if included else ""

    def text(self, section: str, key: str) -> str:
        if (section, key) not in self.entries:
            raise DataError(f"{self.path}: [{section}] has no '{key}'{self.hint or '; is this the printer.cfg?'}")
        return self.entries[section, key][0]

    def number(self, section: str, key: str, default: float | None = None) -> float:
        if (section, key) not in self.entries and default is not None:
            return default
        return self._numbers(section, key, 1)[0]

    def _numbers(self, section: str, key: str, count: int) -> list[float]:
        text = self.text(section, key)
        where = f"{self.path}, line {self.entries[section, key][1]}: {key}"
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            raise DataError(f"{where} '{text:.40}' is not {'a number' if count == 1 else 'three numbers'}") from None
        if len(values) != count or not np.all(np.isfinite(values)) or np.max(np.abs(values)) > 1e8:
            raise DataError(f"{where} '{text:.40}' is not {'a number' if count == 1 else 'three numbers'}; correct it")
        return values

    def ratio(self, section: str) -> float:
        """Product of the gear ratios of a stepper."""
        if (section, "gear_ratio") not in self.entries:
            return 1.0
        text, line = self.entries[section, "gear_ratio"]
        try:
            pairs = [[float(number) for number in part.split(":")] for part in text.split(",")]
            return math.prod(driven / motor for driven, motor in pairs)
        except (ValueError, ZeroDivisionError):
            raise DataError(f"{self.path}, line {line}: gear_ratio '{text:.40}' is not a ratio such as 5:1") from None

    def rows(self, step: Sequence[float]) -> PrinterRows:
        found, calibration = list[tuple[bool, str, int, float, list[FloatArray]]](), "delta_calibrate"
        for (section, key), (text, line) in self.entries.items():
            height, distance = _HEIGHT.match(key), _DISTANCE.match(key)
            if section != calibration or not (height or distance):
                continue
            value = from_unit(self.number(section, key), "mm")
            ends = ("_pos", "_pos") if height else ("_pos1", "_pos2")
            down = [np.multiply(self._numbers(section, key + end, 3), step) for end in ends]
            if distance and value <= 0:
                raise DataError(f"{self.path}, line {line}: {key} '{text:.40}' is not a distance; correct it")
            found.append((height is None, key, line, value, down))
        if not found:
            return PrinterRows()
        is_distance, names, lines, values, places = zip(*sorted(found, key=lambda row: row[0]), strict=True)
        if all(is_distance):
            raise DataError(
                f"{self.path}: [{calibration}] has distances and no heights; probe the bed (DELTA_CALIBRATE)"
            )
        return PrinterRows(names, lines, ~np.array(is_distance), np.array(values), np.array(places))


def read_m665(path: Path | str, firmware: str) -> PrinterFile:
    """Read the lines M665 and M666 of a file of `marlin` or `duet`, and M851 of Marlin.

    Raises:
        DataError: A line is missing, or has a value that the firmware or the model does not allow.
    """
    _require_own_words(path)
    words = _settings(path)
    settings, ends = words["M665"], words["M666"]
    for key, meaning in (("L", "the length of the rods"), ("R", "the radius"), ("H", "the height")):
        if key not in settings:
            raise DataError(f"{path}: no M665 with {key}, {meaning}; save the settings (M503 prints them) into a file")

    def three(source: Mapping[str, tuple[float, ...]], keys: str) -> list[float]:
        return [source.get(key, (0.0,))[0] for key in keys]

    rods, trims, turned, up = settings["L"], three(settings, "ABC"), three(settings, "XYZ"), three(ends, "XYZ")
    height = settings["H"][0]
    if firmware == "marlin":
        _require_marlin(path, rods, trims, up)
        arms = [rods[0] + trim for trim in trims]
        height -= words["M851"].get("Z", (0.0,))[0]
        up = [-end for end in up]
    else:
        _require_duet(path, rods, ends)
        arms = [rods[0], rods[-2 % len(rods)], rods[-1]]
    angles = [angle + from_unit(turn, "deg") for angle, turn in zip(ANGLES, turned, strict=True)]
    return PrinterFile(str(path), _geometry(path, settings["R"][0], angles, arms, [height + end for end in up]))


def _geometry(
    path: Path | str, radius: float, angles: Sequence[float], arms: Sequence[float], endstops: Sequence[float]
) -> DeltaGeometry:
    """The geometry of lengths [mm] and angles [rad].

    Raises:
        InputError: Arms are too short.
        DataError: Towers are not around the centre, or switches trip below the bed.
    """
    lengths = [tuple(from_unit(value, "mm") for value in part) for part in (arms, endstops)]
    try:
        geometry = DeltaGeometry(from_unit(radius, "mm"), tuple(angles), *lengths)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    for tower, angle, expected in zip(TOWERS, geometry.angles, tower_angles(geometry.angles[2]), strict=True):
        if abs(math.remainder(angle - expected, math.tau)) > _AROUND:
            raise DataError(
                f"{path}: tower {tower} is at {quantity_text(angle, 'deg', 'g')}, and tower c at"
                f" {quantity_text(geometry.angles[2], 'deg', 'g')}; towers are 120 deg apart: correct it"
            )
    for tower, end in zip(TOWERS, geometry.endstops, strict=True):
        if end <= 0:
            raise DataError(
                f"{path}: the switch of tower {tower} would trip with the nozzle at {quantity_text(end, 'mm', 'g')},"
                " below the bed; correct it"
            )
    return geometry


def _require_own_words(path: Path | str) -> None:
    """Raise `DataError` for settings of another firmware, with the equivalent lines."""
    text = read_text(path, "a file with M665 and M666", DataError)
    if re.search(r"^\s*arm_solution\s+rotary_delta", text, re.MULTILINE):
        raise _rotary_delta(path)
    smoothie = dict(re.findall(r"^\s*(arm_length|arm_radius|gamma_max|\w+_trim)\s+([-+.\d]+)", text, re.MULTILINE))
    lines = re.findall(r"^EPR:\s*\d+\s+\d+\s+([-+.\d]+)\s+(\w+ \w+ \w+)", text, re.MULTILINE)
    repetier = {what: value for value, what in lines}
    for firmware, known, keys in (
        ("Smoothieware", smoothie, ("arm_length", "arm_radius", "gamma_max")),
        ("Repetier", repetier, ("Diagonal rod length", "Horizontal rod radius", "Z max length")),
    ):
        if keys[0] in known and "M665" not in text:
            example = " ".join(f"{letter}{known.get(key, f'<{key}>')}" for letter, key in zip("LRH", keys, strict=True))
            trims = [known.get(f"{axis}_trim", "0") for axis in ("alpha", "beta", "gamma")]
            ends = f"M666 X{trims[0]} Y{trims[1]} Z{trims[2]}"
            raise DataError(
                f"{path}: these are settings of {firmware}; write the lines 'M665 {example}' and '{ends}' into a file,"
                " and give that with --marlin (check that the numbers are those that the printer uses)"
            )


def _settings(path: Path | str) -> dict[str, dict[str, tuple[float, ...]]]:
    """The numbers of M665, M666 and M851 by their letters; the last of several lines counts."""
    words: dict[str, dict[str, tuple[float, ...]]] = {"M665": {}, "M666": {}, "M851": {}}
    for number, line in enumerate(read_text(path, "a file with M665 and M666", DataError).split("\n"), 1):
        code = line.split(";")[0].upper()
        if re.search(r"\bG20\b", code):
            raise DataError(f"{path}, line {number}: G20: lengths in inches; save the settings after G21")
        match = re.search(r"\b(M66[56]|M851)\b(.*)", code)
        if match is None:
            continue
        try:
            numbers = {key: tuple(map(float, text.split(":"))) for key, text in _WORD.findall(match[2])}
        except ValueError:
            numbers = {}
        if _WORD.sub("", match[2]).strip() or any(len(v) > 1 and key != "L" for key, v in numbers.items()):
            numbers = {}
        if not numbers:
            raise DataError(
                f"{path}, line {number}: '{code.strip():.60}' is not {match[1]} with letters and numbers; correct it"
            )
        words[match[1]].update(numbers)
    return words


def _require_marlin(path: Path | str, rods: tuple[float, ...], trims: Sequence[float], ends: Sequence[float]) -> None:
    """Raise `DataError` for numbers that Marlin does not allow [mm]."""
    if len(rods) != 1:
        raise DataError(f"{path}: M665 L has {len(rods)} rods; Marlin has one length, and A, B, C to add to it")
    for key, trim in zip("ABC", trims, strict=True):
        if abs(trim) > _TRIM:
            raise DataError(
                f"{path}: M665 {key}{trim:g} would change a rod by {trim:g} mm; correct it (remove it if it is the"
                " calibration radius, the meaning of B in Marlin 1.1)"
            )
    for key, end in zip("XYZ", ends, strict=True):
        if end > 0:
            raise DataError(f"{path}: M666 {key}{end:g} is positive, which Marlin refuses; correct it")


def _require_duet(path: Path | str, rods: tuple[float, ...], ends: Mapping[str, tuple[float, ...]]) -> None:
    """Raise `DataError` for numbers that RepRapFirmware or the model does not allow."""
    if len(rods) not in (1, 3):
        raise DataError(f"{path}: M665 L has {len(rods)} rods; give one length, or three with ':'")
    for key in "AB":
        if ends.get(key, (0.0,))[0] != 0:
            raise DataError(
                f"{path}: M666 {key}{ends[key][0]:g} tilts the bed in the firmware; set A and B to 0, and probe again:"
                " calib levels the bed by the endstops"
            )


def read_printer(path: Path | str, firmware: str) -> PrinterFile:
    """Read a printer's settings of `klipper`, `marlin` or `duet`; see `read_klipper` and `read_m665`.

    Raises:
        DataError: See these functions.
        InputError: Arms that are too short.
    """
    return read_klipper(path) if firmware == "klipper" else read_m665(path, firmware)


def printer_table(printer: PrinterFile) -> str:
    """Return the printer's rows as a file of measurements; `2` marks columns of a distance's second place."""
    rows = printer.rows

    def cells(values: FloatArray) -> list[float]:
        return [round(value, 7) for value in millimetres(values).tolist()]

    columns: list[tuple[str, Sequence[object]]] = [("pose", rows.names)]
    for copy, suffix in enumerate(("", "2")):
        columns += [(f"{tower}{suffix} [mm]", cells(rows.places[:, copy, k])) for k, tower in enumerate(TOWERS)]
    for shown, column in ((rows.is_height, "probe_height [mm]"), (~rows.is_height, "caliper_distance [mm]")):
        read = [cell if own else "" for cell, own in zip(cells(rows.values), shown, strict=True)]
        columns += [(column, read)] if np.any(shown) else []
    return format_table(
        columns, [f"from {printer.path}: distances of the carriages below their switches, and measurements there"]
    )
