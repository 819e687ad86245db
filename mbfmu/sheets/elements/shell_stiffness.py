"""Linear stiffness of a flat quadrilateral of a thin shell: two parts that do not see each other.

In the element's plane, axes x and z, corners counter to the y axis as a plate's: (0, 0), (a, 0), (a, b), (0, b).

**Bending** over (w, theta_x, theta_z) of the corners: discrete Kirchhoff quadrilateral (Batoz and Ben Tahar 1982). The
slopes S = (w,x, w,z) are those of the nodes, (theta_z, -theta_x), and in the middle of an edge: across it the mean,
along it that of the cubic through both ends. Between they go with the eight serendipity functions, and the
curvatures (Sx,x, Sz,z, Sx,z + Sz,x) with their derivatives.

**Membrane** over (u, v, theta_y): the five stresses of Pian and Sumihara (1984) for the displacements of the corners,
which bend in the plane without locking; and a slight spring that ties the turn theta_y about the normal to that of the
displacements (Hughes and Brezzi 1989), without which nothing would hold it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
XI, ETA = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])  # the corners
GAUSS_POINTS = np.array([[x, z] for x in (-1.0, 1.0) for z in (-1.0, 1.0)]) / np.sqrt(3.0)  # each of weight 1
# Part of the shear stiffness that turns about the normal meet: enough to be determined, too little to be felt.
# Cook's membrane on 8 x 8 cells moves by 1e-4 between a hundredth of it and this.
DRILLING_RATIO = 1e-2
# A bending moment in a curved shell is one about the normal of the next cell too, and turns that spring: by a part of
# the bending, 0.16 (curvature times thickness)^2 / DRILLING on a twisted strip, which no mesh makes smaller. So the
# spring grows with that square, up to the shear stiffness itself; the part stays below 0.3 %, and thin shells do not
# notice.
CURVATURE_LIMIT, MAX_DRILLING_RATIO = 50.0, 1.0


def bilinear(xi: float, eta: float) -> tuple[Matrix, Matrix]:
    """Return the shape functions (4,) of the corners and their derivatives (2, 4) by xi and eta."""
    N = 0.25 * (1.0 + XI * xi) * (1.0 + ETA * eta)
    return N, 0.25 * np.array([XI * (1.0 + ETA * eta), ETA * (1.0 + XI * xi)])


def serendipity(xi: float, eta: float) -> Matrix:
    """Return the derivatives (2, 8) by xi and eta of the shape functions of corners and middles of edges."""
    corner = 0.25 * np.array(
        [
            XI * (1.0 + ETA * eta) * (2.0 * XI * xi + ETA * eta),
            ETA * (1.0 + XI * xi) * (2.0 * ETA * eta + XI * xi),
        ]
    )
    middle = np.array(
        [
            [-xi * (1.0 - eta), 0.5 * (1.0 - eta**2), -xi * (1.0 + eta), -0.5 * (1.0 - eta**2)],
            [-0.5 * (1.0 - xi**2), -eta * (1.0 + xi), 0.5 * (1.0 - xi**2), -eta * (1.0 - xi)],
        ]
    )
    return np.hstack((corner, middle))


def jacobian(X: Matrix, dN: Matrix) -> tuple[Matrix, float]:
    """Return d(xi, eta) / d(x, z) (2, 2) and the area per d(xi) d(eta), from corners X (4, 2)."""
    J = dN @ X
    return np.asarray(np.linalg.inv(J), np.float64), float(np.linalg.det(J))


def middle_slopes(X: Matrix) -> Matrix:
    """Return the slopes (8, 2, 12) at corners and middles of edges by (w, theta_x, theta_z) of every corner."""
    slopes = np.zeros((8, 2, 12))
    for i in range(4):
        slopes[i, 0, 3 * i + 2], slopes[i, 1, 3 * i + 1] = 1.0, -1.0
    for i in range(4):
        j = (i + 1) % 4
        way = X[j] - X[i]
        length = np.hypot(*way)
        along = way / length
        mean = 0.5 * (slopes[i] + slopes[j])
        cubic = -0.5 * along @ mean
        cubic[3 * j] += 1.5 / length
        cubic[3 * i] -= 1.5 / length
        slopes[4 + i] = mean + np.outer(along, cubic - along @ mean)
    return slopes


def curvature(X: Matrix, xi: float, eta: float) -> Matrix:
    """Return (w,xx, w,zz, 2 w,xz) at a point, (3, 12), by (w, theta_x, theta_z) of every corner X (4, 2)."""
    inverse, _ = jacobian(X, bilinear(xi, eta)[1])
    by = np.einsum("an,nck->ack", inverse @ serendipity(xi, eta), middle_slopes(X))  # d(slope c) / d(direction a)
    return np.array([by[0, 0], by[1, 1], by[1, 0] + by[0, 1]])


def bending(X: Matrix, D: Matrix) -> Matrix:
    """Return the stiffness (12, 12) over (w, theta_x, theta_z) of every corner.

    X (4, 2) are the corners, m; D (3, 3) in N m takes (w,xx, w,zz, 2 w,xz) to the moments.
    """
    K = np.zeros((12, 12))
    for xi, eta in GAUSS_POINTS:
        B = curvature(X, xi, eta)
        K += jacobian(X, bilinear(xi, eta)[1])[1] * B.T @ D @ B
    return K


def assumed_strains(X: Matrix, xi: float, eta: float) -> Matrix:
    """Return the five assumed stresses at a point, (3, 5)."""
    a1, a3 = 0.25 * XI @ X, 0.25 * ETA @ X  # derivatives of (x, z) by xi and by eta in the middle
    P = np.zeros((3, 5))
    P[:, :3] = np.eye(3)
    P[:, 3] = eta * a1[0] ** 2, eta * a1[1] ** 2, eta * a1[0] * a1[1]
    P[:, 4] = xi * a3[0] ** 2, xi * a3[1] ** 2, xi * a3[0] * a3[1]
    return P


def stresses(X: Matrix, A: Matrix) -> tuple[Matrix, Matrix]:
    """Return by how much each of these (5, 12) is there by (u, v, theta_y) of every corner, and its work (5, 12)."""
    S = np.linalg.inv(A)
    H, G = np.zeros((5, 5)), np.zeros((5, 12))
    for xi, eta in GAUSS_POINTS:
        dN = bilinear(xi, eta)[1]
        inverse, area = jacobian(X, dN)
        by = inverse @ dN
        B = np.zeros((3, 12))
        B[0, 0::3], B[1, 1::3], B[2, 0::3], B[2, 1::3] = by[0], by[1], by[1], by[0]
        P = assumed_strains(X, xi, eta)
        H += area * P.T @ S @ P
        G += area * P.T @ B
    return np.asarray(np.linalg.solve(H, G), np.float64), G


def drilling(corners: Any, normals: Any, A: Matrix, D: Matrix) -> float:
    """Return the part of the shear stiffness that turns about the normal meet, from how the cell is curved.

    The curvature is the most that the normals (4, 3) turn along an edge between corners (4, 3), 1/m; the thickness that
    of a homogeneous shell of stretching A and bending D.
    """
    edges, turns = (np.roll(x, -1, 0) - x for x in (np.asarray(corners, float), np.asarray(normals, float)))
    squared = float((np.sum(turns**2, 1) / np.sum(edges**2, 1)).max())
    return min(DRILLING_RATIO + CURVATURE_LIMIT * squared * 12.0 * float(np.trace(D) / np.trace(A)), MAX_DRILLING_RATIO)


def membrane(X: Matrix, A: Matrix, drilling: float = DRILLING_RATIO) -> Matrix:
    """Return the stiffness (12, 12) over (u, v, theta_y) of every corner, v along z.

    X (4, 2) are the corners, m; A (3, 3) in N/m takes (u,x, v,z, u,z + v,x) to the forces per length; ``drilling`` is
    the part of the shear stiffness that turns about the normal meet.
    """
    shares, G = stresses(X, A)
    K = G.T @ shares
    for xi, eta in GAUSS_POINTS:
        N, dN = bilinear(xi, eta)
        inverse, area = jacobian(X, dN)
        by, turn = inverse @ dN, np.zeros(12)
        turn[0::3], turn[1::3], turn[2::3] = -0.5 * by[1], 0.5 * by[0], N
        K += drilling * A[2, 2] * area * np.outer(turn, turn)
    return K


def flat_axes(corners: Any) -> tuple[Matrix, Matrix]:
    """Return the axes (3, 3), rows, of four corners (4, 3), and the corners in them about their mean."""
    P = np.asarray(corners, float)
    P = P - P.mean(0)
    n = np.cross(P[3] - P[1], P[2] - P[0])
    n /= np.linalg.norm(n)
    x = P[1] - P[0] + P[2] - P[3]
    x -= (x @ n) * n
    x /= np.linalg.norm(x)
    E = np.array([x, n, np.cross(x, n)])
    return E, P @ E.T
