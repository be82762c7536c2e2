"""Real robots measured by others: how their files are read here, and the figures of docs/benchmarks.md.

    python -m tests.public_data FOLDER [ur10_tracker] [motoman_right] [mukca] [--page docs/benchmarks.md]

FOLDER holds a folder for each: ur10_tracker (robot.urdf, grid.csv with a column `use`), motoman_right (robot.urdf,
train.csv, test.csv, camera), mukca (urdf, panda_1, kuka_14). None is part of the project; docs/comparison.md says where
they come from. Errors are of rows that the fit never saw. All together take about ten minutes.
"""

import argparse
import csv
import shutil
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import yaml
import yourdfpy
from scipy.optimize import least_squares

import calib
from calib.core.data.tables import read_table
from calib.core.rows.registration import register
from tests.project import EXAMPLES

ORIGINS = """\
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 3 mrad}
"""
ARMS = {
    "panda_1": ("panda.urdf", "panda_joint", "panda_link0", "panda_hand_tcp"),
    "kuka_14": ("iiwa14.urdf", "joint_a", "base_link", "tool0"),
}
BY_HAND = ("compliance", "compliance,bending", "gain,compliance", "gain,compliance,bending")
EXAMPLE_ROBOTS = Path(sys.prefix, "lib", f"python3.{sys.version_info.minor}", "site-packages", "cmeel.prefix", "share",
                      "example-robot-data", "robots")  # fmt: skip
_POINT = """\
<inertial>
  <origin xyz="{x} {y} {z}"/> <mass value="{mass}"/> <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>
</inertial>"""
PLACES = {"panda_1": ("front", "right", "back-high"), "kuka_14": ("front", "left_back", "raised_left")}


def described(urdf, description):
    """The robot of a description whose URDF lies elsewhere."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(urdf, Path(folder) / "robot.urdf")
        (Path(folder) / "robot.yaml").write_text(description)
        return calib.load(Path(folder) / "robot.yaml")


def _write(path, rows):
    with path.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(rows)


def ur10_tracker(folder, full_poses=False, flange="flange"):
    """The UR10, all its rows, and what each row is for; of a URDF that names the sensor's link so."""
    description = yaml.safe_load((EXAMPLES / "ur10_tracker.yaml").read_text())
    description["targets"]["sensor"]["frame"] = flange
    if full_poses:
        description["targets"] = {"sensor": {"frame": "flange", "position": "unknown", "orientation": "unknown"}}
        description["instruments"] = {"sensor": {"kind": "pose", "rotation": "intrinsic_xyz"}}
        description["columns"] |= {name: f"sensor_{name}" for name in ("rx", "ry", "rz")}
    robot = described(folder / "robot.urdf", yaml.safe_dump(description))
    table = read_table(folder / "grid.csv")
    use = np.array([row[table.names.index("use")] for row in table.rows])
    return robot, calib.read_measurements(folder / "grid.csv", robot), use


def motoman(folder, *edits):
    """The Motoman, with edits (old, new) of its description, and its readings for training and for testing."""
    text = (EXAMPLES / "motoman_right.yaml").read_text()
    for old, new in edits:
        text = text.replace(old, new)
    robot = described(folder / "robot.urdf", text)
    return robot, *(calib.read_measurements(folder / f"{name}.csv", robot) for name in ("train", "test"))


def motoman_cameras(folder, tracker, turned):
    """The Motoman, its readings for training and for testing, by two cameras and, if `tracker`, by the tracker.

    With `turned`, pixels are in the image as the intrinsics have it, a quarter turn from the files.
    """
    poses, pixels, cameras = (
        list(csv.DictReader((folder / "camera" / f"{name}.csv").read_text().splitlines()))
        for name in ("poses", "pixels", "cameras")
    )
    with tempfile.TemporaryDirectory() as scratch:
        together = Path(scratch)
        markers = (folder / "camera" / "markers.csv").read_text().replace("marker,", "point,", 1)
        (together / "markers.csv").write_text(markers)
        shutil.copy(folder / "robot.urdf", together)
        (together / "robot.yaml").write_text(_motoman_yaml(cameras, tracker))
        robot = calib.load(together / "robot.yaml")
        measured = ["x [m]", "y [m]", "z [m]"] if tracker else []
        data = []
        for use in ("train", "test"):
            some = [row for row in poses if row["use"] == use]
            keys = ["pose", *(f"{joint} [rad]" for joint in "ESLURBT")]
            head = [*keys, *(f"ball_{column}" for column in measured)]
            _write(together / "joints.csv", [head, *([row[key] for key in [*keys, *measured]] for row in some)])
            names = {row["pose"] for row in some}
            seen = [row for row in pixels if row["pose"] in names]
            places = [(float(row["u [px]"]), float(row["v [px]"])) for row in seen]
            places = [(v, 5999 - u) if turned else (u, v) for u, v in places]
            rows = [
                [row["pose"], row["camera"], row["marker"], f"{u}", f"{v}"]
                for row, (u, v) in zip(seen, places, strict=True)
            ]
            _write(together / "pixels.csv", [["pose", "camera", "marker", "u", "v"], *rows])
            data.append(calib.read_measurements([together / "joints.csv", together / "pixels.csv"], robot))
    return robot, *data


def _motoman_yaml(cameras, tracker):
    text = "urdf: robot.urdf\nname_mot: [E, S, L, U, R, B, T]\n"
    text += f"base: {{frame: l0, pose: {'unknown' if tracker else 'known'}}}\ntargets:\n"
    text += "  body: {frame: flange, position: unknown, orientation: unknown}\n"
    text += "  ball: {frame: flange, xyz: [0.045, 0, 0.245], position: unknown}\n" if tracker else ""
    text += "instruments:\n" + ("  ball: {kind: position}\n" if tracker else "")
    for row in cameras:
        numbers = ", ".join(f"{key.partition(' ')[0]}: {value}" for key, value in row.items() if key != "camera")
        text += f"  {row['camera']}: {{kind: pixel, target: body, camera: {{frame: l0}}, columns: pixel,"
        text += f" intrinsics: {{{numbers}}}, points_file: markers.csv}}\n"
    return text + "columns: {u: pixel_u, v: pixel_v, marker: point}\n" + ORIGINS


def masses_of(arm):
    """A URDF of the same arm with masses, which need not be there: of example-robot-data, or of PyBullet."""
    packages = EXAMPLE_ROBOTS.parents[3]
    bullet = packages / "pybullet_data" / "kuka_iiwa" / "model.urdf"
    return EXAMPLE_ROBOTS / "panda_description" / "urdf" / "panda.urdf" if arm == "panda_1" else bullet


def mukca(folder, arm, places, masses=None):
    """An arm with a ball near its flange, and what it read in two sockets 50 mm apart, put up anew in each place.

    Its links weigh what they weigh in the URDF `masses`, if there is one.
    """
    urdf, joint, base, flange = ARMS[arm]
    setups = ", ".join(f"{place}: [{'tool_artefact' if k else ''}]" for k, place in enumerate(places))
    text = f"urdf: robot.urdf\nname_mot: [{', '.join(f'{joint}{k}' for k in range(1, 8))}]\n"
    text += f"base: {{frame: {base}}}\ntargets:\n"
    text += f"  ball: {{frame: {flange}, xyz: [0, 0, 35 mm], position: unknown, sigma: 10 mm}}\n"
    text += "instruments:\n  tool:\n    kind: touch\n    target: ball\n    artefact:\n"
    text += f"      frame: {base}\n      pose: unknown\n      points: {{hole_0: [0, 0, 0], hole_1: [50 mm, 0, 0]}}\n"
    with tempfile.TemporaryDirectory() as name:
        weighed = Path(name) / "robot.urdf"
        weighed.write_bytes(_weighed(folder / "urdf" / urdf, masses))
        robot = described(weighed, f"{text}setups: {{{setups}}}\n{ORIGINS}")
    rows = [["setup", *(f"{name} [rad]" for name in robot.joint_names), "tool"]]
    for place in places:
        for k, holes in enumerate(mukca_joints(folder, arm, place)):
            rows += [[place, *(repr(float(value)) for value in q), f"hole_{k}"] for q in holes]
    with tempfile.TemporaryDirectory() as name:
        _write(Path(name) / "data.csv", rows)
        return robot, calib.read_measurements(Path(name) / "data.csv", robot)


def _weighed(urdf, masses):
    """The bytes of a URDF, with the masses of another one where they lie when all joints are zero."""
    robot = ElementTree.parse(urdf).getroot()
    if masses is not None:
        ours, theirs = (yourdfpy.URDF.load(str(path), load_meshes=False) for path in (urdf, masses))
        for weight in theirs.robot.links:
            link = robot.find(f"link[@name='{weight.name.removeprefix('lbr_iiwa_')}']")
            if weight.inertial is not None and link is not None:
                moved = np.linalg.inv(ours.get_transform(link.get("name"))) @ theirs.get_transform(weight.name)
                x, y, z, _ = moved @ weight.inertial.origin[:, 3]
                link.append(ElementTree.fromstring(_POINT.format(x=x, y=y, z=z, mass=weight.inertial.mass)))
    return ElementTree.tostring(robot)


def mukca_joints(folder, arm, place):
    """Joints in the first and in the second socket, (n, 7) each [rad]."""
    return [np.loadtxt(folder / arm / place / f"hole_{k}.csv", delimiter=",") for k in (0, 1)]


def off_two_points(points, which, spacing):
    """Distances (n,) of points (n, 3) from two points so far apart, laid through them; which (n,): 0 or 1 [m]."""

    def misses(x):
        line = np.array([np.cos(x[3]) * np.cos(x[4]), np.sin(x[3]) * np.cos(x[4]), np.sin(x[4])])
        return 1e3 * (points - x[:3] - (which[:, None] - 0.5) * spacing * line)

    first, second = (points[which == k].mean(axis=0) for k in (0, 1))
    line = (second - first) / np.linalg.norm(second - first)
    start = [*(first + second) / 2, np.arctan2(line[1], line[0]), np.arcsin(line[2])]
    return 1e-3 * np.linalg.norm(misses(least_squares(lambda x: misses(x).ravel(), start).x), axis=1)


def from_sockets(robot, holes):
    """Mean distance of predicted balls from two points 50 mm apart that are laid through them [mm]."""
    balls, which = robot.positions(np.vstack(holes))[:, 0], np.repeat([0, 1], [len(q) for q in holes])
    return 1e3 * float(np.mean(off_two_points(balls, which, 0.05)))


def from_means(robot, holes):
    """Mean distance of predicted balls from the mean of those in the same socket [mm]."""
    balls = [robot.positions(q)[:, 0] for q in holes]
    return 1e3 * float(np.mean(np.concatenate([np.linalg.norm(b - b.mean(axis=0), axis=1) for b in balls])))


def held_out(fit, state="after"):
    """Root mean square errors of held-out positions [mm] and, if there are any, of orientations [mrad]."""
    parts = [fit.validation.errors(state, part) for part in ("position", "orientation")]
    return [round(1e3 * float(np.sqrt(np.mean(np.sum(part**2, axis=1)))), 4) for part in parts if len(part)]


def markdown(head, rows, words=1):
    """A table as the pages have it: the first columns are words, the others are numbers."""
    lines = [f"| {' | '.join(str(cell) for cell in line)} |" for line in (head, *rows)]
    return "\n".join([lines[0], f"|{'---|' * words}{'---:|' * (len(head) - words)}", *lines[1:]])


def written(page, name, text):
    """Write text into a page, between the marks of that name."""
    marks = [f"<!-- {word} {name} -->" for word in ("begin", "end")]
    before, begin, rest = page.read_text(encoding="utf-8").partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if not (begin and end):
        raise SystemExit(f"{page} has no place for {name}: {' ... '.join(marks)}")
    page.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}", encoding="utf-8")


def of_folder(about, page):
    """The command line of a program that fits what FOLDER holds, and writes its table into a page."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path)
    parser.add_argument("--only", default="", metavar="WORDS", help="rows whose names contain them")
    parser.add_argument("--page", action="store_true", help=f"write the table into docs/{page.name}")
    return parser


def added(fit):
    """The kinds of terms that `auto` added, in words."""
    return ", ".join(term.term.replace("+", " or ") for term in fit.terms.trials if term.added) or "nothing"


def tables_ur10_tracker(folder):
    """The tables of the UR10."""
    rows = []
    for full_poses in (False, True):
        robot, data, use = ur10_tracker(folder, full_poses)
        what, test = "poses" if full_poses else "positions", data[use == "test"]
        for terms, words in ((None, "all origins"), ("curve", "origins and a curve for each joint"), ("auto", "")):
            fit = calib.fit(robot, data[use == "train"], validation=test, terms=terms)
            if terms is None:
                rows.append([f"only base and sensor placed, by {what}", *_errors(fit, "before")])
            rows.append([f"{words or f'`--terms auto`: {added(fit)}'}, {what}", *_errors(fit)])
    models = markdown(["model, fitted to", "position RMS [mm]", "orientation RMS [mrad]"], rows)
    robot, data, use = ur10_tracker(folder)
    rows = []
    for n in (50, 100, 200, 300, 1000):
        kinds = [
            sorted(_drawn(robot, data, use == "test", n, terms, seed) for seed in range(5)) for terms in (None, "curve")
        ]
        rows.append([n, *(f"{five[2]:.3f} ({five[0]:.3f} to {five[-1]:.3f})" for five in kinds)])
    return f"{models}\n\n{markdown(['poses to fit', 'origins [mm]', 'origins and curves [mm]'], rows)}"


def _errors(fit, state="after"):
    errors = held_out(fit, state)
    return [f"{errors[0]:.3f}", *(f"{angle:.3f}" for angle in errors[1:])] + [""] * (2 - len(errors))


def _drawn(robot, data, test, n, terms, seed):
    """Error of a fit to n random rows that are not for testing, on those that are."""
    used = np.random.default_rng(seed).permutation(np.flatnonzero(~test))[:n]
    return held_out(calib.fit(robot, data[np.sort(used)], validation=data[test], terms=terms))[0]


def tables_motoman_right(folder):
    """The table of the Motoman."""
    arm, *by_tracker = motoman(folder)
    rows = []
    for terms in (None, "auto"):
        fit = calib.fit(arm, by_tracker[0], validation=by_tracker[1], terms=terms)
        if terms is None:
            rows.append(["only base and reflector placed", f"{held_out(fit, 'before')[0]:.3f}", ""])
        words = f"tracker, `--terms auto`: {added(fit)}" if terms else "tracker"
        rows.append([words, f"{held_out(fit)[0]:.3f}", fit.verdict.grade])
    for tracker, turned in ((True, False), (True, True), (False, False), (False, True)):
        robot, train, test = motoman_cameras(folder, tracker, turned)
        fit = calib.fit(robot, train, validation=test if tracker else None)
        error = held_out(fit)[0] if tracker else _placed_error(fit, arm, by_tracker[1])
        words = (
            f"{'tracker and pixels' if tracker else 'pixels alone'}, {'turned back' if turned else 'as in the files'}"
        )
        rows.append([words, f"{error:.3f}", fit.verdict.grade])
    return markdown(["fitted to", "RMS, 53 poses by the tracker [mm]", "verdict"], rows)


def _placed_error(fit, arm, data):
    """Root mean square error of an arm with origins that were found, its base and target placed by the data [mm]."""
    values = {p.name: value for p, value in zip(fit.robot.parameters, fit.robot.values, strict=True)}
    own = {p.name: values[p.name] for p in arm.parameters if not p.placement}
    errors = register(arm.with_parameters(own), data).positions(data.joints) - data.points(arm)
    return round(1e3 * float(np.sqrt(np.mean(np.sum(errors**2, axis=-1)))), 4)


def tables_mukca(folder):
    """The tables of the arms that touched two sockets; needs the packages that know their masses."""
    if absent := [str(masses_of(arm)) for arm in PLACES if not masses_of(arm).is_file()]:
        raise SystemExit(f"mukca needs masses that are not there: {', '.join(absent)} (make ci-packages)")
    rows = []
    for arm, name in (("panda_1", "Panda"), ("kuka_14", "KUKA")):
        for held in PLACES[arm]:
            both, holes = tuple(place for place in PLACES[arm] if place != held), mukca_joints(folder, arm, held)
            origins, light = (_fitted(folder, arm, both, None, terms) for terms in (None, "auto"))
            *by_hand, heavy = (_fitted(folder, arm, both, masses_of(arm), terms) for terms in (*BY_HAND, "auto"))
            robots = [origins.placed, *(fit.robot for fit in (origins, *by_hand, light, heavy))]
            cells = [f"{from_sockets(robot, holes):.3f}" for robot in robots]
            rows.append(
                [
                    f"{name}, {held}",
                    *cells[:-2],
                    *(f"{cell} ({added(fit)})" for cell, fit in zip(cells[-2:], (light, heavy), strict=True)),
                ]
            )
    head = ["unseen place [mm]", "before", "origins", *(terms.replace(",", ", ") for terms in BY_HAND)]
    table = markdown([*head, "`auto`, masses unknown", "`auto`"], rows)
    front, others = PLACES["panda_1"][0], PLACES["panda_1"][1:]
    rows = [["the authors", "0.168", "0.347"]]
    for terms, words in ((None, "origins"), ("compliance,bending", "compliance, bending"), ("auto", "`auto`")):
        fit = _fitted(folder, "panda_1", (front,), masses_of("panda_1"), terms)
        own, *means = (f"{from_means(fit.robot, mukca_joints(folder, 'panda_1', at)):.3f}" for at in (front, *others))
        rows.append([f"{words}{f': {added(fit)}' if terms == 'auto' else ''}", own, " and ".join(means)])
    return f"{table}\n\n{markdown(['distance from the mean [mm]', f'{front} (fitted)', ' and '.join(others)], rows)}"


def _fitted(folder, arm, places, masses, terms):
    return calib.fit(*mukca(folder, arm, places, masses), terms=terms)


if __name__ == "__main__":
    tables = {name.removeprefix("tables_"): made for name, made in globals().items() if name.startswith("tables_")}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", metavar="FOLDER", type=Path)
    parser.add_argument("robots", metavar="ROBOT", nargs="*", help=f"of {', '.join(tables)}; all if none are named")
    parser.add_argument("--page", metavar="FILE", type=Path, help="the page to write the tables into")
    options = parser.parse_args()
    for name in options.robots or tables:
        if name not in tables:
            parser.error(f"no robot {name}; there are {', '.join(tables)}")
        made = tables[name](options.folder / name)
        print(f"{name}\n\n{made}\n", flush=True)
        if options.page is not None:
            written(options.page, name, made)
