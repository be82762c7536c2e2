"""The target workspace: its shape, its reachability, and what its positions can show."""

import numpy as np
import pytest

from medrue.closed_form import ACTUATED_JOINTS, five_bar, forward, name_parameters, singularity_sines
from medrue.closed_form_inverse import inverse
from medrue.paper_tables import PARAMETERS, table1
from medrue.workspace import HOME, target_workspace

STROKE = 0.7


def slopes(outputs):
    """Derivative of closed-form outputs by the 36 parameters, in units of 2 mm and 1.5 deg, by differences, (n, 36)."""
    nominal, step, columns = table1().nominal, 1e-4, []
    for direction in np.eye(len(PARAMETERS)) * step:  # central ones, of fourth order
        near, far = (outputs(nominal + k * direction) - outputs(nominal - k * direction) for k in (1, 2))
        columns.append(((8.0 * near - far) / (12.0 * step)).ravel())
    return np.stack(columns, axis=1) * table1().reach


def scaled_jacobian():
    """d p_world_tool / d parameters, (420, 3, 36), columns of unit length; those of only rounding stay zero."""
    J = slopes(lambda parameters: forward(target_workspace().q, parameters).p_world_tool)
    norms = np.linalg.norm(J, axis=0)
    return (J / np.where(norms < 1e-10, np.inf, norms)).reshape(420, 3, 36)


def test_positions_lie_on_the_half_cylinder():
    workspace = target_workspace()
    offset = workspace.T_world_tool[:, :3, 3] - workspace.p_axis
    along = offset @ workspace.axis
    radial = offset - along[:, None] * workspace.axis
    assert workspace.T_world_tool.shape == (420, 4, 4)
    assert np.abs(np.linalg.norm(radial, axis=1) - 0.150).max() < 1e-15
    assert along.min() > 0.0
    assert along.max() < 0.700
    assert (radial @ workspace.middle > 0.0).all()


def test_positions_are_spread_uniformly():
    """Each cell of a 15 by 28 division of the surface holds one position."""
    workspace = target_workspace()
    offset = workspace.T_world_tool[:, :3, 3] - workspace.p_axis
    angle = np.arctan2(np.cross(workspace.middle, offset) @ workspace.axis, offset @ workspace.middle)
    cells = {(int(a), int(x)) for a, x in zip((angle / np.pi + 0.5) * 15, offset[:, 0] / 0.7 * 28, strict=True)}
    assert len(cells) == 420


def test_the_probe_points_at_the_axis():
    """The line from the tool along z_6 meets the leg's axis ahead of the tool."""
    workspace = target_workspace()
    p, z = workspace.T_world_tool[:, :3, 3] - workspace.p_axis, workspace.T_world_tool[:, :3, 2]
    across_p, across_z = p[:, 1:], z[:, 1:]
    miss = (across_p[:, 0] * across_z[:, 1] - across_p[:, 1] * across_z[:, 0]) / np.linalg.norm(across_z, axis=1)
    assert np.abs(miss).max() < 1e-15
    assert ((across_p * across_z).sum(axis=1) < 0.0).all()


def test_poses_are_rigid_and_the_joints_reach_them():
    workspace = target_workspace()
    R = workspace.T_world_tool[:, :3, :3]
    assert np.abs(R @ np.transpose(R, (0, 2, 1)) - np.eye(3)).max() < 1e-14
    assert np.abs(forward(workspace.q, table1().nominal).T_world_tool - workspace.T_world_tool).max() < 1e-13


def test_q1_stays_inside_the_stroke():
    q1 = target_workspace().q[:, 0]
    assert q1.min() > 0.036
    assert q1.max() < 0.667


def test_poses_keep_away_from_singular_ones():
    assert singularity_sines(target_workspace().q, table1().nominal).min() > 0.64


def test_links_stay_outside_the_leg():
    workspace = target_workspace()
    named = name_parameters(table1().nominal, 420)
    p = dict(zip(PARAMETERS, table1().nominal, strict=True))
    leg = workspace.p_axis[1] - p["yb"] + 1j * (workspace.p_axis[2] - p["zb"])
    for i in (1, 2):
        bar = five_bar(i, workspace.q, named)
        for start, end in ((bar.A, bar.B), (bar.B, bar.E), (bar.C, bar.D), (bar.D, bar.E)):
            fraction = np.clip((np.conj(end - start) * (leg - start)).real / np.abs(end - start) ** 2, 0.0, 1.0)
            assert np.abs(start + fraction * (end - start) - leg).min() > 0.166


@pytest.mark.quick(0)
def test_poses_stay_reachable_with_parameter_errors():
    """300 robots within 2 mm and 1.5 degrees, half of them at corners: same modes, inside the stroke."""
    generator = np.random.default_rng(44)
    workspace, table = target_workspace(), table1()
    for draw in range(300):
        errors = generator.uniform(-1.0, 1.0, len(PARAMETERS))
        parameters = table.nominal + (np.sign(errors) if draw % 2 else errors) * table.reach
        closed = forward(workspace.q, parameters)
        assert closed.closes.all()
        assert (np.sign(closed.passive[:, :4]) == (1, -1, 1, -1)).all()
        assert singularity_sines(workspace.q, parameters).min() > 0.58
        q = inverse(workspace.T_world_tool, parameters)
        assert np.isfinite(q).all()
        assert q[:, 0].min() > 0.0
        assert q[:, 0].max() < STROKE


@pytest.mark.parametrize("every", [1, 5])
def test_positions_identify_28_of_36_parameters(every):
    values = np.linalg.svd(scaled_jacobian()[::every].reshape(-1, 36), compute_uv=False)
    assert values[27] / values[0] > 1e-3
    assert values[28] / values[0] < 1e-9  # rounding of the differences


def test_the_papers_28_parameters_are_well_conditioned():
    kept = [index for index, name in enumerate(PARAMETERS) if name not in table1().redundant]
    assert np.linalg.cond(scaled_jacobian().reshape(-1, 36)[:, kept]) < 1300.0


def test_home_is_in_the_middle_of_the_workspace():
    workspace = target_workspace()
    q = np.array([[HOME[name] for name in ACTUATED_JOINTS]])
    tool = forward(q, table1().nominal).p_world_tool[0]
    middle = workspace.p_axis + 0.35 * workspace.axis + 0.15 * workspace.middle
    assert np.linalg.norm(tool - middle) < 0.002
    assert (workspace.q.min(axis=0) < q[0]).all()
    assert (q[0] < workspace.q.max(axis=0)).all()


def test_the_workspace_is_the_same_every_time_and_read_only():
    assert target_workspace() is target_workspace()
    assert not target_workspace().q.flags.writeable
    assert not target_workspace().T_world_tool.flags.writeable
