"""Chang 2021, Eqs. (1)-(13), written out in NumPy for many states at once.

Every number is typed again from the paper's tables and from the assumptions that complete them. Neither the
package nor its URDF is read. Arrays have the state as leading axis; vectors are in the link's own frame.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

# Table 1, modified (Craig) convention: row i leads from frame i-1 to frame i.
ALPHA = np.deg2rad([0, -90, 0, 0, 90, -90, 90])
A = np.array([0, 0.83, 1.00, 0.78, 0, 0, 0])
D = np.array([0, 0, 0, 0, 0.87, 0, 0])
# Table 2.
MASS = np.array([7.8, 7.4, 7.7, 4.9, 3.7, 2.5, 3.62])
# Table 2: Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass. Links 3 and 4 of the table are no possible
# rigid bodies; these are the nearest ones.
INERTIA = np.array(
    [
        [0.02, 0.32, 0.32, 0, -0.01, 0],
        [0.04, 0.46, 0.45, -0.01, 0.06, 0],
        [0.06668, 0.56731, 0.58335, 0.01087, 0.11697, -0.00060],
        [0.04910, 0.03122, 0.03122, -0.00910, 0.00910, 0.00033],
        [0.25, 0.25, 0.01, 0, 0.01, 0.01],
        [0.01, 0.01, 0.003, 0, 0, 0.001],
        [0.03, 0.09, 0.07, -0.01, 0.01, 0],
    ]
)
# Assumptions: the paper gives no centres of mass, no place of the arm on the guardrail, no tool length.
CENTRE_OF_MASS = np.array(
    [[0.415, 0, 0], [0.5, 0, 0], [0.39, 0, 0], [0, -0.10, 0], [0, 0, -0.435], [0, 0, 0], [0, 0, 0.10]]
)
R_W1 = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])  # Rx(180 deg): the arm hangs
P_W1 = np.array([0, 0.5, 0])
TOOL = np.array([0, 0, 0.30])
GRAVITY = np.array([0, 0, -9.81])
Z0 = np.array([0.0, 0, 1])


def frames(q: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Rotations R^{i}_{i+1} (N, 3, 3) and positions p^{i}_{i+1,i} (3,) of each frame in the one before.

    Frame 0 is O0 on the guardrail; the arm's base is turned and moved from there before joint 1.
    """
    rotations, positions = [], []
    for i in range(7):
        c, s, ca, sa = np.cos(q[:, i]), np.sin(q[:, i]), np.cos(ALPHA[i]), np.sin(ALPHA[i])
        zero = np.zeros_like(c)
        rows = [[c, -s, zero], [s * ca, c * ca, zero - sa], [s * sa, c * sa, zero + ca]]  # Eq. (1)
        R = np.moveaxis(np.array(rows), 2, 0)
        p = np.array([A[i], -sa * D[i], ca * D[i]])  # Eq. (2)
        rotations.append(R_W1 @ R if i == 0 else R)
        positions.append(P_W1 + R_W1 @ p if i == 0 else p)
    return rotations, positions


def tool_pose(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points (N, 3), m, and orientations (N, 3, 3) in O0: Eq. (3)."""
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    for R_step, p_step in zip(*frames(q), strict=True):
        p = p + R @ p_step
        R = R @ R_step
    return p + R @ TOOL, R


def efforts(
    q: FloatArray, v: FloatArray, a: FloatArray, base_acceleration: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Joint torques tau (N, 7), Nm; torque n_0 (N, 3), Nm, and force f_0 (N, 3), N.

    n_0 and f_0 are what the guardrail exerts on the arm, about and in O0. Where the arm's base is accelerated
    in W, by (N, 3) or (3,), m/s2, it does not turn, and O0 moves with it.
    """
    R, p = frames(q)
    w, g = np.zeros((len(q), 3)), np.zeros((len(q), 3))
    acc = np.tile(-GRAVITY, (len(q), 1)) + np.asarray(base_acceleration)
    F, N = [], []
    for i in range(7):
        spin = v[:, i, None] * Z0
        w_before, g_before = w, g
        w = _into(R[i], w_before) + spin  # Eq. (4)
        g = _into(R[i], g_before) + np.cross(_into(R[i], w_before), spin) + a[:, i, None] * Z0  # Eq. (5)
        acc = _into(R[i], acc + _fixed_point(g_before, w_before, p[i]))  # Eq. (6)
        acc_c = acc + _fixed_point(g, w, CENTRE_OF_MASS[i])  # Eq. (7)
        inertia = tensor(INERTIA[i])
        F.append(MASS[i] * acc_c)  # Eq. (8)
        N.append(g @ inertia + np.cross(w, w @ inertia))  # Eq. (9), the tensor is symmetric
    f, n, tau = np.zeros((len(q), 3)), np.zeros((len(q), 3)), np.empty_like(q)
    for i in reversed(range(7)):
        # Here f and n are still those of link i + 1, already in frame i.
        lever = p[i + 1] if i < 6 else np.zeros(3)
        n = n + np.cross(CENTRE_OF_MASS[i], F[i]) + np.cross(lever, f) + N[i]  # Eq. (11)
        f = f + F[i]  # Eq. (10)
        tau[:, i] = n @ Z0  # Eq. (13)
        f, n = _out_of(R[i], f), _out_of(R[i], n)
    return tau, n + np.cross(p[0], f), f  # Eq. (12)


def centre_of_mass(q: FloatArray) -> FloatArray:
    """Centre of mass (N, 3) of the arm in O0, m."""
    R_W, p_W = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    moment = np.zeros((len(q), 3))
    for i, (R, p) in enumerate(zip(*frames(q), strict=True)):
        p_W, R_W = p_W + R_W @ p, R_W @ R
        moment += MASS[i] * (p_W + R_W @ CENTRE_OF_MASS[i])
    return moment / MASS.sum()


def _fixed_point(g: FloatArray, w: FloatArray, p: FloatArray) -> FloatArray:
    """Acceleration that angular acceleration and velocity give to a point fixed in the link."""
    return np.cross(g, p) + np.cross(w, np.cross(w, p))


def _into(R: FloatArray, x: FloatArray) -> FloatArray:
    """From frame i to frame i+1: R^{i+1}_{i} is the transpose of R^{i}_{i+1}."""
    return np.einsum("nji,nj->ni", R, x)


def _out_of(R: FloatArray, x: FloatArray) -> FloatArray:
    return np.einsum("nij,nj->ni", R, x)


def tensor(entries: ArrayLike) -> FloatArray:
    """Inertia (3, 3) from Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
    xx, yy, zz, xy, xz, yz = np.asarray(entries)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
