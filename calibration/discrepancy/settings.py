"""Thresholds of the selection of effects. report.json lists them under `selection_settings`."""

from collections.abc import Mapping
from dataclasses import dataclass

from scipy.stats import chi2


@dataclass(frozen=True)
class SelectionSettings:
    """Thresholds with which the loop scores, refits, accepts and compares candidate effects.

    A gain is a reduction of the whitened residual's sum of squares, divided by its mean square.
    """

    noise_floor: float = 1.5
    """Largest mean square of a channel's whitened residual that is attributed to noise. The
    model-discretisation discrepancy alone causes mean squares up to 1.3."""
    min_trials: int = 3
    """The loop does not run with fewer trials, because cross-validation needs three trials."""

    false_alarm_p: float = 1e-3
    """The loop refits a candidate only if the p-value of the candidate's score is below this value.
    This p-value (`Score.p`) is corrected for the number of candidates."""
    short_list: int = 5
    """A round refits at most this many candidates scored by tangents, as many by secants, and as
    many with shape parameters."""
    min_score_share: float = 0.5
    """The loop refits a candidate only if its score exceeds this fraction of the best score."""
    min_score_share_far: float = 0.2
    """Value of `min_score_share` for candidates that are scored with a secant (`Prior.start`) and
    for candidates with shape parameters. This value is smaller because a score from a secant or
    with the default of a shape parameter is less accurate."""
    naming_share: float = 0.7
    """The loop refits a candidate only if its predicted change of a channel exceeds this fraction
    of the channel's model-discretisation discrepancy. The fraction is below 1, because the
    prediction is linear and may be too small."""
    distant_gain_share: float = 0.5
    """A round first scores the candidates with the tangents of the round before. If every gain is
    below this fraction of `min_gain`, the selection ends. Without this rule, most selections would
    end with a computation of new tangents, which is their longest computation."""
    most_near: int = 12
    """If at most this number of candidates has a larger gain, only their tangents are computed for
    the round. All other candidates keep the tangents of the round before."""
    visible_share: float = 1e-3
    """Cross-validation omits the trials that a candidate hardly changes. A trial is used if its sum
    of squared changes is at least this fraction of the largest such sum of any trial."""
    visible_gain: float = 4.0
    """A trial is always used if its sum of squared changes, divided by the residual's mean square,
    is at least this value."""

    min_gain: float = 20.0
    """The loop adds a candidate with one fitted parameter to the model only if the candidate's gain
    exceeds this value. `least_gain` returns the value for more parameters."""
    left_out_p: float = 0.05
    """Cross-validation confirms a candidate if the p-value of a t-test on its log gains is below
    this value. The logarithm prevents one outlying trial from dominating the mean gain."""
    wilcoxon_p: float = 0.07
    """Cross-validation also confirms a candidate if the p-value of Wilcoxon's signed-rank test is
    below this value. A candidate that improves all of four trials passes, with any gains."""
    least_held_gain: float = 2.0
    """Cross-validation also confirms a candidate if its gain exceeds this value in every trial.
    With two trials, only this test is possible. Together, the three tests accept an absent effect
    in 1.0 % of the cases with two trials, 2.5 % with three and 1.7 % with four (3000 simulated
    cases each)."""

    least_rest_gain: float = 20.0
    """Cross-validation also confirms a candidate if its total gain without the trial of the largest
    gain exceeds this value, and no trial has a large loss (`most_loss_share`). A candidate that
    acts only in fast trials changes the slow trials by less than the noise. The other three tests
    then refuse the candidate, even if its gains in several fast trials are large."""
    most_loss_share: float = 0.1
    """A loss is large if it exceeds this fraction of the total gain without the best trial."""

    complete_refits: bool = False
    """Whether each candidate is refitted until the fit converges. Otherwise, candidates race on a
    coarse mesh."""
    complete_tolerance_share: float = 0.02
    """A complete refit ends if the next step would lower the sum of squares by less than this
    fraction of its gain, or of the sum of squares if that is smaller."""

    max_effects: int = 3
    """Largest number of effects that the loop adds to the model."""
    max_rounds: int = 5
    """Largest number of rounds, including rounds whose chosen effect is removed later."""
    max_swaps: int = 2
    """Largest number of replacements of a chosen effect by an alternative, in one selection."""
    max_halvings: int = 4
    """A step of the parameters that cannot be simulated is halved at most this many times."""
    initial_step_share: float = 0.02
    """A refit starts at the step that the score predicts. If the predicted step of a parameter is
    zero, the step is this fraction of the prior range, because a fit cannot leave a bound."""
    shape_factor: float = 3.0
    """A refit with a shape parameter starts from the parameter's default, from the default times
    this factor and from the default divided by this factor, inside the prior range."""
    max_estimate_steps: int = 12
    """Largest number of steps, including shortened steps, of a refit on the coarse mesh."""
    estimate_tolerance: float = 0.5
    """A refit on the coarse mesh ends if the next step would lower the sum of squares by less than
    this multiple of the residual's mean square."""
    estimate_tolerance_share: float = 0.01
    """Such a refit also ends if the next step would change its gain or its loss by less than this
    fraction. If an effect or a term is judged by the refit, this applies only to a loss."""
    hopeless_share: float = 0.5
    """A refit on the coarse mesh ends after its first step if its expected gain is below the gain
    of another fit by more than this fraction of that gain. Later steps need no such margin, because
    their expected gains are more accurate. The same fraction decides whether a candidate is
    refitted with free shape parameters."""
    removal_loss_factor: float = 10.0
    """The loop predicts the increase of the sum of squares by the removal of an effect, in units of
    the residual's mean square. If the increase exceeds this multiple of `min_gain`, the loop keeps
    the effect without a refit. The same factor applies to the loss by the default of a shape
    parameter, and ends the refit of a judged alternative with defaults early."""

    parallel_cosine: float = 0.95
    """Two effects are equivalent if |cos| between their tangents exceeds this value."""
    equal_gain_share: float = 0.95
    """A candidate is equivalent if its gain exceeds this fraction of the chosen effect's gain."""
    contender_gain_share: float = 0.8
    """After the selection, the loop compares the chosen effect with candidates that have more than
    this fraction of its gain. The fraction is low, because other missing effects can decrease the
    gain of the true effect."""

    bound_margin: float = 0.01
    """A parameter is at an edge if it is closer than this fraction of its prior range."""
    range_factor: float = 3.0
    """If a parameter of a selected effect is at an edge, the loop makes the range this many times
    as wide about the null, within the physical limits, and refits."""
    veto_growth: float = 0.05
    """The held-out trials veto an effect only if the mean of log(S1/S0) exceeds this value. S0 and
    S1 are the sums of squares without and with the effect. A correlated residual can cause a growth
    by 5 %."""
    veto_errors: float = 2.0
    """The mean must also exceed this multiple of its standard error. If the models with and without
    the effect predict equally well, the mean exceeds two standard errors in 2 % of the cases."""

    def least_gain(self, parameters: int = 1) -> float:
        """Returns the gain that an effect with this number of fitted parameters must exceed.

        Noise alone exceeds this gain as rarely as it exceeds `min_gain` for one parameter.
        """
        return float(chi2.isf(chi2.sf(self.min_gain, 1), parameters))

    def worth_naming(
        self,
        gain: float,
        sizes: Mapping[str, float],
        discrepancies: Mapping[str, float],
        parameters: int = 1,
    ) -> bool:
        """Returns whether an effect with this number of parameters exceeds the naming threshold.

        The gain must exceed `least_gain`. The change of some channel must exceed that channel's
        model-discretisation discrepancy. `sizes` are rms changes, relative to each channel's rms.
        """
        enough = gain > self.least_gain(parameters)
        return enough and any(sizes[c] > discrepancies[c] for c in sizes)


DEFAULT_SETTINGS = SelectionSettings()
