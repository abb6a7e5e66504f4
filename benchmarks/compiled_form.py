"""`closed_form.batched`, one state after the other, for numba to compile."""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["derivatives"]


@numba.njit(cache=True, inline="always")
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def _motion_cross(V, m, out):  # type: ignore[no-untyped-def]
    out[:] = 0.0
    _cross(V[3:], m[:3], out[:3])
    _cross(V[:3], m[3:], out[:3])
    _cross(V[3:], m[3:], out[3:])


@numba.njit(cache=True)
def _add_force_cross(V, f, out):  # type: ignore[no-untyped-def]
    _cross(V[3:], f[:3], out[:3])
    _cross(V[:3], f[:3], out[3:])
    _cross(V[3:], f[3:], out[3:])


@numba.njit(cache=True)
def _skew(x, out, sign):  # type: ignore[no-untyped-def]
    out[0, 1], out[0, 2], out[1, 2] = -sign * x[2], sign * x[1], -sign * x[0]
    out[1, 0], out[2, 0], out[2, 1] = sign * x[2], -sign * x[1], sign * x[0]


@numba.njit(cache=True)
def _add_product(A, B, out, sign):  # type: ignore[no-untyped-def]
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            x = sign * A[i, k]
            for j in range(B.shape[1]):
                out[i, j] += x * B[k, j]


@numba.njit(cache=True)
def _add_times(M, x, out, factor):  # type: ignore[no-untyped-def]
    for i in range(M.shape[0]):
        total = 0.0
        for j in range(M.shape[1]):
            total += M[i, j] * x[j]
        out[i] += factor * total


@numba.njit(cache=True)
def _dot(x, y):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@numba.njit(cache=True)
def derivatives(rotation, translation, axis, mass, lever, inertia, gravity, q, v, a):  # type: ignore[no-untyped-def]
    """Evaluate `closed_form.batched`."""
    N, n = q.shape
    value = np.empty((N, 6 + n))
    d_q, d_v, d_a = np.empty((N, n, 6 + n)), np.empty((N, n, 6 + n)), np.empty((N, n, 6 + n))
    s, s1, s2, f = np.empty((n, 6)), np.empty((n, 6)), np.empty((n, 6)), np.empty((n, 6))
    Ic, B = np.empty((n, 6, 6)), np.empty((n, 6, 6))
    V, A, h, x, y = np.empty(6), np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    R, T, K, C = np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    X, D = np.zeros((6, 6)), np.empty((6, 6))
    p, c, u = np.empty(3), np.empty(3), np.empty(3)
    for k in range(N):
        R[:] = np.eye(3)
        p[:] = 0.0
        V[:] = 0.0
        A[:3], A[3:] = -gravity, 0.0
        for i in range(n):
            _add_times(R, translation[i], p, 1.0)
            sine, cosine = np.sin(q[k, i]), np.cos(q[k, i])
            u[:] = axis[i]
            _skew(u, K, sine)
            for m in range(3):
                for o in range(3):
                    T[m, o] = (1.0 - cosine) * u[m] * u[o] + (K[m, o] if m != o else cosine)
            C[:] = 0.0
            _add_product(rotation[i], T, C, 1.0)
            T[:] = 0.0
            _add_product(R, C, T, 1.0)
            R[:] = T
            u[:] = 0.0
            _add_times(R, axis[i], u, 1.0)
            s[i, 3:] = u
            s[i, :3] = 0.0
            _cross(p, u, s[i, :3])
            _motion_cross(V, s[i], s1[i])
            _motion_cross(A, s[i], s2[i])
            _motion_cross(V, s1[i], x)
            for m in range(6):
                s2[i, m] += x[m]
                V[m] += s[i, m] * v[k, i]
                A[m] += s[i, m] * a[k, i] + s1[i, m] * v[k, i]
            # The inertia about O0.
            c[:] = p
            _add_times(R, lever[i], c, 1.0)
            T[:] = 0.0
            _add_product(R, inertia[i], T, 1.0)
            square = _dot(c, c)
            for m in range(3):
                for o in range(3):
                    total = 0.0
                    for r in range(3):
                        total += T[m, r] * R[o, r]
                    Ic[i, 3 + m, 3 + o] = (
                        total - mass[i] * c[m] * c[o] + (mass[i] * square if m == o else 0.0)
                    )
                    Ic[i, m, o] = mass[i] if m == o else 0.0
            C[0, 0], C[1, 1], C[2, 2] = 0.0, 0.0, 0.0
            _skew(c, C, mass[i])
            Ic[i, 3:, :3] = C
            Ic[i, :3, 3:] = -C
            h[:] = 0.0
            _add_times(Ic[i], V, h, 1.0)
            f[i] = 0.0
            _add_times(Ic[i], A, f[i], 1.0)
            _add_force_cross(V, h, f[i])
            # 2 B = -X' Ic - Ic X + bar(h); X' Ic is the transpose of Ic X.
            _skew(V[3:], X[:3, :3], 1.0)
            _skew(V[3:], X[3:, 3:], 1.0)
            _skew(V[:3], X[:3, 3:], 1.0)
            D[:] = 0.0
            _add_product(Ic[i], X, D, 1.0)
            for m in range(6):
                for o in range(6):
                    B[i, m, o] = -D[m, o] - D[o, m]
            C[0, 0], C[1, 1], C[2, 2] = 0.0, 0.0, 0.0
            _skew(h[:3], C, 1.0)
            for m in range(3):
                for o in range(3):
                    B[i, m, 3 + o] -= C[m, o]
                    B[i, 3 + m, o] -= C[m, o]
            _skew(h[3:], C, 1.0)
            for m in range(3):
                for o in range(3):
                    B[i, 3 + m, 3 + o] -= C[m, o]
        for i in range(n - 1, 0, -1):
            for m in range(6):
                f[i - 1, m] += f[i, m]
                for o in range(6):
                    Ic[i - 1, m, o] += Ic[i, m, o]
                    B[i - 1, m, o] += B[i, m, o]
        value[k, :6] = f[0]
        for j in range(n):
            da, dv, dq = d_a[k, j], d_v[k, j], d_q[k, j]
            da[:6], dv[:6], dq[:6] = 0.0, 0.0, 0.0
            _add_times(Ic[j], s[j], da[:6], 1.0)
            _add_times(B[j], s[j], dv[:6], 1.0)
            _add_times(Ic[j], s1[j], dv[:6], 2.0)
            _add_times(B[j], s1[j], dq[:6], 1.0)
            _add_times(Ic[j], s2[j], dq[:6], 1.0)
            _add_force_cross(s[j], f[j], dq[:6])
            value[k, 6 + j] = _dot(s[j], f[j])
            for i in range(j + 1):
                da[6 + i], dv[6 + i], dq[6 + i] = _dot(s[i], da[:6]), _dot(s[i], dv[:6]), _dot(s[i], dq[:6])
            # Ic is symmetric; the row s' 2B is the column of its transpose.
            y[:] = 0.0
            for m in range(6):
                for o in range(6):
                    y[o] += s[j, m] * B[j, m, o]
            for i in range(j):
                d_a[k, i, 6 + j] = _dot(da[:6], s[i])
                d_v[k, i, 6 + j] = _dot(y, s[i]) + 2.0 * _dot(da[:6], s1[i])
                d_q[k, i, 6 + j] = _dot(y, s1[i]) + _dot(da[:6], s2[i])
    return value, d_q.transpose(0, 2, 1), d_v.transpose(0, 2, 1), d_a.transpose(0, 2, 1)
