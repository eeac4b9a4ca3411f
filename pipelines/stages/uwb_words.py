"""What a user is told of the ranges of a log: what was left out, what does not fit, what was corrected."""

from __future__ import annotations

import numpy as np

from quadlog.config import Config
from quadlog.pipelines.stages.walk import Walk
from quadlog.positioning.body_motion import MeasuredVelocity
from quadlog.positioning.calibration import AnchorBias
from quadlog.positioning.epochs import USUAL_EPOCH_S
from quadlog.positioning.locate import Located, TagResult
from quadlog.positioning.screening import RangeCounts

MISFIT_STD = 5.0
"""Of clean ranges half miss by less than 0.7 std, of heavily blocked ones by less than 3."""


def tell_located(walk: Walk, located: Located) -> None:
    """Counts for `run.json`, and a warning for every range and epoch that could not be used."""
    counts = located.counts
    walk.counts |= {"ranges": counts.total, "ranges_used": counts.used}
    walk.counts["ranges_off_track"] = sum(result.n_untracked for result in located.tags)
    for text in located_warnings(located, walk.config, walk.first_ns):
        walk.warn(text)
    for text in _located_notes(located, walk.config):
        walk.note(text)


def located_warnings(located: Located, config: Config, first_ns: int) -> list[str]:
    """Every range and epoch that could not be used, and what does not fit; first_ns: where the log starts."""
    texts = _range_warnings(located.counts)
    if config.uwb.method == "huber" and not config.uwb.calibrate and not located.on_line:
        texts.append(
            'uwb.method = "huber" needs calibrated ranges: where all are too long by a bias it trusts the wrong ones; '
            "set uwb.calibrate = true, or take another method"
        )
    return texts + [text for result in located.tags for text in _tag_warnings(result, config, first_ns)]


def _located_notes(located: Located, config: Config) -> list[str]:
    """Choices that decided the result."""
    texts = []
    if located.on_line:
        first, *_, last = (anchor.id for anchor in config.uwb.anchors)
        texts.append(
            f"the anchors lie on a line: tracks start to the {config.uwb.mirror} of the way from anchor {first} to "
            f"anchor {last} (uwb.mirror); on the other side their mirror images fit as well"
        )
    for result in located.tags:
        if config.uwb.epoch_s is None and result.epoch_s != USUAL_EPOCH_S:
            texts.append(
                f"tag {result.tag}: single ranges within {result.epoch_s:.2f} s make one fix, a round of its anchors "
                "in this log (uwb.epoch_s)"
            )
        if result.height_solved:
            std_m = np.median(result.track.z_std_m) if len(result.track) else np.nan
            texts.append(f"tag {result.tag}: its height is solved for, to {std_m:.2f} m")
        if result.velocity is not None:
            texts.append(f"tag {result.tag}: {_velocity_words(result.velocity)}")
        if result.bias is not None and result.bias.n.any():
            texts.append(_bias_words(result.tag, result.bias, config))
    return texts


def _tag_warnings(result: TagResult, config: Config, first_ns: int) -> list[str]:
    """Epochs without a fix, ranges that fit no track, and a track that was lost."""
    texts = []
    if result.n_too_few or result.n_degenerate:
        causes = {
            f"fewer than {'four' if result.height_solved else 'three'} ranges": result.n_too_few,
            "anchors on a line or a mirror image": result.n_degenerate,
        }
        words = " and ".join(f"{count} with {cause}" for cause, count in causes.items() if count)
        texts.append(f"tag {result.tag}: of {len(result.fix_t_ns)} epochs, {words} give no fix")
    misfit = _misfit_warning(result, config)
    if misfit is not None:
        texts.append(misfit)
    n = len(result.restart_ns)
    if n:
        seconds = ", ".join(f"{(t_ns - first_ns) * 1e-9:.1f} s" for t_ns in result.restart_ns[:5].tolist())
        texts.append(f"tag {result.tag}: its track was lost and started anew {n} times, at {seconds}")
    return texts


def _velocity_words(velocity: MeasuredVelocity) -> str:
    if velocity.series is None:
        return f"odometry does not steady its track: {velocity.reason}"
    return f"odometry steadies its track, known to {velocity.std_mps:.2f} m/s from the log"


def _misfit_warning(result: TagResult, config: Config) -> str | None:
    """Ranges that fit no position at all: ids or places of anchors are wrong, and the worst anchor is named."""
    residual_m = np.abs(result.ranges.range_m - result.ranges.predicted_m)
    known = np.isfinite(residual_m)
    if not known.any() or np.median(residual_m[known]) < MISFIT_STD * config.uwb.range_std_m:
        return None
    anchors = np.unique(result.ranges.anchor[known])
    worst = max(anchors, key=lambda anchor: np.median(residual_m[known & (result.ranges.anchor == anchor)]))
    return (
        f"tag {result.tag}: half of its ranges miss its track by more than {np.median(residual_m[known]):.2f} m "
        f"(uwb.range_std_m is {config.uwb.range_std_m} m); check [[uwb.anchors]], anchor {worst} first"
    )


def _bias_words(tag: int, bias: AnchorBias, config: Config) -> str:
    if not bias.significant.any():
        std_m = bias.std_m[bias.n > 0].max(initial=0.0)
        return (
            f"tag {tag}: ranges are not corrected by anchor biases, which this log tells from positions "
            f"only to {std_m:.2f} m (a longer walk tells more)"
        )
    links = zip(config.uwb.anchors, bias.applied_m, bias.std_m, strict=True)
    words = ", ".join(f"{anchor.id}: {applied:+.3f} +- {std:.3f}" for anchor, applied, std in links)
    return f"tag {tag}: ranges corrected by each anchor's bias in m: {words}"


def _range_warnings(counts: RangeCounts) -> list[str]:
    def words(pairs: tuple[tuple[int, int], ...]) -> str:
        return ", ".join(f"{number} ({count} ranges)" for number, count in pairs)

    causes = {
        "that are no numbers": counts.not_finite,
        "of zero or below": counts.not_positive,
        "below uwb.min_range_m": counts.too_short,
        "above uwb.max_range_m": counts.too_long,
    }
    texts = [f"{count} ranges {cause} are left out" for cause, count in causes.items() if count]
    if counts.unknown_anchors:
        texts.append(f"anchors seen, but not in [[uwb.anchors]]: {words(counts.unknown_anchors)}")
    if counts.other_tags:
        texts.append(f"tags seen, but not in [[uwb.tags]]: {words(counts.other_tags)}")
    if counts.silent_anchors:
        texts.append(f"anchors configured, but silent: {', '.join(map(str, counts.silent_anchors))}")
    return texts
