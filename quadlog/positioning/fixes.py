"""Fixes: where a tag was at one epoch, from the ranges of that epoch alone, by five methods; all epochs at once.

Ranges are (E, A), NaN where absent, to anchors (A, 3) in map. The unknown is (x, y), or (x, y, z) where the tag's
height is None; a height that is given makes slant ranges of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from quadlog.errors import AnchorsCollinear, MissingInput, UnknownName
from quadlog.messages import Float, Int
from quadlog.positioning.epochs import thin_rows

METHODS = ("gauss_newton", "huber", "linear", "weighted", "paper")
Side = Literal["left", "right"]
SHARP = 1e-6
"""Smallest over largest eigenvalue of sum u u^T, roughly; below it a fix could slide along a line."""
SPREAD_OF_RANGE_STD = 0.5
"""Anchors nearer to one line than this share of a range's std (rms) cannot distinguish a fix from its mirror image."""
THIN_STD = 10.0
"""Anchors this many range stds or more off their line (rms) do not take a fix for its image. At half of that one in
a thousand is, at a tenth one in ten (measured with four anchors)."""
AMBIGUOUS_STD2 = 9.0
"""Two minima whose costs differ by less, in std^2, are both possible: the likelihoods' ratio is below 90."""
LONG_STD, SHORT_STD = 1.25, 4.0
"""Residuals, in std, where Huber's weights begin to fall: late paths exist, early ones hardly do. Chosen on simulated
seed 1 between 0.5 and 1.5: without late ranges they cost 1-2 %, with them they halve the error of eight anchors."""


@dataclass(frozen=True, slots=True)
class Fixes:
    """One row per epoch; numbers of a row that is not solved are NaN.

    position_m: (E, 2) in map; covariance_m2: (E, 2, 2) of it.
    z_m, z_std_m: (E,) height in map; where it was given instead of solved for, that, and a std of zero.
    hdop: (E,) horizontal dilution of precision: sqrt(trace) of the smallest covariance there is at that place,
    (sum u u^T)^-1, whatever the method. Without unit: times the range std it is the Cramér-Rao bound.
    residual_m: (E, A) measured minus predicted, NaN where there is no range; residual_rms_m: (E,).
    n_ranges: (E,); solved: (E,) bool; degenerate: (E,) bool, enough ranges, but from anchors on a line or with
    no unique minimum nearby; outlier: (E,) bool, solved with a residual rms above the limit.
    """

    position_m: Float
    covariance_m2: Float
    z_m: Float
    z_std_m: Float
    hdop: Float
    n_ranges: Int
    residual_rms_m: Float
    residual_m: Float
    solved: np.ndarray
    degenerate: np.ndarray
    outlier: np.ndarray


def solve_fixes(
    method: str, anchors_m: Float, range_m: Float, tag_height_m: float | None, range_std_m: float, outlier_m: float
) -> Fixes:
    """Fixes by one of METHODS.

    gauss_newton: maximum likelihood [Following, right form], with the Cramér-Rao bound as covariance.
    huber: the same, but residuals beyond LONG_STD (late) or -SHORT_STD std pull with bounded force. No help with three
    ranges, or with ranges that are all too long by a constant; its covariance is too small where ranges are late.
    linear, weighted, paper: of squared ranges, see `_linear`.

    tag_height_m: the tag's height in map; None solves for it, from four ranges to anchors that differ in height. A
    residual rms above outlier_m marks an outlier. Whatever cannot be solved is marked in the result: too few ranges by
    n_ranges, anchors on a line (on a plane, where the height is solved for) or a mirror image that fits as well by
    degenerate.

    Raises UnknownName for another method.
    """
    if method not in METHODS:
        raise UnknownName("UWB method", method, METHODS)
    seen = _Seen(anchors_m, range_m, tag_height_m, range_std_m)
    position_m, covariance_m2, spread_m2 = _linear(seen, method)
    if method in ("gauss_newton", "huber"):
        limits_m = (LONG_STD * range_std_m, SHORT_STD * range_std_m) if method == "huber" else NO_LIMITS
        start_m = position_m
        position_m, inverse, _ = descend(anchors_m, range_m, start_m, seen.axes, limits_m)
        thin = spread_m2 < (THIN_STD * range_std_m) ** 2
        if thin.any():
            few = _Seen(anchors_m, range_m[thin], tag_height_m, range_std_m)
            position_m[thin], inverse[thin] = _descend_both_sides(few, start_m[thin], limits_m)
        covariance_m2 = range_std_m**2 * inverse
    return complete_fixes(anchors_m, range_m, position_m, covariance_m2, outlier_m)


@dataclass(frozen=True, slots=True)
class _Seen:
    """Ranges (E, A) to anchors (A, 3); height_m: of the tag, None where it is solved for; std_m: of a range."""

    anchors_m: Float
    range_m: Float
    height_m: float | None
    std_m: float

    @property
    def axes(self) -> int:
        """Number of unknowns."""
        return 3 if self.height_m is None else 2


def _linear(seen: _Seen, method: str) -> tuple[Float, Float, Float]:
    """Positions (E, 3), covariances (E, D, D) and the anchors' spread (E,): squared ranges are linear in the place.

        d_i^2 - s^2 - |a_i|^2 = |p|^2 - 2 a_i . p,  with noise of variance v_i = 4 s^2 d_i^2 + 2 s^4

    s is the std of a range, and s^2 what noise adds to a squared range on average. Differences of rows remove |p|^2.
    "weighted" [Following, right form] has the full covariance of the differences against a reference station as
    weights: the same as rows less their mean, weighted by 1/v_i, whatever the reference (Sherman-Morrison). "paper"
    subtracts the last station heard; its weight matrix is lost in the text and is read as diag(1/d_i). Others: rows
    alike, less their mean. The covariance is that of the method's own weights. The spread is the mean square distance
    in m^2 of the anchors heard from the line, in space the plane, that fits best, as 1/trace(S^-1) of their scatter S.
    """
    axes, heard, variance_m2 = seen.axes, np.isfinite(seen.range_m), np.square(seen.std_m)
    # About the centroid, so that maps with large coordinates lose no digits.
    origin_m = seen.anchors_m.mean(axis=0)
    if seen.height_m is not None:
        origin_m[2] = seen.height_m
    around_m = seen.anchors_m - origin_m
    n, share = heard.sum(axis=1), heard / np.maximum(heard.sum(axis=1, keepdims=True), 1)
    scatter, determinant = _adjugate(_information(_centred(around_m[:, :axes], share), heard))
    minors = np.trace(scatter, axis1=1, axis2=2)
    spread_m2 = np.where((minors > 0) & (n > axes), determinant / np.where(minors > 0, minors * n, 1.0), 0.0)

    square_m2 = np.where(heard, seen.range_m, 0.0) ** 2
    noise_m4 = 4 * variance_m2 * square_m2 + 2 * np.square(variance_m2)
    if seen.height_m is not None:
        square_m2 = np.maximum(square_m2 - around_m[:, 2] ** 2, 0.0)
    row_m2 = square_m2 - variance_m2 - (around_m[:, :axes] ** 2).sum(axis=1)
    weight = heard.astype(np.float64)
    if method == "weighted":
        weight /= noise_m4
    elif method == "paper":
        weight /= np.maximum(np.nan_to_num(seen.range_m), seen.std_m)
    reference = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    if method == "paper":
        last = heard.shape[1] - 1 - np.argmax(heard[:, ::-1], axis=1)
        reference = (heard & (np.arange(heard.shape[1]) == last[:, None])).astype(np.float64)
    offset_m = np.where(heard[:, :, None], _centred(around_m[:, :axes], reference), 0.0)
    pull_m2 = ((reference * row_m2).sum(axis=1, keepdims=True) - row_m2) / 2
    lever = weight[:, :, None] * offset_m
    inverse = _inverted(lever.transpose(0, 2, 1) @ offset_m)
    inverse[~(spread_m2 > SPREAD_OF_RANGE_STD**2 * variance_m2)] = np.nan
    position_m = np.zeros((len(inverse), 3)) + 0.0 * inverse[:, 0, :1]
    position_m[:, :axes] = (inverse @ (lever.transpose(0, 2, 1) @ pull_m2[:, :, None]))[:, :, 0]
    # The reference's own noise is in every difference; about the weighted mean these sum to zero.
    total, shared_m4 = lever.sum(axis=1), (reference * noise_m4).sum(axis=1)
    scatter = (lever * noise_m4[:, :, None]).transpose(0, 2, 1) @ lever
    scatter += shared_m4[:, None, None] * total[:, :, None] * total[:, None, :]
    return position_m + origin_m, inverse @ scatter @ inverse / 4, spread_m2


def _centred(points_m: Float, share: Float) -> Float:
    """(E, A, D) points (A, D) less their means by shares (E, A)."""
    return points_m - (share @ points_m)[:, None, :]


def _information(vectors: Float, heard: np.ndarray) -> Float:
    """(E, D, D) sums of u u^T over the vectors (E, A, D) of the anchors heard (E, A)."""
    used = np.where(heard[:, :, None], vectors, 0.0)
    return used.transpose(0, 2, 1) @ used


def _adjugate(matrix: Float) -> tuple[Float, Float]:
    """(E, D, D) adjugates of symmetric matrices of two or three rows, and their determinants (E,)."""
    if matrix.shape[1] == 2:
        adjugate = matrix[:, ::-1, ::-1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    else:
        x, y, z = matrix[:, 0], matrix[:, 1], matrix[:, 2]
        adjugate = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)
    return adjugate, np.einsum("ei,ei->e", matrix[:, 0], adjugate[:, :, 0])


@np.errstate(all="ignore")
def _inverted(matrix: Float) -> Float:
    """(E, D, D) inverses of symmetric matrices, NaN where these are all but singular."""
    adjugate, determinant = _adjugate(matrix)
    size, minors = (np.trace(each, axis1=1, axis2=2) for each in (matrix, adjugate))
    scale = np.where(determinant > SHARP * size * minors, determinant, np.nan)
    inverse: Float = adjugate / scale[:, None, None]
    return inverse


NO_LIMITS = (np.inf, np.inf)
MOST_ROUNDS, LEAST_SHARE = 200, 2.0**-30
RESTED_M, RESTED = 1e-6, 1e-8
"""A step, or a share of the cost, too small to matter to a fix."""
FLAT = 1e-4
"""Two late ranges can leave Huber's cost all but flat between two places. What still gains less when the steps are used
up is as good as the minimum."""


@np.errstate(all="ignore")
def descend(
    anchors_m: Float, range_m: Float, start_m: Float, axes: int, limits_m: tuple[float, float] = NO_LIMITS
) -> tuple[Float, Float, Float]:
    """Downhill from start_m (E, 3): positions (E, 3), (sum w u u^T)^-1 (E, D, D) and costs (E,).

    Gauss-Newton for x, y, with three axes z. A residual beyond the first of limits_m, or below minus the second, counts
    as Huber has it: its cost grows linearly and its weight falls as 1/residual. A step that would raise the cost is
    halved; where not even a tiny one goes down, that is the minimum. NaN where the start is NaN or there is no sharp
    minimum; the cost is infinite there.
    """
    n = len(range_m)
    place_m, inverse, cost_m2 = start_m.copy(), np.full((n, axes, axes), np.nan), np.full(n, np.inf)
    step_m, share, gain, ended = np.zeros((n, axes)), np.ones(n), np.full(n, np.inf), np.zeros(n, dtype=bool)
    going = np.flatnonzero(np.isfinite(start_m).all(axis=1))
    for _ in range(MOST_ROUNDS):
        if len(going) == 0:
            break
        trial_m = place_m[going]
        trial_m[:, :axes] += share[going, None] * step_m[going]
        normal, pull, trial_m2 = _normal_equations(anchors_m, range_m[going], trial_m, axes, limits_m)
        lower = trial_m2 <= cost_m2[going]
        high, rows = going[~lower], going[lower]
        share[high] /= 2
        ended[high] = share[high] <= LEAST_SHARE
        first, before_m2 = np.isinf(cost_m2[rows]), np.where(np.isinf(cost_m2[rows]), 0.0, cost_m2[rows])
        gained = (before_m2 - trial_m2[lower]) / np.maximum(before_m2, 1e-300)
        gain[rows] = np.where(first, np.inf, gained)
        small = share[rows] * np.abs(step_m[rows]).sum(axis=1) < RESTED_M
        ended[rows] = ~first & (small | (gain[rows] < RESTED))
        place_m[rows], cost_m2[rows], share[rows] = trial_m[lower], trial_m2[lower], 1.0
        inverse[rows] = _inverted(normal[lower])
        step_m[rows] = np.einsum("eij,ej->ei", inverse[rows], pull[lower])
        going = going[~ended[going] & np.isfinite(inverse[going, 0, 0])]
    lost = ~((ended | (gain < FLAT)) & np.isfinite(inverse[:, 0, 0]))
    place_m[lost], inverse[lost], cost_m2[lost] = np.nan, np.nan, np.inf
    return place_m, inverse, cost_m2


def _normal_equations(
    anchors_m: Float, range_m: Float, place_m: Float, axes: int, limits_m: tuple[float, float]
) -> tuple[Float, Float, Float]:
    """Sum w u u^T (E, D, D), sum w u r (E, D) and the cost (E,) of places (E, 3), sum r^2 where nothing is beyond."""
    offset_m = place_m[:, None] - anchors_m
    distance_m = np.maximum(np.sqrt(np.einsum("eai,eai->ea", offset_m, offset_m)), 1e-9)
    heard = np.isfinite(range_m)
    residual_m = np.where(heard, range_m - distance_m, 0.0)
    size_m = np.abs(residual_m)
    over_m = np.maximum(size_m - np.where(residual_m > 0, *limits_m), 0.0)
    cost_m2 = np.einsum("ea,ea->e", residual_m - over_m, residual_m + over_m)
    unit = offset_m[:, :, :axes] / distance_m[:, :, None]
    weight = heard * (1 - over_m / np.maximum(size_m, 1e-9))
    weighted = (weight[:, :, None] * unit).transpose(0, 2, 1)
    return weighted @ unit, (weighted @ residual_m[:, :, None])[:, :, 0], cost_m2


def _descend_both_sides(seen: _Seen, start_m: Float, limits_m: tuple[float, float]) -> tuple[Float, Float]:
    """Positions (E, 3) and (sum w u u^T)^-1 (E, D, D) of the lower of two minima, NaN where both are possible.

    One lies downhill from start_m (E, 3), the other from its mirror image. Minima nearer to each other than the fix's
    own std count as one.
    """
    image_m = reflect_places(seen.anchors_m, np.isfinite(seen.range_m), start_m, seen.axes)
    (first_m, first, first_m2), (second_m, second, second_m2) = (
        descend(seen.anchors_m, seen.range_m, each, seen.axes, limits_m) for each in (start_m, image_m)
    )
    better = second_m2 < first_m2
    position_m, inverse = np.where(better[:, None], second_m, first_m), np.where(better[:, None, None], second, first)
    both = np.isfinite(first_m2) & np.isfinite(second_m2)
    difference_m2 = np.abs(np.where(both, first_m2, np.inf) - np.where(both, second_m2, 0.0))
    apart = np.linalg.norm(first_m - second_m, axis=1) > seen.std_m * np.sqrt(np.trace(inverse, axis1=1, axis2=2))
    position_m[apart & (difference_m2 < AMBIGUOUS_STD2 * seen.std_m**2)] = np.nan
    return position_m, inverse


def reflect_places(anchors_m: Float, heard: np.ndarray, position_m: Float, axes: int) -> Float:
    """(E, 3) mirror images of positions in what fits the anchors heard (E, A) best: a vertical plane through their
    line with two axes, their plane with three. NaN with as few anchors as axes.
    """
    image_m = np.full_like(position_m, np.nan)
    patterns, pattern = np.unique(heard, axis=0, return_inverse=True)
    for i in np.flatnonzero(patterns.sum(axis=1) > axes):
        mine, known_m, normal = pattern.reshape(-1) == i, anchors_m[patterns[i], :axes], np.zeros(3)
        normal[:axes] = np.linalg.svd(known_m - known_m.mean(axis=0))[2][-1]
        off_m = (position_m[mine, :axes] - known_m.mean(axis=0)) @ normal[:axes]
        image_m[mine] = position_m[mine] - 2 * off_m[:, None] * normal
    return image_m


def are_on_line(anchor_ids: Int, anchors_m: Float, range_std_m: float, *, refuse: bool) -> bool:
    """Whether all anchors (A, 3) lie on a line, which leaves two mirrored places for every fix.

    Raises MissingInput for fewer than three anchors, AnchorsCollinear for those on a line if they are to be refused.
    """
    if len(anchors_m) < 3:
        raise MissingInput(
            "position", f"{len(anchors_m)} UWB anchors are known, a fix needs three", "add [[uwb.anchors]]"
        )
    centred = anchors_m[:, :2] - anchors_m[:, :2].mean(axis=0)
    off_line_m = float(np.linalg.svd(centred, compute_uv=False)[-1]) / np.sqrt(len(centred))
    on_line = off_line_m < SPREAD_OF_RANGE_STD * range_std_m
    if on_line and refuse:
        raise AnchorsCollinear([int(i) for i in anchor_ids], off_line_m)
    return bool(on_line)


def complete_fixes(
    anchors_m: Float, range_m: Float, position_m: Float, covariance_m2: Float, outlier_m: float
) -> Fixes:
    """Fixes from the solutions of a method, with what is judged alike for all of them.

    position_m: (E, 3), covariance_m2: (E, D, D), NaN where there is no solution; D is 2 where the height was given and
    3 where it was solved for. A solution where the directions to the anchors are all but parallel is none: degenerate.
    """
    heard, axes = np.isfinite(range_m), covariance_m2.shape[1]
    n_ranges, offset_m = heard.sum(axis=1), position_m[:, None, :] - anchors_m
    distance_m = np.sqrt(np.einsum("eai,eai->ea", offset_m, offset_m))
    inverse = _inverted(_information(_directions(offset_m, axes), heard))
    known = np.isfinite(position_m.sum(axis=1) + np.einsum("eii->e", covariance_m2))
    hdop = np.where(known, np.sqrt(inverse[:, 0, 0] + inverse[:, 1, 1]), np.nan)
    solved = np.isfinite(hdop)
    blank = np.where(solved, 0.0, np.nan)
    residual_m = range_m - distance_m + blank[:, None]
    rms_m = np.sqrt(np.where(heard, residual_m**2, 0.0).sum(axis=1) / np.maximum(n_ranges, 1)) + blank
    return Fixes(
        position_m=position_m[:, :2] + blank[:, None],
        covariance_m2=covariance_m2[:, :2, :2] + blank[:, None, None],
        z_m=position_m[:, 2] + blank,
        z_std_m=np.sqrt(covariance_m2[:, 2, 2] + blank) if axes == 3 else blank,
        hdop=hdop,
        n_ranges=n_ranges,
        residual_rms_m=rms_m,
        residual_m=residual_m,
        solved=solved,
        degenerate=(n_ranges > axes) & ~solved,
        outlier=rms_m > outlier_m,
    )


def _directions(offset_m: Float, axes: int) -> Float:
    """(E, A, D) unit vectors along offsets (E, A, 3), of which the first axes."""
    return (offset_m / np.maximum(np.linalg.norm(offset_m, axis=2), 1e-9)[:, :, None])[:, :, :axes]


NEAR_LINE_STD = 3.0
"""A fix that its own std across the line, times this, would carry over the line has no side."""


def solve_on_side(
    anchors_m: Float, range_m: Float, tag_height_m: float, range_std_m: float, outlier_m: float, start: Side | Float
) -> Fixes:
    """Maximum-likelihood fixes from anchors (A, 3) on a line, each on the side of its own start.

    start: (E, 2) places, or a side of the way from the first to the last anchor. Starts near a track that is already
    known carry its side through the log by continuity. Near the line a fix has no side, and its covariance no meaning:
    those epochs are degenerate, as are those whose start is NaN or whose descent crosses the line (one in 10 000 from
    within 2 m).
    """
    centre_m = anchors_m[:, :2].mean(axis=0)
    along = np.linalg.svd(anchors_m[:, :2] - centre_m)[2][0]
    along *= -1 if along @ (anchors_m[-1, :2] - anchors_m[0, :2]) < 0 else 1
    across, heard = np.array([-along[1], along[0]]), np.isfinite(range_m)
    n = np.where(heard.sum(axis=1) >= 3, heard.sum(axis=1), np.nan)
    if isinstance(start, str):
        # Squared ranges are linear in the place along the line; what is left of them is the distance from it.
        anchor_m = (anchors_m[:, :2] - centre_m) @ along
        square_m2 = np.maximum(np.nan_to_num(range_m) ** 2 - (anchors_m[:, 2] - tag_height_m) ** 2, 0.0)
        off_m = np.where(heard, anchor_m - (heard @ anchor_m / n)[:, None], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            along_m = -(off_m * (square_m2 - anchor_m**2)).sum(axis=1) / (2 * (off_m**2).sum(axis=1))
        off_m2 = np.where(heard, square_m2 - (along_m[:, None] - anchor_m) ** 2, 0.0).sum(axis=1) / n
        off_line_m = np.maximum(np.sqrt(np.maximum(off_m2, 0.0)), range_std_m) * (1 if start == "left" else -1)
        first_m: Float = centre_m + along_m[:, None] * along + off_line_m[:, None] * across
    else:
        first_m = start
    place_m = np.column_stack([first_m + 0.0 * n[:, None], np.full(len(range_m), float(tag_height_m))])
    side = np.sign((place_m[:, :2] - centre_m) @ across)
    position_m, inverse, _ = descend(anchors_m, range_m, place_m, 2)
    across_std_m = range_std_m * np.sqrt(np.einsum("i,eij,j->e", across, inverse, across))
    position_m[~(side * ((position_m[:, :2] - centre_m) @ across) > NEAR_LINE_STD * across_std_m)] = np.nan
    return complete_fixes(anchors_m, range_m, position_m, range_std_m**2 * inverse, outlier_m)


TOLD_STD_M = 0.3
"""A height that someone wrote down is off by a few decimetres, as much as a person lifts or lowers a tag. One that
is solved for must be known better than that."""
MIRROR_APART_STD = 6.0
"""A mirror image whose ranges differ by this many std in all is taken for the fix once in 700 epochs."""
MAX_PLACES = 2000


def heights_are_told(
    anchors_m: Float, position_m: Float, height_m: float, heard: np.ndarray, range_std_m: float
) -> bool:
    """Whether to solve for the heights of a whole log, from its fixes (E, 2) at a height that is about right.

    heard: (E, A) bool, the ranges of each epoch to anchors (A, 3). True where half of the epochs or more would know
    the height to TOLD_STD_M (Cramér-Rao), and half or more could not be mistaken for the minimum downhill from their
    mirror image in the plane of the anchors heard.
    """
    placed = thin_rows(np.isfinite(position_m.sum(axis=1)), MAX_PLACES)
    if len(placed) == 0:
        return False
    heard = heard[placed]
    place_m = np.column_stack([position_m[placed], np.full(len(placed), float(height_m))])
    offset_m = place_m[:, None, :] - anchors_m
    inverse = _inverted(_information(_directions(offset_m, 3), heard))
    known = np.isfinite(inverse[:, 2, 2]) & (heard.sum(axis=1) > 3)
    height_std_m = range_std_m * np.sqrt(np.where(known, inverse[:, 2, 2], np.inf))
    range_m = np.where(heard, np.linalg.norm(offset_m, axis=2), np.nan)
    image_m, _, cost_m2 = descend(anchors_m, range_m, reflect_places(anchors_m, heard, place_m, 3), 3)
    itself = ~(np.linalg.norm(image_m - place_m, axis=1) > 1e-3)
    apart_std = np.where(itself, np.inf, np.sqrt(cost_m2) / range_std_m)
    return bool(np.median(height_std_m) <= TOLD_STD_M and np.median(apart_std) >= MIRROR_APART_STD)
