"""Fixes: where a tag was at one epoch, from the ranges of that epoch alone, by five methods; all epochs at once.

Ranges are (E, A), NaN where absent, to anchors (A, 3) in map. The unknown is (x, y), or (x, y, z) where the tag's
height is None; a height that is given makes slant ranges of them. Private functions have the epochs last, which is
faster: ranges (A, E), positions (3, E), matrices (D, D, E).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.errors import MissingInput, QuadlogError, UnknownName, set_flag
from quadlog.messages import Float, Int
from quadlog.positioning.epochs import thin_rows

METHODS = ("gauss_newton", "huber", "linear", "weighted", "paper")
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
NO_LIMITS = (np.inf, np.inf)
MOST_ROUNDS, RESTED_M, NEAR_M = 200, 1e-6, 0.01
"""Steps of a descent; one too small to matter; and one that may be left: late ranges can make Huber's cost flat."""
NEAR_LINE_STD = 3.0
"""A fix that its own std across the line, times this, would carry over the line has no side."""
TOLD_STD_M, MAX_PLACES = 0.3, 2000
"""A height that someone wrote down is off by a few decimetres, as much as a person lifts or lowers a tag. One that
is solved for must be known better than that."""


@dataclass(frozen=True, slots=True)
class Fixes:
    """One row per epoch; numbers of a row that is not solved are NaN.

    position_m: (E, 2) in map; covariance_m2: (E, 2, 2) of it. z_m, z_std_m: (E,) height in map; given: that, and zero.
    hdop: (E,) horizontal dilution of precision: sqrt(trace) of the smallest covariance there is at that place, (sum u
    u^T)^-1, whatever the method. Without unit: times the range std it is the Cramér-Rao bound. residual_m: (E, A)
    measured minus predicted, NaN where there is no range; residual_rms_m: (E,). n_ranges: (E,). solved: (E,) bool;
    degenerate: (E,) bool, enough ranges, but from anchors on a line or with no unique minimum nearby; outlier: (E,)
    bool, solved with a residual rms above the limit.
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
    """Fixes by one of METHODS, with the tag's height in map, or None: solved for, from four ranges or more.

    gauss_newton: maximum likelihood [Following, right form], with the Cramér-Rao bound as covariance. huber: the same,
    but residuals beyond LONG_STD (late) or -SHORT_STD std pull with bounded force. No help with three ranges, or with
    ranges that are all too long by a constant; its covariance is too small where ranges are late. linear, weighted,
    paper: of squared ranges, see `_linear`.

    A residual rms above outlier_m marks an outlier. What cannot be solved is marked: too few ranges by n_ranges,
    anchors on a line (on a plane, where the height is solved for) or a mirror image that fits as well by degenerate.

    Raises UnknownName for another method.
    """
    if method not in METHODS:
        raise UnknownName("UWB method", method, METHODS)
    seen_m = np.ascontiguousarray(range_m.T)
    position_m, covariance_m2, spread_m2 = _linear(method, anchors_m, seen_m, tag_height_m, range_std_m)
    if method in ("gauss_newton", "huber"):
        limits_m = (LONG_STD * range_std_m, SHORT_STD * range_std_m) if method == "huber" else NO_LIMITS
        axes, thin, start_m = len(covariance_m2), spread_m2 < (THIN_STD * range_std_m) ** 2, position_m
        position_m, inverse, cost_m2 = _descend(anchors_m, seen_m, start_m, axes, limits_m)
        if thin.any():
            some_m = seen_m[:, thin]
            both = _descend(anchors_m, some_m, _images(anchors_m, some_m, start_m[:, thin], axes), axes, limits_m)
            first = position_m[:, thin], inverse[..., thin], cost_m2[thin]
            position_m[:, thin], inverse[..., thin] = _lower(first, both, range_std_m)
        covariance_m2 = range_std_m**2 * inverse
    return _completed(anchors_m, seen_m, position_m, covariance_m2, outlier_m)


def _linear(
    method: str, anchors_m: Float, range_m: Float, height_m: float | None, std_m: float
) -> tuple[Float, Float, Float]:
    """Positions (3, E), covariances (D, D, E) and the anchors' spread (E,): squared ranges are linear in the place.

        d_i^2 - s^2 - |a_i|^2 = |p|^2 - 2 a_i . p,  with noise of variance v_i = 4 s^2 d_i^2 + 2 s^4

    s is the std of a range, and s^2 what noise adds to a squared range on average. Differences of rows remove |p|^2.
    "weighted" [Following, right form] has the full covariance of the differences as weights: the same as rows less
    their mean, weighted by 1/v_i, whatever the reference (Sherman-Morrison). "paper" subtracts the last station heard;
    its weights, lost in the text, are read as diag(1/d_i). The spread is the mean square distance in m^2 of the anchors
    heard from the line, in space the plane, that fits best, as 1/trace(S^-1) of their scatter S.
    """
    heard, axes = np.isfinite(range_m), 2 if height_m is not None else 3
    # About the centroid, so that maps with large coordinates lose no digits.
    origin_m = anchors_m.mean(axis=0)
    if height_m is not None:
        origin_m[2] = height_m
    around_m, above_m = np.split((anchors_m - origin_m).T, [axes])
    n = heard.sum(axis=0)
    centred_m = np.where(heard, around_m[:, :, None] - (around_m @ heard / np.maximum(n, 1))[:, None], 0.0)
    adjugate, determinant = _adjugate(np.einsum("iae,jae->ije", centred_m, centred_m))
    minors = n * np.trace(adjugate)
    spread_m2 = np.where((minors > 0) & (n > axes), determinant / np.where(minors > 0, minors, 1.0), 0.0)

    square_m2 = np.where(heard, range_m, 0.0) ** 2
    noise_m4 = 4 * std_m**2 * square_m2 + 2 * np.float64(std_m) ** 4
    row_m2 = np.maximum(square_m2 - (above_m**2).sum(axis=0)[:, None], 0.0)
    row_m2 -= std_m**2 + (around_m**2).sum(axis=0)[:, None]
    weight = heard.astype(np.float64)
    if method == "weighted":
        weight /= noise_m4
    elif method == "paper":
        weight /= np.maximum(np.nan_to_num(range_m), std_m)
    reference = weight / np.maximum(weight.sum(axis=0), 1e-300)
    if method == "paper":
        last = len(heard) - 1 - np.argmax(heard[::-1], axis=0)
        reference = (heard & (np.arange(len(heard))[:, None] == last)).astype(np.float64)
    offset_m = np.where(heard, around_m[:, :, None] - (around_m @ reference)[:, None], 0.0)
    pull_m2 = ((reference * row_m2).sum(axis=0) - row_m2) / 2
    lever = weight * offset_m
    inverse = _inverted(np.einsum("iae,jae->ije", lever, offset_m))
    inverse[:, :, ~(spread_m2 > (SPREAD_OF_RANGE_STD * std_m) ** 2)] = np.nan
    position_m = np.zeros((3, len(n))) + 0.0 * inverse[0, 0]
    position_m[:axes] = (inverse * (lever * pull_m2).sum(axis=1)).sum(axis=1)
    # The reference's own noise is in every difference; about the weighted mean these sum to zero.
    total, shared_m4 = lever.sum(axis=1), (reference * noise_m4).sum(axis=0)
    scatter = np.einsum("iae,jae->ije", lever * noise_m4, lever) + shared_m4 * total[:, None] * total
    covariance_m2 = np.einsum("ije,kje->ike", np.einsum("ije,jke->ike", inverse, scatter), inverse) / 4
    return position_m + origin_m[:, None], covariance_m2, spread_m2


def _adjugate(matrix: Float) -> tuple[Float, Float]:
    """(D, D, E) adjugates of symmetric matrices of two or three rows, and their determinants (E,)."""
    if len(matrix) == 2:
        adjugate = matrix[::-1, ::-1] * np.array([[[1.0], [-1.0]], [[-1.0], [1.0]]])
    else:
        x, y, z = matrix
        adjugate = np.stack([np.cross(*each, axis=0) for each in ((y, z), (z, x), (x, y))])
    return adjugate, (matrix[0] * adjugate[0]).sum(axis=0)


@np.errstate(all="ignore")
def _inverted(matrix: Float) -> Float:
    """(D, D, E) inverses of symmetric matrices, NaN where these are all but singular."""
    adjugate, determinant = _adjugate(matrix)
    size, minors = np.trace(matrix), np.trace(adjugate)
    return adjugate / np.where(determinant > SHARP * size * minors, determinant, np.nan)


@np.errstate(all="ignore")
def _descend(
    anchors_m: Float, range_m: Float, start_m: Float, axes: int, limits_m: tuple[float, float] = NO_LIMITS
) -> tuple[Float, Float, Float]:
    """Downhill from start_m (3, E): positions (3, E), (sum w u u^T)^-1 (D, D, E) and costs (E,).

    Gauss-Newton for x, y, with three axes z; residuals beyond limits_m count as Huber has it. A step that would raise
    the cost is halved. NaN, at infinite cost, where the start is NaN or there is no sharp minimum.
    """
    n = range_m.shape[1]
    place_m, inverse, cost_m2 = start_m.copy(), np.full((axes, axes, n), np.nan), np.full(n, np.inf)
    step_m, going = np.zeros((axes, n)), np.flatnonzero(np.isfinite(start_m).all(axis=0))
    for _ in range(MOST_ROUNDS):
        if len(going) == 0:
            break
        # Indices in brackets would put the epochs first.
        trial_m = place_m.take(going, axis=1)
        trial_m[:axes] += step_m.take(going, axis=1)
        offset_m = trial_m[:, None] - anchors_m.T[:, :, None]
        distance_m = np.maximum(np.sqrt(np.einsum("iae,iae->ae", offset_m, offset_m)), 1e-9)
        unit, residual_m = offset_m[:axes] / distance_m, range_m.take(going, axis=1) - distance_m
        trust = np.isfinite(residual_m).astype(np.float64)
        residual_m[trust == 0] = 0.0
        if limits_m != NO_LIMITS:
            trust *= np.minimum(np.where(residual_m > 0, *limits_m) / np.abs(residual_m), 1.0)
        trial_m2 = (trust * (2 - trust) * residual_m**2).sum(axis=0)
        weighted = trust * unit
        sharp = _inverted(np.einsum("iae,jae->ije", weighted, unit))
        new_m = (sharp * (weighted * residual_m).sum(axis=1)).sum(axis=1)
        lower = trial_m2 <= cost_m2[going]
        rows = going[lower]
        step_m[:, going[~lower]] /= 2
        for found, value in ((place_m, trial_m), (cost_m2, trial_m2), (inverse, sharp), (step_m, new_m)):
            found[..., rows] = value[..., lower]
        going = going[np.abs(step_m[:, going]).sum(axis=0) > RESTED_M]  # NaN has ended, too
    lost = ~(np.abs(step_m).sum(axis=0) < NEAR_M) | np.isnan(inverse[0, 0])
    place_m[:, lost], inverse[:, :, lost], cost_m2[lost] = np.nan, np.nan, np.inf
    return place_m, inverse, cost_m2


def _images(anchors_m: Float, range_m: Float, position_m: Float, axes: int) -> Float:
    """(3, E) images in the anchors' best vertical plane (two axes), or plane; NaN with as few anchors as axes."""
    image_m = np.full_like(position_m, np.nan)
    patterns, pattern = np.unique(np.isfinite(range_m).T, axis=0, return_inverse=True)
    for i in np.flatnonzero(patterns.sum(axis=1) > axes):
        mine, known_m, normal = pattern.reshape(-1) == i, anchors_m[patterns[i], :axes], np.zeros(3)
        normal[:axes] = np.linalg.svd(known_m - known_m.mean(axis=0))[2][-1]
        off_m = normal[:axes] @ (position_m[:axes, mine] - known_m.mean(axis=0)[:, None])
        image_m[:, mine] = position_m[:, mine] - 2 * off_m * normal[:, None]
    return image_m


def _lower(first: tuple[Float, Float, Float], second: tuple[Float, Float, Float], std_m: float) -> tuple[Float, Float]:
    """The lower of two minima, NaN where both are possible; those nearer than the fix's own std count as one."""
    position_m, inverse = (np.where(second[2] < first[2], b, a) for a, b in zip(first[:2], second[:2], strict=True))
    with np.errstate(invalid="ignore"):
        alike = np.abs(first[2] - second[2]) < AMBIGUOUS_STD2 * std_m**2  # never where one of them is infinite
    apart = np.linalg.norm(first[0] - second[0], axis=0) > std_m * np.sqrt(np.trace(inverse))
    position_m[:, apart & alike] = np.nan
    return position_m, inverse


def _completed(anchors_m: Float, range_m: Float, position_m: Float, covariance_m2: Float, outlier_m: float) -> Fixes:
    """Fixes from solutions (3, E), (D, D, E), NaN where there is none; all but parallel directions are degenerate."""
    heard, axes, offset_m = np.isfinite(range_m), len(covariance_m2), position_m[:, None] - anchors_m.T[:, :, None]
    n_ranges, distance_m = heard.sum(axis=0), np.sqrt(np.einsum("iae,iae->ae", offset_m, offset_m))
    unit = np.where(heard, offset_m[:axes] / np.maximum(distance_m, 1e-9), 0.0)
    inverse = _inverted(np.einsum("iae,jae->ije", unit, unit))
    known = np.isfinite(position_m.sum(axis=0) + np.trace(covariance_m2))
    hdop = np.where(known, np.sqrt(inverse[0, 0] + inverse[1, 1]), np.nan)
    solved = np.isfinite(hdop)
    blank = np.where(solved, 0.0, np.nan)
    residual_m = range_m - distance_m + blank
    rms_m = np.sqrt(np.where(heard, residual_m**2, 0.0).sum(axis=0) / np.maximum(n_ranges, 1)) + blank
    return Fixes(
        position_m=(position_m[:2] + blank).T,
        covariance_m2=(covariance_m2[:2, :2] + blank).transpose(2, 0, 1),
        z_m=position_m[2] + blank,
        z_std_m=np.sqrt(covariance_m2[2, 2] + blank) if axes == 3 else blank,
        hdop=hdop,
        n_ranges=n_ranges,
        residual_rms_m=rms_m,
        residual_m=residual_m.T,
        solved=solved,
        degenerate=(n_ranges > axes) & ~solved,
        outlier=rms_m > outlier_m,
    )


def are_on_line(anchor_ids: Int, anchors_m: Float, range_std_m: float, *, refuse: bool) -> bool:
    """Whether anchors (A, 3) are on a line. Raises QuadlogError if so to refuse, MissingInput for fewer than 3."""
    if len(anchors_m) < 3:
        raise MissingInput(
            "position", f"{len(anchors_m)} UWB anchors are known, a fix needs three", "add [[uwb.anchors]]"
        )
    centred = anchors_m[:, :2] - anchors_m[:, :2].mean(axis=0)
    off_line_m = float(np.linalg.svd(centred, compute_uv=False)[-1]) / np.sqrt(len(centred))
    on_line = off_line_m < SPREAD_OF_RANGE_STD * range_std_m
    if on_line and refuse:
        raise QuadlogError(
            f"UWB anchors {', '.join(map(str, anchor_ids))} lie within {off_line_m:.2f} m of one line, so every fix "
            "has a mirror image that fits as well; add an anchor off the line, check [[uwb.anchors]], or choose the "
            f"side of the way from the first anchor to the last with  {set_flag('uwb.mirror', ['left'])}  or  "
            f"{set_flag('uwb.mirror', ['right'])}"
        )
    return bool(on_line)


def solve_on_side(
    anchors_m: Float, range_m: Float, tag_height_m: float, range_std_m: float, outlier_m: float, side: str | Float
) -> Fixes:
    """Maximum-likelihood fixes from anchors (A, 3) on a line.

    side: left or right of the way from the first to the last anchor, or places (E, 2): those of a track that is known
    already carry its side through the log. Near the line a fix has no side, and its covariance no meaning: those epochs
    are degenerate, as are those whose place is NaN.
    """
    centre_m = anchors_m[:, :2].mean(axis=0)
    along = np.linalg.svd(anchors_m[:, :2] - centre_m)[2][0]
    along *= -1 if along @ (anchors_m[-1, :2] - anchors_m[0, :2]) < 0 else 1
    across, n = np.array([[-along[1]], [along[0]], [0.0]]), np.isfinite(range_m).sum(axis=1)
    sign = (1.0 if side == "left" else -1.0) if isinstance(side, str) else np.sign((side - centre_m) @ across[:2, 0])
    far_m, seen_m = np.where(n >= 3, np.nansum(range_m, axis=1) / np.maximum(n, 1), np.nan), range_m.T
    centre_m = np.append(centre_m, tag_height_m)[:, None]
    position_m, _, _ = _descend(anchors_m, seen_m, centre_m + far_m * across, 2)
    # What lies on the other side is as good a minimum as its mirror image.
    off_m = (across * (position_m - centre_m)).sum(axis=0)
    position_m += ((sign * np.abs(off_m)) - off_m) * across
    position_m, inverse, _ = _descend(anchors_m, seen_m, position_m, 2)
    off_m = sign * (across * (position_m - centre_m)).sum(axis=0)
    std_m = range_std_m * np.sqrt((across[:2] * (inverse * across[:2]).sum(axis=1)).sum(axis=0))
    position_m[:, ~(off_m > NEAR_LINE_STD * std_m)] = np.nan
    return _completed(anchors_m, seen_m, position_m, range_std_m**2 * inverse, outlier_m)


def heights_are_told(anchors_m: Float, fixes: Fixes, range_std_m: float) -> bool:
    """Whether to solve for heights: half of a log's fixes, at about the right one, would know it to TOLD_STD_M."""
    some = thin_rows(fixes.solved, MAX_PLACES)
    offset_m = np.column_stack([fixes.position_m, fixes.z_m])[some, None] - anchors_m
    range_m = np.linalg.norm(offset_m, axis=2) + 0.0 * fixes.residual_m[some]
    found = solve_fixes("gauss_newton", anchors_m, range_m, None, range_std_m, np.inf)
    return bool(np.median(np.append(np.inf, np.where(found.solved, found.z_std_m, np.inf))) <= TOLD_STD_M)
