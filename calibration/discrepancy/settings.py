"""Thresholds of the selection of effects; report.json records them as `selection_settings`."""

from dataclasses import dataclass

from slider_jax.channels import CHANNELS


@dataclass(frozen=True)
class SelectionSettings:
    """Thresholds by which the loop scores, refits, accepts and compares candidate effects.

    Gains are reductions of the sum of squares, in units of the residual's mean square.
    """

    noise_floor: float = 1.5
    """Mean square of a channel's whitened residual up to which the channel is at the noise floor.
    The model-discretisation discrepancy alone gives up to 1.3."""
    min_trials: int = 3
    """Fewest trials for a selection; cross-validation needs three."""

    false_alarm_p: float = 1e-3
    """Largest probability of a score by chance, after correction for the number of candidates."""
    short_list: int = 5
    """Largest number of candidates of each kind that one round refits; it bounds the cost."""
    min_score_share: float = 0.5
    """A candidate is refitted if its score is at least this share of the best score."""
    min_score_share_far: float = 0.2
    """The same share for a candidate that is scored by a secant (`Prior.start`), because such a
    score is less accurate."""
    naming_share: float = 0.7
    """A candidate is refitted if its linear step changes some channel by this share of the naming
    threshold. Below 1, because the step is only linear."""
    visible_share: float = 1e-3
    """A trial takes part in a candidate's cross-validation if the candidate's squared change of it
    is at least this share of that of the most sensitive trial, or at least `visible_gain`."""
    visible_gain: float = 4.0
    """The squared change, in units of the residual's mean square, that suffices in any case."""

    min_gain: float = 20.0
    """A refitted candidate can be named only if its gain exceeds this."""
    left_out_t: float = 2.0
    """Threshold on the t-statistic of the cross-validated log gain, in addition to the significance
    test. Alone, it would accept 6 % of null candidates with five trials and 9 % with three. The
    average is over log gains, so that one outlying trial does not dominate."""
    wilcoxon_p: float = 0.07
    """Held-out trials also agree if the p-value of Wilcoxon's signed-rank test is below this. The
    test accepts four improvements in four trials, even if one is far larger than the others."""

    max_effects: int = 3
    """Largest number of effects in the model."""
    max_rounds: int = 5
    """Largest number of rounds, including those whose effect was removed again."""
    max_swaps: int = 2
    """Largest number of times that an alternative replaces a chosen effect."""
    max_halvings: int = 4
    """Largest number of sizes to try for a start that cannot be simulated."""
    initial_step_share: float = 0.02
    """Share of the prior range by which a refit starts away from a parameter's null if the scored
    step is zero. A fit from the null itself could not leave the bound there."""
    removal_loss_factor: float = 10.0
    """An effect is kept without a refit if the linear loss of its removal exceeds this multiple of
    `min_gain`."""

    parallel_cosine: float = 0.95
    """|cos| between two tangents above which two effects are equivalent."""
    equal_gain_share: float = 0.95
    """Share of an effect's gain above which another candidate explains as much."""
    contender_gain_share: float = 0.8
    """Share of an effect's gain above which a candidate is compared after the selection. It is
    below `equal_gain_share` because a wrong effect can explain part of another missing effect."""

    min_explained: float = 0.9
    """If a residual above the noise floor remains, effects are named only if they reduce its rms
    above the floor by this share."""
    bound_margin: float = 0.01
    """Share of the prior range from its ends within which a parameter is at a bound."""

    def worth_naming(self, gain: float, sizes: dict[str, float]) -> bool:
        """Returns whether an effect exceeds the naming threshold.

        Its gain must exceed `min_gain`. Its change of some channel must exceed that channel's
        model-discretisation discrepancy. `sizes` are the channels' rms changes as shares of their
        rms.
        """
        return gain > self.min_gain and any(sizes[c] > CHANNELS[c].discrepancy for c in sizes)


DEFAULT_SETTINGS = SelectionSettings()
