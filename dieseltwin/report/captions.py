"""The words under the figures: what is drawn, how to read it, and what a bad picture would mean."""

from __future__ import annotations


def line(text: str) -> str:
    """A text of several lines as one."""
    return " ".join(text.split())


VIOLINS = line("""
    Each dot is one run, divided by {centre}; the horizontal stroke is the segment's estimate, the vertical bar at its
    left end the stated 90 % interval. Grey: ±7.5 %. Violins end at the smallest and largest run; where all runs
    agree, one larger dot stands for them and only the interval shows the uncertainty. Numbers with an arrow count
    runs outside the panel.
""")
CENTRE_TRUTH = "the true value"
CENTRE_POOLED = "the pooled estimate of the first method (the truth is not known)"

VIOLINS_CLOSE = line("""
    The same as above with each axis fitted to the sharpest method (the ±7.5 % band is wider than most panels).
    Vertical bars: stated 90 % intervals{expectation}. Numbers with an arrow count runs outside the panel.
""")
EXPECTATION = ", which should hold the dashed line in nine cases of ten"

BOUND_KNOWN = line("""
    Filled: root-mean-square error of the runs against the truth; hollow: the standard deviation that the method states.
""")
BOUND_UNKNOWN = "Hollow: the standard deviation that the method states."
BOUND = line("""
    {marks} 1 is the smallest standard deviation that any unbiased method can have with this noise. An efficient and
    honest method has hollow marks near 1 and filled marks below about 2, many of them below 1 (all runs see one noise
    draw); filled marks far above the hollow ones are a bias that the method does not admit. Marks below 0.1 are drawn
    at 0.1. Segments where a parameter is not identifiable are left out.
""")
TOO_SURE = line("""
    {label} states well below the bound for {places}: no unbiased method can be that sure, so its intervals are too
    narrow there.
""")

IDENTIFIABILITY = line("""
    Smallest relative standard deviation that any unbiased method can reach in each segment (Cramér–Rao bound, four
    parameters and three initial states free). Hatched: too large, the method says “not identifiable here”, and the
    segment is left out of the pooled value. The remedy is other driving (an open EGR valve for A_egrmax, load for
    h_tot), not another method.
""")

STATES = "The states that the methods estimate. x_r and T_1 are never measured: they follow from the model."
FLOWS = line("""
    Mass flows and gas temperatures that follow from the estimated states and parameters, with the learned maps and
    actuators where a method had these.
""")
EMPIRICAL = line("""
    The six empirical maps of the engine model along the estimated states, as the method had them: the formulae, or
    learned maps, whose bands hold the spread of their members or of their dropout.
""")
SEGMENTS = "Dotted lines separate the segments, each of which is estimated on its own."
ERRORS = line("""
    Below each quantity: estimate minus truth in % of the true signal's mean over the identified part; note its scale.
""")
BLIND = line("""
    Hatched: a segment in which some parameter is not identifiable; its bands don't count for the scale.
""")

RESIDUALS = line("""
    Measured minus predicted, divided by the standard deviation of the sensor's noise (σ). If the model and the noise
    level are right, the dots fill the grey band evenly, the histogram follows the black curve (std 1) and the
    autocorrelation stays inside its grey band. A wave over time or a slowly falling autocorrelation means that the
    model misses something; a std below 1 means that the noise is overstated or fitted.
""")
WHITE = "They look like the sensors' noise: no channel stands out in spread or in correlation."
ODD = {
    "large": "More scatter than the noise in {channels}: the model misses something there, or the noise is larger.",
    "small": "Less scatter than the noise in {channels}: it is overstated, or the fit follows it.",
    "coloured": "Not white in {channels}: neighbouring residuals go together, so something slow is missing.",
}

CONVERGENCE = line("""
    The loss, and the four unknowns by segment; bands span the smallest and the largest run. Named loss terms are
    without their self-adaptive weights. A parameter that still moves at the last epoch has not converged, whatever
    the loss says.
""")

SUMMARY = line("""
    Each method's value pools the segments where the parameter is identifiable, weighted by their certainty. {ratio}
    Seconds per run: wall time of one start on one segment.
""")
BESIDE_TOLERANCES = line("""
    The intervals above are statements about noise: no map and no sensor is exact, and their errors move all estimates
    together. Here all are fitted beside what is believed of these errors. Compare these with a limit, a data sheet,
    another engine or another day; by those above even segments of one recording differ by more than they state.
""")
SUMMARY_KNOWN = line("""
    “Error over bound”: root mean square over the identifiable segments and their runs of (estimate − truth) divided by
    the segment's Cramér–Rao bound; an efficient method scores about 1.
""")
SUMMARY_UNKNOWN = line("""
    “Std over bound”: root mean square over the identifiable segments of the stated standard deviation divided by the
    segment's Cramér–Rao bound; an efficient method scores about 1.
""")
