"""What several tests need: random poses, comparisons that know what a pose is, numeric Jacobians, the sample frames."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from asterism.protocol.geometry import Floats, Pose, angle_between, exp_rotation

REPOSITORY = Path(__file__).parent.parent
SHARED = REPOSITORY.parent / "shared"


def random_rotation(rng: np.random.Generator, angle_rad: float | None = None) -> Floats:
    """A rotation (3, 3): uniform over all, or by exactly ``angle_rad`` about a random axis."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    if angle_rad is not None:
        return exp_rotation(axis * angle_rad)
    quat = rng.normal(size=4)
    return Pose(np.zeros(3), quat / np.linalg.norm(quat)).rotation


def random_pose(rng: np.random.Generator, size: float = 1.0) -> Pose:
    """A pose with any orientation and a position of about ``size`` m."""
    return Pose.from_matrix(random_rotation(rng), size * rng.normal(size=3))


def facing_pose(
    rng: np.random.Generator, depth_m: tuple[float, float] = (0.8, 2.0), tilt_deg: tuple[float, float] = (0.0, 45.0)
) -> Pose:
    """T_camera_plane of a plate in view that turns its +z to the camera, tilted against the line of sight."""
    depth = rng.uniform(*depth_m)
    position = depth * np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.25, 0.25), 1.0])
    sight = position / np.linalg.norm(position)
    across = np.cross(sight, rng.normal(size=3))
    across /= np.linalg.norm(across)
    normal = exp_rotation(across * np.radians(rng.uniform(*tilt_deg))) @ -sight
    x = np.cross(normal, rng.normal(size=3))
    x /= np.linalg.norm(x)
    return Pose.from_matrix(np.column_stack([x, np.cross(normal, x), normal]), position)


def conic_centres(T_camera_plane: Pose, points: Floats, radius: float) -> Floats:
    """Centres (n, 2), ideal rays, of the images of discs in the plane: project the outline's conic, take its centre."""
    centres = []
    for point in T_camera_plane.map(points):
        plane_to_rays = np.column_stack([T_camera_plane.rotation[:, :2], point])
        back = np.linalg.inv(plane_to_rays)
        conic = back.T @ np.diag([1.0, 1.0, -(radius**2)]) @ back
        centres.append(np.linalg.solve(conic[:2, :2], -conic[:2, 2]))
    return np.array(centres)


def assert_poses_close(a: Pose, b: Pose, position_m: float = 1e-9, rotation_rad: float = 1e-7) -> None:
    """Compare by distance and by the angle of the relative rotation, never by components."""
    away = float(np.linalg.norm(a.position - b.position))
    turned = angle_between(a.rotation, b.rotation)
    assert away <= position_m, f"{away} m apart, allowed {position_m}"
    assert turned <= rotation_rad, f"{turned} rad apart, allowed {rotation_rad}"


def numeric_jacobian(function: Callable[[Floats], Floats], at: Floats, step: float = 1e-6) -> Floats:
    """Derivative (outputs, inputs) of a function of a vector, by central differences."""
    columns = []
    for k in range(len(at)):
        up, down = at.copy(), at.copy()
        up[k] += step
        down[k] -= step
        columns.append((function(up) - function(down)) / (2 * step))
    return np.stack(columns, axis=-1)


def shared(*parts: str) -> Path:
    """A path in the team's shared folder; the test is skipped where that is absent."""
    path = SHARED.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{path} is not there: the shared folder exists only at the team's workplace")
    return path
