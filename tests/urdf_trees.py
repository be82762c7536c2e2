"""URDF trees for tests: from a list of joints, or random ones with everything that URDF allows."""

import numpy as np

import calib


def urdf_of(*joints, links=()):
    """A URDF from (name, type, parent, child, extra XML) of its joints."""
    names = dict.fromkeys([*links, *(joint[2] for joint in joints), *(joint[3] for joint in joints)])
    text = [f'<link name="{name}"/>' for name in names]
    for name, kind, parent, child, *extra in joints:
        limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>' if kind in ("revolute", "prismatic") else ""
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        text.append(f'<joint name="{name}" type="{kind}">{ends}{limit}{"".join(extra)}</joint>')
    return '<robot name="test">' + "\n".join(text) + "</robot>"


def plain(folder, *joints, **options):
    path = folder / "plain.urdf"
    path.write_text(urdf_of(*joints, **options))
    return calib.load(path)


def random_tree(generator, n_links):
    """A URDF tree with every joint type that moves, limits, odd axes, mimics, and pitch angles of 90 degrees."""
    joints, leaders = [], []
    for k in range(1, n_links):
        kind = str(generator.choice(["revolute", "continuous", "prismatic", "fixed"], p=[0.4, 0.15, 0.25, 0.2]))
        rpy = generator.uniform(-4, 4, 3)
        rpy[1] = generator.choice([rpy[1], np.pi / 2, -np.pi / 2, 0.0])
        extra = '<origin xyz="{} {} {}" rpy="{} {} {}"/>'.format(*generator.uniform(-1, 1, 3), *rpy)
        axis = generator.normal(size=3)
        axis /= np.linalg.norm(axis)
        extra += '<axis xyz="{} {} {}"/>'.format(*axis) if generator.random() < 0.8 else ""
        if leaders and kind != "fixed" and generator.random() < 0.2:
            extra += '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(
                generator.choice(leaders), *generator.normal(size=2)
            )
        elif kind != "fixed":
            leaders.append(f"j{k}")
        joints.append((f"j{k}", kind, f"l{generator.integers(k)}", f"l{k}", extra))
    order = generator.permutation(len(joints))
    return urdf_of(*(joints[k] for k in order), links=["l0"]), leaders


def described(path, actuated, base, target):
    """Load a URDF with these joints actuated and every origin on the way to the target free."""
    yaml = path.with_suffix(".yaml")
    yaml.write_text(
        f"urdf: {path}\nname_mot: {list(actuated)}\nbase: {{frame: '{base}'}}\n"
        f"targets: {{point: {{frame: '{target}'}}}}\nparametrisation:\n"
        "  - {origin: all, components: [x, y, z], sigma: 2 mm}\n"
        "  - {origin: all, components: [rx, ry, rz], sigma: 5 mrad}\n"
    )
    return calib.load(yaml)
