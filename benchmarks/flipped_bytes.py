"""One flipped byte in every kind of file that is read back: noticed, harmless, or taken without a word.

    python benchmarks/flipped_bytes.py --flips 15

Each kind of file is written by the library itself and read by what reads it; then one byte is changed at a random
place and the file's date put back, as a disk does it, and it is read again. "harmless": what was read is the same to
the last bit. Kinds marked with a star are tables and settings of the user's own, which carry no checksum: their hash
stands in what was computed from them.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from dieseltwin.errors import InputError  # noqa: E402

Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        name: for the table.
        file: which is damaged, in the folder.
        read: from the folder; what it returns is compared by `fingerprint`.
        open: whether it carries no checksum on purpose.
    """

    name: str
    file: str
    read: Reader
    open: bool = False


def fingerprint(value: Any) -> Any:
    """Something that is equal where two values agree to the last bit."""
    if isinstance(value, np.ndarray) and value.dtype == object:  # its bytes are addresses
        return repr(value.tolist())
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, dict):
        return tuple((key, fingerprint(value[key])) for key in sorted(value, key=str))
    if isinstance(value, list | tuple):
        return tuple(fingerprint(item) for item in value)
    if hasattr(value, "model_dump_json"):
        return value.model_dump_json()
    if hasattr(value, "detach"):
        return fingerprint(value.detach().numpy())
    if hasattr(value, "to_dict") and hasattr(value, "columns"):
        return tuple((str(name), fingerprint(value[name].to_numpy())) for name in value.columns)
    if hasattr(value, "__dataclass_fields__"):
        return tuple((name, fingerprint(getattr(value, name))) for name in value.__dataclass_fields__ if name != "path")
    return repr(value)


def cheap_kinds(folder: Path) -> list[Kind]:
    """Files that are written within seconds: networks, engines, learned maps, tables, settings."""
    from dieseltwin.api.calibration import base_engine
    from dieseltwin.api.driving import engine_yaml
    from dieseltwin.engine import load_engine, we2011
    from dieseltwin.learning.belief import prior_belief
    from dieseltwin.learning.files import LearnedEngine, load_learned, save_learned
    from dieseltwin.networks.files import load_state, save_state
    from dieseltwin.networks.perceptron import MLP
    from dieseltwin.petrol.parameters import PetrolParameters, save_petrol
    from dieseltwin.recordings.channels import read_channel_map
    from dieseltwin.recordings.reader import read_recording, write_recording
    from dieseltwin.rigs.parameters import load_rig, save_rig
    from dieseltwin.sealed import sealed_text
    from dieseltwin.settings.params import default_params_path, load_params

    network = MLP([3, 16, 16, 2])
    save_state(folder / "network.pt", network.state_dict(), {"spec": network.spec(), "of": "a test"})
    (folder / "engine.yaml").write_text(engine_yaml(we2011.FIELD))
    save_petrol(PetrolParameters(), folder / "petrol.yaml")
    drive = read_recording(_reference(), sensors=())
    kept = ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s",
            "w_egr_kg_s", "t_em_k")  # fmt: skip
    frame = drive.frame()[list(kept)].iloc[:500]
    write_recording(frame, folder / "drive.csv")
    write_recording(frame, folder / "drive.parquet")
    recorded = read_recording(folder / "drive.csv")
    belief = prior_belief(we2011.PARAMETERS, 0.02)
    learned = LearnedEngine(we2011.PARAMETERS, belief, 0.02, (recorded,), {}, {recorded.sha256: 1.0})
    save_learned(learned, folder / "mine.yaml")
    (folder / "channels.yaml").write_text("MAP: {column: p_im_pa, unit: kPa}\n")
    (folder / "mine.channels.yaml").write_text(sealed_text("MAP: {column: p_im_pa, unit: kPa}\n"))
    save_rig(load_rig(_rig()), folder / "rig.yaml")
    shutil.copy(default_params_path(), folder / "params.yaml")
    columns: Reader = lambda path: dict(read_recording(path).columns)  # noqa: E731
    return [
        Kind("network (.pt)", "network.pt", lambda f: load_state(f / "network.pt")),
        Kind("repaired engine (.yaml)", "engine.yaml", lambda f: load_engine(f / "engine.yaml")),
        Kind("petrol engine (.yaml)", "petrol.yaml", lambda f: base_engine(f / "petrol.yaml")),
        Kind("rig (.yaml)", "rig.yaml", lambda f: load_rig(f / "rig.yaml")),
        Kind("channel map of `calibrate`", "mine.channels.yaml", lambda f: read_channel_map(f / "mine.channels.yaml")),
        Kind("learned engine (.yaml)", "mine.yaml", lambda f: load_learned(f / "mine.yaml")),
        Kind("learned maps (.parquet)", "mine.learned.parquet", lambda f: load_learned(f / "mine.yaml")),
        Kind("recording (.parquet)", "drive.parquet", lambda f: columns(f / "drive.parquet"), open=True),
        Kind("recording (.csv)", "drive.csv", lambda f: columns(f / "drive.csv"), open=True),
        Kind("channel map (.yaml)", "channels.yaml", lambda f: read_channel_map(f / "channels.yaml"), open=True),
        Kind("settings (.yaml)", "params.yaml", lambda f: _settings(load_params, f / "params.yaml"), open=True),
    ]


def results_kinds(folder: Path) -> list[Kind]:
    """Results of `identify` and `discover`, and members of an ensemble (.npz)."""
    import dieseltwin as dt
    from dieseltwin.discovery.verdict.document import load_discrepancy
    from dieseltwin.discovery.verdict.explain import load_details
    from dieseltwin.paper.evaluation.ensembles import load_estimates, save_estimates
    from dieseltwin.report.results import load_method

    frame = dt.read(_reference()).frame()  # type: ignore[union-attr]
    rng = np.random.default_rng(3)
    for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s"):
        frame[name] += 0.01 * frame[name].mean() * rng.standard_normal(len(frame))
    found = dt.identify(frame.iloc[:700], runs=2)
    found.save(folder / "identified")
    save_estimates(folder / "estimates.npz", found.found.segments)
    count = len(found.found.segments)
    dt.discover(frame).save(folder / "discovered")
    return [
        Kind("identification.json", "identified/identification.json", lambda f: _method(load_method, f)),
        Kind("runtime.json", "identified/runtime.json", lambda f: _method(load_method, f)),
        Kind("states.parquet", "identified/states.parquet", lambda f: _method(load_method, f)),
        Kind("members (.npz)", "estimates.npz", lambda f: load_estimates(f / "estimates.npz", [0.0] * count)),
        Kind("discrepancy.json", "discovered/discrepancy.json", lambda f: load_discrepancy(f / "discovered")),
        Kind("details.json", "discovered/details.json", lambda f: load_details(f / "discovered")),
    ]


def points_kinds(folder: Path) -> list[Kind]:
    """Engines calibrated and repaired on settled points, with what stands beside them."""
    import pandas as pd

    import dieseltwin as dt
    from dieseltwin.calibration.saved import base_and_geometry, load_repaired

    trace = pd.read_csv(_reference())
    names = ["n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s",
             "t_em_k", "w_c_kg_s"]  # fmt: skip
    points = trace.loc[::10, names].assign(p_amb_pa=1.011e5, t_amb_k=298.46)
    dt.calibrate(points, "we2011").save(folder / "calibrated.yaml")
    dt.discover(points, "we2011").save(folder / "points")
    return [
        Kind("calibrated engine (.yaml)", "calibrated.yaml", lambda f: base_and_geometry(f / "calibrated.yaml")),
        Kind("its sidecar (.json)", "calibrated.calibration.json",
             lambda f: base_and_geometry(f / "calibrated.yaml")),
        Kind("repaired.yaml", "points/repaired.yaml", lambda f: load_repaired(f / "points/repaired.yaml")),
        Kind("its sidecar (.steady.json)", "points/repaired.steady.json",
             lambda f: load_repaired(f / "points/repaired.yaml")),
    ]  # fmt: skip


def challenge_kinds(folder: Path) -> list[Kind]:
    """A benchmark's manifest, recording and sealed answers."""
    from dieseltwin.challenge.make import make_challenge
    from dieseltwin.challenge.run import read_manifest
    from dieseltwin.challenge.score import verified_answers

    make_challenge(folder / "bench", 1, 5, duration_s=120.0)
    case = read_manifest(folder / "bench")["cases"][0]["case"]

    def read(f: Path) -> object:
        manifest = read_manifest(f / "bench")
        return manifest, list(verified_answers(f / "bench", manifest))

    return [
        Kind("challenge manifest", "bench/manifest.json", read),
        Kind("challenge recording", f"bench/{case}/recording.csv", read),
        Kind("sealed answers", f"bench/sealed/{case}.json", read),
        Kind("seal's salt", "bench/sealed/salt.hex", read),
    ]


def score_kinds(folder: Path) -> list[Kind]:
    """What `challenge run` and `challenge score` keep of a case, and read again for the curve."""
    from dieseltwin.challenge.curve import place_of
    from dieseltwin.challenge.make import make_challenge
    from dieseltwin.challenge.run import read_manifest, run_challenge
    from dieseltwin.challenge.score import score_challenge, write_score
    from dieseltwin.engine import load_engine
    from dieseltwin.sealed import read_json

    bench = folder / "own"
    make_challenge(bench, 1, 5, duration_s=120.0, tier="own-engine", reference_min=3.0)
    run_challenge(bench)
    write_score(score_challenge(bench), bench, figures=False)
    result = f"own/results/{read_manifest(bench)['cases'][0]['case']}"
    place: Reader = lambda f: place_of(f / "own")  # noqa: E731
    return [
        Kind("score.json", "own/score/score.json", place),
        Kind("rows.json", "own/score/rows.json", place),
        Kind("runtime.json of a case", f"{result}/runtime.json",
             lambda f: read_json(f / result / "runtime.json", "a file of `challenge run`", "run it again")),
        Kind("engine of a case (.yaml)", f"{result}/engine.yaml", lambda f: load_engine(f / result / "engine.yaml")),
    ]  # fmt: skip


def rig_kinds(folder: Path) -> list[Kind]:
    """What `discover` writes of a rig."""
    import dieseltwin as dt
    from dieseltwin.discovery.verdict.document import load_discrepancy
    from dieseltwin.discovery.verdict.explain import load_details
    from dieseltwin.rigs.parameters import RigParameters, load_rig, save_rig
    from tests.rigs.test_rig_files import TANK, emptying

    save_rig(RigParameters.model_validate(TANK), folder / "tank.yaml")
    table = emptying(0.55)
    table["level"] += 0.002 * np.random.default_rng(1).standard_normal(len(table))
    dt.discover(table, folder / "tank.yaml").save(folder / "tank")
    return [
        Kind("rig's engine.yaml", "tank/engine.yaml", lambda f: load_rig(f / "tank/engine.yaml")),
        Kind("rig's details.json", "tank/details.json",
             lambda f: [load_details(f / "tank")[key] for key in ("options", "candidates", "rounds")]),
        Kind("rig's discrepancy.json", "tank/discrepancy.json", lambda f: load_discrepancy(f / "tank")),
    ]  # fmt: skip


def kept_kinds(folder: Path) -> list[Kind]:
    """An engine's history, documents of the page, and compiled kernels."""
    from dieseltwin import kernel_cache
    from dieseltwin.app.kept import KeptRecording, load, save
    from dieseltwin.learning.alarm import Score
    from dieseltwin.learning.history import Entry, History

    history = History(folder / "history", "e" * 64)
    for day in range(1, 4):
        score = Score("boost_leak", "intake", "m2", 1e-5, True, 2e-6, 3e-6, np.arange(40.0))
        history.add(Entry(f"{day:064x}", f"2026-03-0{day}.csv", f"2026-03-0{day}T00:00:00+00:00", "name", 0.5, 1.01e5,
                          298.0, np.arange(4.0), np.eye(4), np.ones(4), np.ones(4), (score,), "healthy", "healthy"))
    kept = KeptRecording(id="a" * 16, name="drive.csv", file="drive.csv", size=5, added="2026-03-01")
    save(kept, folder / "about.json")
    kernels = folder / "kernels"
    kernels.mkdir()
    (kernels / "_integrate.nbc").write_bytes(b"\x80\x05" + np.random.default_rng(1).bytes(200_000) + b".")
    kernel_cache.drop_broken(kernels)
    known = {path: path.read_bytes() for path in kernels.glob("*.json")}

    def document(f: Path) -> object:
        found = load(KeptRecording, f / "about.json")
        if found is None:
            raise InputError("about.json", "other content", "as written", "made again")
        return found

    def kernel(f: Path) -> object:
        for path, content in known.items():  # as they were when the kernel was whole
            path.write_bytes(content)
        kernel_cache.drop_broken(f / "kernels")
        path = f / "kernels" / "_integrate.nbc"
        if not path.exists():
            raise InputError("kernel", "other content", "as written", "compiled again")
        return path.read_bytes()

    return [
        Kind("history (.sqlite)", "history/history.sqlite", lambda f: History(f / "history").entries()),
        Kind("document of the page", "about.json", document),
        Kind("compiled kernel (.nbc)", "kernels/_integrate.nbc", kernel),
    ]


def cache_kinds(folder: Path) -> list[Kind]:
    """Cached results of the pipeline."""
    from tasks.store import Store

    store = Store(folder / "cache")
    with store.writing("step", "key", {"inputs": {}}) as partial:
        (partial / "numbers.json").write_text('{"value": 1.5}\n')
    name = "cache/step/key"

    def read(f: Path) -> object:
        found = Store(f / "cache").find("step", "key")
        if found is None:
            raise InputError("cache", "another content", "the manifest's", "computed again")
        return (found.path / "numbers.json").read_bytes()

    return [Kind("cached result", f"{name}/numbers.json", read), Kind("cache manifest", f"{name}/manifest.json", read)]


GROUPS: dict[str, Callable[[Path], list[Kind]]] = {
    "cheap": cheap_kinds, "results": results_kinds, "points": points_kinds, "challenge": challenge_kinds,
    "score": score_kinds, "rig": rig_kinds, "kept": kept_kinds, "cache": cache_kinds,
}  # fmt: skip


def _reference() -> Path:
    return Path(__file__).resolve().parents[1] / "tests" / "reference" / "field_random_300s.csv"


def _rig() -> Path:
    return sorted((Path(__file__).resolve().parents[1] / "examples" / "rigs").glob("*.yaml"))[0]


def _settings(load: Callable[..., Any], path: Path) -> object:
    return load(path, "quick").model_dump(exclude={"sha256"})


def _method(load: Callable[[Path], Any], folder: Path) -> object:
    found = load(folder / "identified")
    return found.pooled, found.segments, found.runs, found.states, found.runtime


def flipped(path: Path, rng: np.random.Generator) -> str:
    """Change one byte of a file; returns where and how."""
    content, date = bytearray(path.read_bytes()), path.stat().st_mtime_ns
    at, change = int(rng.integers(len(content))), 1 << int(rng.integers(8))
    if rng.random() < 0.5:
        change = int(rng.integers(1, 256))
    content[at] ^= change
    path.write_bytes(bytes(content))
    os.utime(path, ns=(date, date))
    return f"byte {at} of {len(content)}, {content[at] ^ change:#04x} -> {content[at]:#04x}"


def judged(kind: Kind, folder: Path, flips: int, rng: np.random.Generator) -> Iterator[tuple[str, str]]:
    """What became of each flip: its end and, where that is no good one, its place."""
    path = folder / kind.file
    whole, date = path.read_bytes(), path.stat().st_mtime_ns
    before = fingerprint(kind.read(folder))
    for _ in range(flips):
        where = flipped(path, rng)
        try:
            same = fingerprint(kind.read(folder)) == before
            end = "harmless" if same else "silent"
        except InputError as error:
            end, where = "noticed", f"{where}: {error}"
        except Exception as error:  # what is looked for
            end, where = "traceback", f"{where}: {type(error).__name__}: {error}"
        path.write_bytes(whole)
        os.utime(path, ns=(date, date))
        yield end, where


def main() -> None:
    """Print a table, and every flip that was silent or ended in a traceback."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flips", type=int, default=15, help="of each kind of file")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--groups", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    total: Counter[str] = Counter()
    print(f"{'kind':<28} {'flips':>5} {'noticed':>7} {'harmless':>8} {'silent':>6} {'traceback':>9}")
    for group in arguments.groups:
        folder = Path(tempfile.mkdtemp(prefix="flipped-"))
        try:
            for kind in GROUPS[group](folder):
                found = list(judged(kind, folder, arguments.flips, rng))
                ends = Counter(end for end, _ in found)
                total += Counter({} if kind.open else ends)
                print(f"{kind.name + ('*' if kind.open else ''):<28} {len(found):>5} {ends['noticed']:>7} "
                      f"{ends['harmless']:>8} {ends['silent']:>6} {ends['traceback']:>9}", flush=True)  # fmt: skip
                for end, where in found:
                    if end == "traceback" or (end == "silent" and not kind.open):
                        print(f"    {end}: {where}"[:300])
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    print(f"{'all without a star':<28} {sum(total.values()):>5} {total['noticed']:>7} {total['harmless']:>8} "
          f"{total['silent']:>6} {total['traceback']:>9}")


if __name__ == "__main__":
    main()
