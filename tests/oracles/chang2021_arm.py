"""The arm of Chang 2021 from its tables: the equations are those of `oracles.multibody`.

Every number is typed again from the paper's tables and from the assumptions that complete them. Neither the
package nor its URDF is read. Arrays have the state as leading axis.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oracles.multibody import Body, JointBounds, Multibody

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


def efforts(
    q: FloatArray, v: FloatArray, a: FloatArray, base_acceleration: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Joint torques tau (N, 7), Nm; torque n_0 (N, 3), Nm, and force f_0 (N, 3), N.

    n_0 and f_0 are what the guardrail exerts on the arm, about and in O0. Where the arm's base is accelerated
    in W, by (N, 3) or (3,), m/s2, it does not turn, and O0 moves with it.
    """
    tau, force, torque = ARM.efforts(q, v, a, base_acceleration=base_acceleration)
    return tau, -torque, -force


def tool_pose(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points (N, 3), m, and orientations (N, 3, 3) in O0: Eq. (3)."""
    return ARM.tool_poses(q)


def centre_of_mass(q: FloatArray) -> FloatArray:
    """Centre of mass (N, 3) of the arm in O0, m."""
    R, p = ARM.frames(q)
    centres = [p[one.joint] + R[one.joint] @ one.centre for one in ARM.bodies]
    return np.einsum("i,ikd->kd", MASS, np.array(centres)) / MASS.sum()


def tensor(entries: ArrayLike) -> FloatArray:
    """Inertia (3, 3) from Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
    xx, yy, zz, xy, xz, yz = np.asarray(entries)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _step(i: int) -> FloatArray:
    """Pose (4, 4) of frame i + 1 in frame i at zero, Eqs. (1) and (2); frame 0 is O0."""
    c, s = np.cos(ALPHA[i]), np.sin(ALPHA[i])
    X, base = np.eye(4), np.eye(4)
    X[:3, :3], X[:3, 3] = [[1, 0, 0], [0, c, -s], [0, s, c]], [A[i], -s * D[i], c * D[i]]
    base[:3, :3], base[:3, 3] = R_W1, P_W1
    return base @ X if i == 0 else X


def _arm() -> Multibody:
    X_JT, none = np.eye(4), np.empty(0)
    X_JT[:3, 3] = TOOL
    return Multibody(
        joints=tuple(f"joint_{i}" for i in range(1, 8)),
        step=np.array([_step(i) for i in range(7)]),
        axis=np.tile([0.0, 0.0, 1.0], (7, 1)),
        slides=np.zeros(7, dtype=np.bool_),
        bodies=tuple(
            Body(joint=i + 1, mass=MASS[i], centre=CENTRE_OF_MASS[i], inertia=tensor(INERTIA[i]))
            for i in range(7)
        ),
        shapes=(),
        pairs=(),
        X_JT=X_JT,
        bounds=JointBounds(lower=none, upper=none, velocity=none, acceleration=none, jerk=none, torque=none),
    )


ARM = _arm()
"""The arm of the paper."""
