# %% [markdown]
# From a file to a repaired twin
#
# A logger's file with names and units of its own; discovery finds what the twin leaves out, and the repaired twin is
# simulated over driving that it has never seen. Run it as a script, or cell by cell in an editor that knows `# %%`.

# %%
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pandas as pd

import dieseltwin as dt

MINUTES = 10.0
FOLDER = Path(mkdtemp(prefix="repaired_"))
NOISE = {"p_im_pa": 3e3, "p_em_pa": 4e3, "omega_t_rad_s": 50.0, "w_egr_kg_s": 0.001, "t_em_k": 8.0, "w_c_kg_s": 0.004}

# %% [markdown]
# The machine: a boost leak of 40 mm2 behind the charge-air cooler. It is driven twice.

# %%
machine = dt.engine("we2011", A_vgtmax=8.2e-4)


def drive(minutes, seed):
    """A recording of the machine over random driving: inputs, and readings with noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 60.0 * minutes, 0.2)

    def walk(low, high, every_s):
        knots = rng.uniform(low, high, int(time_s[-1] / every_s) + 2)
        return np.interp(time_s, np.arange(knots.size) * every_s, knots)

    inputs = pd.DataFrame({
        "time_s": time_s, "n_e_rpm": walk(900, 1800, 12.0), "u_delta_mg": walk(60, 200, 8.0),
        "u_egr_pct": walk(0, 60, 10.0), "u_vgt_pct": walk(30, 80, 9.0),
    })  # fmt: skip
    readings = dt.simulate(inputs, machine, effects={"boost_leak": 4e-5}).table()
    for column, sigma in NOISE.items():
        inputs[column] = readings[column] + sigma * rng.standard_normal(len(readings))
    return inputs


# %% [markdown]
# The file as the logger wrote it, and the map that says what its channels are.

# %%
logged = drive(MINUTES, seed=1)
logged = logged.assign(p_im_pa=1e-3 * logged["p_im_pa"], t_em_k=logged["t_em_k"] - 273.15)
logged = logged.rename(columns={"time_s": "Time", "p_im_pa": "P_boost", "t_em_k": "T_exh"})
logged.to_csv(FOLDER / "log.csv", index=False)
(FOLDER / "map.yaml").write_text(
    "Time: time_s\nP_boost: {column: p_im_pa, unit: kPa}\nT_exh: {column: t_em_k, unit: degC}\n"
)

# %% [markdown]
# What the twin leaves out: where, what, how large, since when. The folder has the report and the repaired engine.

# %%
found = dt.discover(FOLDER / "log.csv", "we2011", channels=FOLDER / "map.yaml")
print(found.sentence)
print(found.table().to_string())
found.save(FOLDER / "discovery")

# %% [markdown]
# Driving that no fit has seen: how far off the published and the repaired twin are.

# %%
unseen = drive(MINUTES, seed=2)
errors = {}
for name, engine in (("published", dt.engine("we2011")), ("repaired", dt.engine(FOLDER / "discovery" / "engine.yaml"))):
    simulated = dt.simulate(unseen, engine).table()
    errors[name] = {c: float(np.sqrt(np.mean((simulated[c] - unseen[c]) ** 2))) for c in NOISE}
errors["noise"] = NOISE
print(pd.DataFrame(errors).to_string(float_format="{:.4g}".format))

# %%
dt.simulate(unseen, found.engine).plot().savefig(FOLDER / "repaired.png")
print(f"files: {FOLDER}")
