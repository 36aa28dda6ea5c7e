"""The thesis' linear stages: a pose from rays in closed form, by total least squares (singular value decomposition).

Two methods, one interface: the plate's layout (k, 2) or (k, 3) m with k >= 4 (a third column, what the LEDs deviate
from the plane, is left out) and the rays (k, 2) = (x / z, y / z) of its LEDs in the camera's frame give
T_camera_plane, or None where layout or rays lie on one line, or no plane before the camera explains them. Both raise
InputError for arrays of other shapes.

Both are exact without noise and know no start. With noise their errors are 2 (0.8 m, frontal) to 70 times (2 m, 60
degrees) the Cramer-Rao bound, since they spend two further degrees of freedom on the perspective, which is hardly
visible; they give one of the plane's two tilts, and no covariance. So they are where a pose may start from, never what
is published: refine it (`planar.refine_pose`), and the other minimum as well. `python -m tests.measure.poses` shows
all three.
"""

import numpy as np

from asterism.protocol.errors import InputError
from asterism.protocol.geometry import Floats, Pose
from asterism.server.pose.planar import homography_tls

DEGENERATE = 1e-9  # relative singular values below that are zero


def pose_by_depths(layout: Floats, rays: Floats) -> Pose | None:
    """T_camera_plane from the LEDs' depths and their distances ("depth-TLS").

    Every affine dependency of the layout (sum n_i = 0, sum n_i X_i = 0) holds for the LEDs in space, so it is linear in
    their depths along the rays: the depths are the null vector of all these coplanarity relations, up to their scale.
    The scale follows from the known distances (15 of six LEDs) by least squares, the pose from the points in space.
    Source of the last step: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    layout, rays = _checked(layout, rays)
    if _on_a_line(layout) or _on_a_line(rays):
        return None
    count = len(layout)
    # Unit size: singular values then say how far the relations are from degenerate.
    size = float(np.sqrt(np.square(layout - layout.mean(axis=0)).mean()))
    flat = np.column_stack([(layout - layout.mean(axis=0)) / size, np.ones(count)])
    dependencies = np.linalg.svd(flat)[0][:, 3:]
    ray_size = float(np.sqrt(np.square(rays - rays.mean(axis=0)).mean()))
    directions = np.column_stack([(rays - rays.mean(axis=0)) / ray_size, np.ones(count)])
    relations = np.einsum("ij,ik->jki", dependencies, directions).reshape(-1, count)
    _, lengths, axes = np.linalg.svd(relations)
    if lengths[count - 2] < DEGENERATE * lengths[0]:
        return None
    depths = axes[-1] * np.sign(axes[-1].sum())
    if not (depths > 0.0).all():
        return None
    points = depths[:, None] * np.column_stack([rays, np.ones(count)])
    first, second = np.triu_indices(count, 1)
    found = np.linalg.norm(points[first] - points[second], axis=1)
    known = np.linalg.norm(layout[first] - layout[second], axis=1)
    points *= (found @ known) / (found @ found)
    middle, flat_middle = points.mean(axis=0), layout.mean(axis=0)
    in_plane = np.column_stack([layout - flat_middle, np.zeros(count)])
    u, _, vt = np.linalg.svd(in_plane.T @ (points - middle))
    turn = vt.T @ np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    return Pose.from_matrix(turn, middle - turn[:, :2] @ flat_middle)


def pose_by_homography(layout: Floats, rays: Floats) -> Pose | None:
    """T_camera_plane from the homography between plate and rays ("DLT-TLS").

    The homography is the last right singular vector of the direct linear transformation; its first two columns are
    the rotation's, up to one scale, brought to the nearest pair of perpendicular unit vectors, its third is the
    translation.
    Source: Hartley and Zisserman, "Multiple View Geometry", 4.1 and 8.1; Zhang, "A flexible new technique for camera
    calibration", 2000, 3.1.
    """
    layout, rays = _checked(layout, rays)
    if _on_a_line(layout) or _on_a_line(rays):
        return None
    middle = layout.mean(axis=0)
    homography = np.empty((3, 3))
    centred = np.column_stack([layout - middle, np.zeros(len(layout))])
    if not homography_tls(centred, np.ascontiguousarray(rays), homography):
        return None
    u, lengths, vt = np.linalg.svd(homography[:, :2], full_matrices=False)
    if lengths[1] < DEGENERATE * lengths[0]:
        return None
    # homography[2, 2] is 1: the plate's middle lies before the camera.
    columns = u @ vt
    turn = np.column_stack([columns, np.cross(columns[:, 0], columns[:, 1])])
    t = homography[:, 2] * (2.0 / lengths.sum())
    return Pose.from_matrix(turn, t - columns @ middle)


def _checked(layout: Floats, rays: Floats) -> tuple[Floats, Floats]:
    layout, rays = np.asarray(layout, np.float64), np.asarray(rays, np.float64)
    if layout.ndim != 2 or layout.shape[1] not in (2, 3) or len(layout) < 4 or rays.shape != (len(layout), 2):
        raise InputError(
            f"a layout of shape {layout.shape} with rays of shape {rays.shape}, "
            "expected (k, 2) or (k, 3) m and (k, 2), four points or more"
        )
    return layout[:, :2], rays


def _on_a_line(points: Floats) -> bool:
    lengths = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return not lengths[1] > DEGENERATE * lengths[0]
