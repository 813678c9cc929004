"""Figures of an animal's axial force balance."""

import numpy as np

from calibration.lamprey.axial_balance import BASE_EFFECTS, central_interval
from calibration.lamprey.balance import BalanceAnalysis
from slider_jax.io.figures import new_figure

SOURCE_LABELS = {
    "strides": "differences between strides",
    "reading": "tracing noise and smoothing",
    "shape": "depth of body and tail",
    "coefficients": "C_d and m_a",
    "all together": "all sources together",
}


def body_figure(x: BalanceAnalysis):
    """Draws smoothed midlines and measured points of the last stride, and the body's size."""
    from matplotlib import colormaps

    figure, (left, right) = new_figure(1, 2, figsize=(10, 3.6), width_ratios=(2, 1))
    t, (begin, end) = x.motion.t, x.strides.marks[-2:]
    shown = np.flatnonzero((t >= begin) & (t <= end))[::2]
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(shown)))
    for colour, i in zip(colours, shown, strict=True):
        left.plot(*(1e3 * x.midlines.points[i].T), ".", color=colour, ms=3)
        left.plot(*(1e3 * x.motion.r[i].T), "-", color=colour, lw=1.0)
    left.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
    left.set_title("last stride: measured points, smoothed lines", loc="left", fontsize="medium")
    body = x.prescribed.body
    ahead = 1e3 * (x.motion.length - np.asarray(body.structure.s))
    right.plot(ahead, 1e3 * body.structure.height, label="depth (assumed)")
    right.plot(ahead, 1e3 * body.width, label="width (2 x file)")
    right.set(xlabel="distance from the snout (mm)", ylabel="size (mm)", ylim=(0.0, None))
    right.legend(fontsize="small")
    return figure


def strides_figure(x: BalanceAnalysis):
    """Draws the mean forces and the momentum gained per time of every stride."""
    figure, axis = new_figure(figsize=(9, 3.6))
    number = np.arange(1, x.strides.number + 1)
    reactive = 1e3 * x.m_a * x.forces.unit[BASE_EFFECTS[0]]
    drag = 1e3 * x.C_d * x.forces.unit[BASE_EFFECTS[1]]
    for offset, values, name in (
        (-0.3, reactive, f"reactive force, m_a = {x.m_a:g}"),
        (-0.1, drag, f"axial part of the normal drag, C_d = {x.C_d:g}"),
        (0.1, 1e3 * x.forces.gain, "momentum gained per time"),
        (0.3, 1e3 * x.imbalance, "imbalance"),
    ):
        axis.bar(number + offset, values, 0.2, label=name)
    axis.axhline(0.0, color="k", lw=0.6)
    axis.set(xlabel="stride", ylabel="mean axial force (mN)", xticks=number)
    axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def imbalance_figure(x: BalanceAnalysis):
    """Draws the intervals of the imbalance for each source of uncertainty and for all sources."""
    figure, axis = new_figure(figsize=(9, 2.8))
    rows = dict(x.by_source) | {"all together": central_interval(x.samples.imbalance)}
    for place, (name, (low, high)) in enumerate(rows.items()):
        colour = "C3" if name == "all together" else "C0"
        axis.plot([1e3 * low, 1e3 * high], [place, place], color=colour, lw=6, alpha=0.6)
    axis.axvline(1e3 * x.imbalance.mean(), color="k", lw=1.0, label="paper's coefficients")
    axis.axvline(0.0, color="k", lw=1.0, ls=":", label="balance")
    axis.set(xlabel="imbalance (mN), 95 % intervals", yticks=range(len(rows)))
    axis.set_yticklabels([SOURCE_LABELS[name] for name in rows])
    axis.margins(x=0.08)
    axis.invert_yaxis()
    axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
