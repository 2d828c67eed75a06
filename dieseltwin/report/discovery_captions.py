"""The words under the figures of a discovery: what is drawn, how to read it, what a bad picture would mean."""

from __future__ import annotations

from dieseltwin.report.captions import line

MINIMUM = line("""
    The smallest size of each effect that this recording could show (half of such recordings do), in multiples of its
    tolerance (the smallest size of interest); known before anything is fitted, from the inputs, the noise and the
    tolerances of the maps. Left of the dashed line the recording is sharper than needed; right of it an effect of
    interest can stay unseen. An effect that is not reported may still be there below its mark; in brackets: the health
    parameter that it then moves most, and by how much. Longer driving moves most marks to the left.
""")

EVIDENCE_TIME = line("""
    Log-likelihood that the found term gains in each stretch of time; bars below zero are chance. The line is the sum so
    far: a straight climb means that the effect is always there, a kink that it begins, a stair that it shows in some
    driving only. Grey: the part that the held-out score is taken on.
""")
EVIDENCE_MAP = line("""
    The same evidence over the operating map, mean per sample in each cell: engine speed and load, the two actuators.
    Empty cells were never visited. Box: the region that holds most of the evidence, with its share.
""")

RESIDUAL_TIME = line("""
    Measured minus predicted in standard deviations of the noise, averaged over stretches of {width} s. The raw
    difference shows nothing: an effect that ruins the health parameters moves it by a fraction of the noise. Grey band:
    where 95 % of the averages lie if only noise is left. Structure before (orange) that is gone after (blue) is
    what the repair explains; blue that leaves the band again and again is what still isn't explained.
""")
RESIDUAL_TIME_HEALTHY = line("""
    Measured minus predicted in standard deviations of the noise, averaged over stretches of {width} s. Grey band: where
    95 % of the averages lie if only noise is left. What the tolerances of maps and sensors may explain is
    taken out.
""")
RESIDUAL_MAP_HEALTHY = line("""
    The same residuals averaged over cells of the operating map and divided by what noise alone leaves of the average:
    chance gives about ±2. What the tolerances of maps and sensors may explain is taken out. The number over each panel
    is the mean square of its cells; noise alone gives 1.
""")
RESIDUAL_MAP = line("""
    The same residuals averaged over cells of the operating map and divided by what noise alone leaves of the average:
    chance gives about ±2. One column a channel. A pattern in the upper row that fades in the lower one is missing
    physics that the repair accounts for; one that stays says that the law, or its place, is not right yet. What the
    tolerances of maps and sensors explain beside the repair is taken out of both rows. The number over each panel is
    the mean square of its cells; noise alone gives 1.
""")

LAW = line("""
    The found law over its main argument with its 90 % band. Points: what the recording says without the law, the term
    freed in bins of the argument (bars: one standard deviation, neighbours go together). The law is right where the
    points follow it; it claims nothing outside the curve.
""")

HEALTH = line("""
    Health parameters in the fit without the found term (hollow) and with it (filled, bar: 90 % interval). The arrow is
    what the missing physics had done to the twin's judgement of the engine's health.
""")
HEALTH_HEALTHY = "Health parameters of the fit (bar: 90 % interval); nothing had to be repaired."

SCORE = line("""
    Left: negative log-likelihood per sample on driving that was held out, lower is better. Right: root mean
    square of each channel's residual in standard deviations of its noise; 1 is what noise alone leaves. Small steps
    here go with large shifts of the health parameters: a good-looking fit proves nothing.
""")

CANDIDATES = line("""
    Log-likelihood that each effect gains over the health parameters alone, everything refitted (logarithmic). Blue: in
    the document; light blue: cannot be told from it; grey: weighed and dropped. Beside the bars: the gain, how far
    behind the best one it is (less than {apart} can't be told apart), and the fitted size. The table says why.
""")
