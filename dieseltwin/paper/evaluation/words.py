"""Headings and notes of the evaluation's page."""

from __future__ import annotations

from collections.abc import Mapping

SECTIONS: Mapping[str, tuple[str, str]] = {
    "scores": (
        "Against the paper's cells",
        "RMSE of a cell is sqrt((mean - 1)² + std²) over its members, in units of the truth. Scored are the cells whose"
        " Cramér-Rao bound is below 10 %. Ratio: geometric mean of our RMSE over the paper's, with a 95 % bootstrap"
        " interval over members. A cell with a diverged member never counts as better. The paper's driving is"
        " confidential: minute and case have the same name, not the same inputs. Multi-stage and few-shot-adam are the"
        " paper's methods, with learned maps and operators; few-shot-newton has learned bodies and exact formulae,"
        " classical nothing learned: on clean data their ratios show the accuracy of a solver, no more.",
    ),
    "parameters": (
        "Estimates",
        "Mean ± standard deviation of estimate over truth; p of the one-sample t-test that the mean is 1. Brackets:"
        " bound above 25 %, nobody can know the value there. Green: our RMSE is at most the paper's. Minute 0-1 of"
        " multi-stage is the baseline, from scratch, as in the paper.",
    ),
    "times": (
        "Run times",
        "Wall seconds of a batch over its runs, with two steps at a time on this machine; the paper's are from one core"
        " of another. Epochs differ, so compare milliseconds an epoch.",
    ),
    "learned": (
        "Learned parts",
        "Relative L2 error [%], mean ± std over trainings. Noisy: 3 % noise on the labels, errors against the"
        " clean ones. The paper prints no error of its empirical maps.",
    ),
    "calibration": (
        "Stated uncertainty",
        "On noisy data, over identifiable cells. Coverage of 90 % intervals; z: error over the stated standard"
        " deviation, whose own deviation is 1 if it is honest. Methods that state none have one interval a minute, from"
        " the spread of their members.",
    ),
    "epochs": (
        "More epochs, more error",
        "RMSE along the training on noisy data, over the minutes whose bound is below 10 %.",
    ),
    "identifiability": (
        "What each minute can tell",
        "Relative Cramér-Rao bound at the truth with the noise of the recording, also for the clean cases.",
    ),
    "variants": (
        "One thing changed",
        "Further ensembles; RMSE over the truth [%]. Last epoch: the same runs, read at their last epoch in place of"
        " the mean over the last epochs.",
    ),
}

RATIOS = (
    "One mark for each minute and case: our RMSE over that of the paper's cell of the same name. Left of the line we"
    " are closer to the truth. Open marks have a bound above 10 % and are not scored."
)
OVER_EPOCHS = (
    "Root mean square error over members and the minutes with a bound below 10 %, along the training on noisy data."
    " Where a line turns up, more epochs made it worse."
)
