"""Every posture of the shipped arm for a tool pose, in closed form, from the D-H table of Chang 2021.

The wrist centre lies in the vertical plane that joint 1 chooses (two ways); in it, for each pitch of link 4,
two links reach the point below it (two ways); the wrist turns to the orientation (two ways). Shares nothing
with the package.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

L1, L2, L3, D5, TOOL = 0.83, 1.00, 0.78, 0.87, 0.30
R_WB = np.diag([1.0, -1.0, -1.0])
P_WB = np.array([0.0, 0.5, 0.0])


def postures(p_WT: FloatArray, R_WT: FloatArray, pitches: FloatArray) -> FloatArray:
    """All postures (K, 7), rad in (-pi, pi], for the pitches q2 + q3 + q4 of link 4."""
    wrist = R_WB.T @ (p_WT - TOOL * R_WT[:, 2] - P_WB)
    R_B7 = R_WB.T @ R_WT
    found = []
    for turn in (0.0, np.pi):
        q1 = np.arctan2(wrist[1], wrist[0]) + turn
        x = wrist[0] * np.cos(q1) + wrist[1] * np.sin(q1)
        y = -wrist[2]
        for pitch in pitches:
            u, v = x - D5 * np.sin(pitch) - L1, y + D5 * np.cos(pitch)
            cosine = (u**2 + v**2 - L2**2 - L3**2) / (2 * L2 * L3)
            if abs(cosine) > 1.0:
                continue
            for q3 in (np.arccos(cosine), -np.arccos(cosine)):
                q2 = np.arctan2(v, u) - np.arctan2(L3 * np.sin(q3), L2 + L3 * np.cos(q3))
                wrist_angles = _wrist(_base_to_link_4(q1, pitch).T @ R_B7)
                found += [[q1, q2, q3, pitch - q2 - q3, *angles] for angles in wrist_angles]
    q = np.array(found).reshape(-1, 7)
    return np.asarray((q + np.pi) % (2 * np.pi) - np.pi)


def _base_to_link_4(q1: float, pitch: float) -> FloatArray:
    """Rotation Rz(q1) Rx(-90 deg) Rz(pitch)."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return _about_z(q1) @ turn @ _about_z(pitch)


def _about_z(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _wrist(M: FloatArray) -> list[tuple[float, float, float]]:
    """Angles of joints 5 to 7 for M = Rx(90) Rz(q5) Rx(-90) Rz(q6) Rx(90) Rz(q7), both ways."""
    angles = []
    for sign in (1.0, -1.0):
        q6 = sign * np.arccos(np.clip(-M[1, 2], -1.0, 1.0))
        s6 = np.sin(q6)
        if abs(s6) > 1e-6:
            q5 = np.arctan2(M[2, 2] / s6, M[0, 2] / s6)
            q7 = np.arctan2(-M[1, 1] / s6, M[1, 0] / s6)
            angles.append((float(q5), float(q6), float(q7)))
    return angles
