# %% [markdown]
# From a recording to health parameters
#
# An engine with a sooted EGR valve and worn injectors is driven; its noisy recording is all that the twin gets. Run it
# as a script, or cell by cell in an editor that knows `# %%`.

# %%
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pandas as pd

import dieseltwin as dt

MINUTES = 10.0
FOLDER = Path(mkdtemp(prefix="health_"))

# %% [markdown]
# The recording: slow random driving at 5 Hz, and sensors with the noise that the paper assumes.

# %%
rng = np.random.default_rng(7)
time_s = np.arange(0.0, 60.0 * MINUTES, 0.2)


def walk(low, high, every_s):
    """Levels drawn every few seconds, joined by ramps."""
    knots = rng.uniform(low, high, int(time_s[-1] / every_s) + 2)
    return np.interp(time_s, np.arange(knots.size) * every_s, knots)


inputs = pd.DataFrame({
    "time_s": time_s, "n_e_rpm": walk(800, 1900, 12.0), "u_delta_mg": walk(40, 220, 8.0),
    "u_egr_pct": walk(5, 70, 10.0), "u_vgt_pct": walk(30, 75, 9.0),
})  # fmt: skip
worn = dt.engine("we2011", A_egrmax=3.2e-4, eta_sc=1.02)
readings = dt.simulate(inputs, worn).table()
drive = inputs.copy()
NOISE = {"p_im_pa": 0.03, "p_em_pa": 0.03, "omega_t_rad_s": 0.01, "w_egr_kg_s": 0.05, "t_em_k": 0.03, "w_c_kg_s": 0.03}
for column, share in NOISE.items():
    drive[column] = readings[column] + share * readings[column].mean() * rng.standard_normal(len(readings))
drive.to_parquet(FOLDER / "drive.parquet", index=False)

# %% [markdown]
# What the recording says: each parameter with its standard deviation and its 90 % interval.

# %%
recording = dt.read(FOLDER / "drive.parquet")
health = dt.identify(recording, "we2011")
print(health)

# %%
truth = {name: getattr(worn, name) for name in health.table().index}
compared = health.table()[["mean", "std"]].assign(truth=truth)
compared["off_by_std"] = (compared["mean"] - compared["truth"]) / compared["std"]
print(compared.to_string(float_format="{:.4g}".format))

# %% [markdown]
# How well the twin follows the readings, and the files that `dieseltwin identify` would have written.

# %%
health.plot("states").savefig(FOLDER / "states.png")
health.save(FOLDER / "result")
print(f"files: {FOLDER}")
