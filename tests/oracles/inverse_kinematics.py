"""Every posture of the shipped arm for a tool pose, in closed form, from the D-H table of Chang 2021.

The wrist centre lies in the vertical plane that joint 1 chooses (two ways); in it, for each pitch of link 4,
two links reach the point below it (two ways); the wrist turns to the orientation (two ways). Shares nothing
with the package.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

L1, L2, L3, D5, TOOL = 0.83, 1.00, 0.78, 0.87, 0.30
R_WB = np.diag([1.0, -1.0, -1.0])
P_WB = np.array([0.0, 0.5, 0.0])


def postures(p_WT: FloatArray, R_WT: FloatArray, pitches: FloatArray) -> FloatArray:
    """All postures (K, 7), rad in (-pi, pi], for the pitches q2 + q3 + q4 of link 4."""
    wrist = R_WB.T @ (p_WT - TOOL * R_WT[:, 2] - P_WB)
    R_B7, quarter = Rotation.from_matrix(R_WB.T @ R_WT), Rotation.from_euler("x", np.pi / 2)
    found = [np.empty((0, 7))]
    for turn, elbow in product((0.0, np.pi), (1.0, -1.0)):
        q1 = np.arctan2(wrist[1], wrist[0]) + turn
        x = wrist[0] * np.cos(q1) + wrist[1] * np.sin(q1)
        u, v = x - D5 * np.sin(pitches) - L1, D5 * np.cos(pitches) - wrist[2]
        cosine = (u**2 + v**2 - L2**2 - L3**2) / (2 * L2 * L3)
        # Rx(90) Rz(q5) Rx(-90) Rz(q6) Rx(90) Rz(q7) = Ry(-q5) Rz(q6) Ry(-q7) Rx(90), angles in degrees.
        R_B4 = Rotation.from_euler("z", q1) * quarter.inv() * Rotation.from_euler("z", pitches[:, None])
        R_4W = R_B4.inv() * R_B7 * quarter.inv()
        # With a straight wrist only the sum of q5 and q7 is determined.
        which = (np.abs(cosine) <= 1.0) & (np.abs(R_4W.as_matrix()[:, 1, 1]) < 1 - 1e-12)
        if not which.any():
            continue
        q3 = elbow * np.arccos(cosine[which])
        q2 = np.arctan2(v[which], u[which]) - np.arctan2(L3 * np.sin(q3), L2 + L3 * np.cos(q3))
        q4 = pitches[which] - q2 - q3
        q5, q6, q7 = R_4W[which].as_euler("YZY").T * np.array([-1, 1, -1])[:, None]
        both_ways = ((q5, q6, q7), (q5 + np.pi, -q6, q7 + np.pi))
        found += [np.column_stack([np.full_like(q2, q1), q2, q3, q4, *each]) for each in both_ways]
    return np.asarray((np.concatenate(found) + np.pi) % (2 * np.pi) - np.pi)
