"""Thresholds of the selection of effects. report.json contains them as `selection_settings`."""

from dataclasses import dataclass

from slider_jax.channels import CHANNELS


@dataclass(frozen=True)
class SelectionSettings:
    """Thresholds with which the loop scores, refits, accepts and compares candidate effects.

    A gain is a reduction of the sum of squares, divided by the residual's mean square.
    """

    noise_floor: float = 1.5
    """Largest mean square of a channel's whitened residual that is attributed to noise. The
    model-discretisation discrepancy alone causes mean squares up to 1.3."""
    min_trials: int = 3
    """Smallest number of trials for a selection. Cross-validation needs three."""

    false_alarm_p: float = 1e-3
    """A candidate can be refitted only if its corrected p-value, `Score.p`, is below this."""
    short_list: int = 5
    """One round refits at most this many candidates scored by tangent, and as many by secant."""
    min_score_share: float = 0.5
    """A candidate can be refitted only if its score exceeds this fraction of the best score."""
    min_score_share_far: float = 0.2
    """Replaces `min_score_share` for candidates that are scored with a secant (`Prior.start`). The
    value is smaller because a score from a secant is less accurate."""
    naming_share: float = 0.7
    """A candidate can be refitted only if its linear step changes some channel by more than this
    fraction of the channel's discrepancy. It is below 1 because the step neglects nonlinearity."""
    visible_share: float = 1e-3
    """Cross-validation of a candidate uses a trial if the candidate's squared change of the trial
    reaches this fraction of the largest squared change in any trial, or reaches `visible_gain`."""
    visible_gain: float = 4.0
    """Squared change, divided by the residual's mean square, with which a trial is always used."""

    min_gain: float = 20.0
    """A refitted candidate can be named only if its gain exceeds this value."""
    left_out_t: float = 2.0
    """A candidate's cross-validated log gain must have a t-statistic above this value. Without the
    other tests, this threshold accepts 6 % of absent effects with five trials and 9 % with
    three. The logarithm prevents that one outlying trial dominates the mean gain."""
    wilcoxon_p: float = 0.07
    """Cross-validation also confirms a candidate if the p-value of Wilcoxon's signed-rank test is
    below this. A candidate that improves all of four trials passes, also with unequal gains."""

    max_effects: int = 3
    """Largest number of effects in the model."""
    max_rounds: int = 5
    """Largest number of rounds, including rounds whose effect was removed again."""
    max_swaps: int = 2
    """Largest number of times that an alternative replaces a chosen effect."""
    max_halvings: int = 4
    """A step that cannot be simulated is halved and tried again, at most this many times."""
    initial_step_share: float = 0.02
    """A refit starts at the scored step. If this step is zero, the refit starts at this distance
    from the null, as a fraction of the prior range: at a bound, a fit could not move."""
    removal_loss_factor: float = 10.0
    """An effect is kept without a refit if the linear loss of its removal exceeds this multiple of
    `min_gain`."""

    parallel_cosine: float = 0.95
    """Two effects are equivalent if |cos| between their tangents exceeds this value."""
    equal_gain_share: float = 0.95
    """A candidate with more than this fraction of the chosen effect's gain is equivalent."""
    contender_gain_share: float = 0.8
    """A candidate with more than this fraction of the chosen effect's gain is compared after the
    selection. The fraction is low because a wrong effect can explain part of another effect."""

    min_explained: float = 0.9
    """If a residual above the noise floor remains, effects are named only if they reduce the excess
    of the whitened residual's rms over 1 by at least this fraction."""
    bound_margin: float = 0.01
    """A parameter closer to a bound than this fraction of its prior range is at the bound."""

    def worth_naming(self, gain: float, sizes: dict[str, float]) -> bool:
        """Returns whether an effect exceeds the naming threshold.

        The gain must exceed `min_gain`. The change of some channel must exceed that channel's
        model-discretisation discrepancy. `sizes` are rms changes, relative to each channel's rms.
        """
        return gain > self.min_gain and any(sizes[c] > CHANNELS[c].discrepancy for c in sizes)


DEFAULT_SETTINGS = SelectionSettings()
