"""Prioritised inverse kinematics: every task gets what the tasks before it leave free [Tracking, eqs 33-40].

The recursion q_i = q_{i-1} + (J_i N_{i-1})^+ (x_i - J_i q_{i-1}) is one Gram-Schmidt process over the tasks' rows.
Taking from a row what lies along the rows before it is the projection N_{i-1} (eq. 34), and of what is left the task's
own block L of coefficients and its part Q of the basis are made: J_i N_{i-1} = L Q, so the pseudo-inverse is
Q^T L^-1. Errata: eq. 36 as printed disturbs the first task, eq. 37 has q_i for x_i; eqs 38 and 39 are right.
"""

from __future__ import annotations

import math

import numpy as np

from quadlog.compiled import inner

# A row of which the rows before it leave no more than this part is one that they say already.
DEPENDENT = 1e-10
# Jacobi rotations stop when two columns are this close to a right angle, at the latest after so many rounds.
ORTHOGONAL = 1e-14
MAX_ROUNDS = 40


@inner
def prioritised(rows, ends, wanted, weakest, out, basis, columns, coefficients, inverse):  # type: ignore[no-untyped-def]
    """Writes out (n, C), what meets the tasks in their order, and counts the tasks that are met weakly.

    rows (R, n): the tasks' Jacobians one below the other, the highest first; ends (T,): where each task ends.
    wanted (R, C): what rows @ out should be, in C independent columns. What a task cannot have is met as nearly as
    it can be, and what the tasks leave free is zero.
    weakest: a direction that a task moves by a singular value s below it gets s / weakest^2 instead of 1 / s. So a
    straight leg loses a little accuracy where the plain pseudo-inverse would ask for endless joint speeds; the gain
    nowhere exceeds 1 / weakest, and it is continuous. Such a task is one met weakly.
    basis (R, n), columns (n, R), coefficients (R, R) and inverse (R, R) are room to work in.
    """
    count, n = rows.shape
    wishes = wanted.shape[1]
    along = np.zeros((count, wishes))  # out, in the basis
    rest = np.empty(wishes)
    weak, first = 0, 0
    for task in range(len(ends)):
        end = ends[task]
        for r in range(first, end):
            _extend(rows, r, basis, columns, coefficients)
        size = end - first
        weak += _invert(coefficients[first:end, first:end], weakest, inverse)
        for i in range(size):
            row = coefficients[first + i]
            for c in range(wishes):
                rest[c] = wanted[first + i, c]
            for k in range(first):
                for c in range(wishes):
                    rest[c] -= row[k] * along[k, c]
            for k in range(size):
                for c in range(wishes):
                    along[first + k, c] += inverse[k, i] * rest[c]
        first = end
    out[:] = 0.0
    for r in range(count):
        for j in range(n):
            for c in range(wishes):
                out[j, c] += basis[r, j] * along[r, c]
    return weak


@inner
def _extend(rows, r, basis, columns, coefficients):  # type: ignore[no-untyped-def]
    """Row r's coefficients along the basis and its own new vector, which is zero when the row is dependent.

    columns (n, R) is the basis again, transposed: so neither inner loop adds up one number, which would be slow.
    Twice is enough: after one round of subtraction the rest of a nearly dependent row is not orthogonal to rounding.
    """
    n = rows.shape[1]
    left, own = basis[r], coefficients[r]
    dots = np.empty(r)
    before = 0.0
    for j in range(n):
        left[j] = rows[r, j]
        before += left[j] * left[j]
    own[:] = 0.0
    for _ in range(2):
        dots[:] = 0.0
        for j in range(n):
            for k in range(r):
                dots[k] += columns[j, k] * left[j]
        for k in range(r):
            own[k] += dots[k]
            for j in range(n):
                left[j] -= dots[k] * basis[k, j]
    after = 0.0
    for j in range(n):
        after += left[j] * left[j]
    if after <= DEPENDENT * DEPENDENT * before:
        left[:] = 0.0
    else:
        own[r] = math.sqrt(after)
        for j in range(n):
            left[j] /= own[r]
    for j in range(n):
        columns[j, r] = left[j]


@inner
def _invert(lower, weakest, inverse):  # type: ignore[no-untyped-def]
    """Writes the inverse of a lower triangle (m, m) into inverse[:m, :m]: whether it had to be a weakened one.

    1 / |L^-1| in Frobenius' norm is a lower bound of the smallest singular value, so the plain inverse is used only
    where no singular value is below weakest.
    """
    m = len(lower)
    square = 0.0
    for i in range(m):
        if not lower[i, i] >= weakest:
            return invert_weakly(lower, weakest, inverse)
        for j in range(m):
            inverse[i, j] = 0.0
        inverse[i, i] = 1.0 / lower[i, i]
        for k in range(i):
            factor = lower[i, k] * inverse[i, i]
            for j in range(k + 1):
                inverse[i, j] -= factor * inverse[k, j]
        for j in range(i + 1):
            square += inverse[i, j] * inverse[i, j]
    if square * weakest * weakest > 1.0:
        return invert_weakly(lower, weakest, inverse)
    return False


@inner
def invert_weakly(matrix, weakest, inverse):  # type: ignore[no-untyped-def]
    """Writes V diag(1 / max(s, weakest)^2) (U s)^T of a matrix U s V^T (m, m) into inverse[:m, :m].

    One-sided Jacobi: it turns the columns until all are at right angles. True when some s was below weakest.
    """
    m = len(matrix)
    turned = matrix.copy()
    v = np.eye(m)
    for _ in range(MAX_ROUNDS):
        turning = False
        for p in range(m - 1):
            for q in range(p + 1, m):
                pp, qq, pq = 0.0, 0.0, 0.0
                for i in range(m):
                    pp += turned[i, p] * turned[i, p]
                    qq += turned[i, q] * turned[i, q]
                    pq += turned[i, p] * turned[i, q]
                if abs(pq) <= ORTHOGONAL * math.sqrt(pp * qq) or not math.isfinite(pq):
                    continue
                turning = True
                zeta = (qq - pp) / (2.0 * pq)
                tangent = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
                sine = cosine * tangent
                for each in (turned, v):
                    for i in range(m):
                        left, right = each[i, p], each[i, q]
                        each[i, p] = cosine * left - sine * right
                        each[i, q] = sine * left + cosine * right
        if not turning:
            break
    inverse[:m, :m] = 0.0
    is_weak = False
    for k in range(m):
        square = 0.0
        for i in range(m):
            square += turned[i, k] * turned[i, k]
        if square < weakest * weakest:
            is_weak = True
            square = weakest * weakest
        for i in range(m):
            for j in range(m):
                inverse[i, j] += v[i, k] * turned[j, k] / square
    return is_weak
