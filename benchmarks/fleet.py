"""From the measured cost of one engine to a fleet of 100,000 a day: cores, memory, storage, network.

``python benchmarks/fleet.py`` prints the tables of docs/fleet.md from ``MEASURED``; ``--measure`` measures what can be
measured in two minutes first (identification and the start of a process; discovery costs a minute a recording:
``make discover``, then ``.cache/discover/*/step/runtime.json``).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DAY_S = 86_400.0


@dataclass(frozen=True)
class Costs:
    """What one unit costs on one core; each with the command it comes from in docs/fleet.md.

    Attributes:
        classical_s: CPU seconds of one start on one minute of driving.
        discovery_s: CPU seconds for 10 minutes of driving, without the report; discovery_mib: its resident memory.
        identification_mib: resident memory while identifying.
        start_s: CPU seconds until a step's process computes (imports, compiled kernels from the cache).
        step_s: CPU seconds of Prefect and this project's cache for one step, server included.
        record_s: CPU seconds to log one MLflow run of some 80 metrics to sqlite.
        minute_bytes: a minute at 5 Hz, 13 columns: CSV, Parquet as it is, Parquet of 12-bit integers.
        verdict_bytes: discrepancy.json with the engine file.
    """

    classical_s: float = 0.065
    discovery_s: float = 8.5
    discovery_mib: float = 500.0
    identification_mib: float = 400.0
    start_s: float = 2.2
    step_s: float = 0.35
    record_s: float = 0.032
    minute_bytes: tuple[float, float, float] = (68_800.0, 30_600.0, 8_200.0)
    verdict_bytes: float = 5_400.0


MEASURED = Costs()


@dataclass(frozen=True)
class Plan:
    """What is done with one engine's day.

    Attributes:
        minutes: identified minutes a day; starts: of each.
        recordings: discoveries (10 minutes each) a day.
        driven_minutes: sent and kept.
    """

    name: str
    minutes: float
    starts: int
    recordings: float
    driven_minutes: float


PLANS = (
    Plan("watch: 5 good minutes, discovery weekly", 5, 3, 1 / 7, 15),
    Plan("daily: 5 good minutes, discovery daily", 5, 3, 1, 15),
    Plan("all 8 h: every minute, discovery of an hour", 480, 1, 6, 480),
)


def arithmetic(plan: Plan, costs: Costs, engines: int, *, busy: float, batch: int) -> dict[str, float]:
    """Cores, memory [GiB], storage and network for a fleet.

    Args:
        busy: share of a day that cores really compute; batch: engines that share one step (one process).
    """
    identify_s = plan.minutes * plan.starts * costs.classical_s
    discover_s = plan.recordings * costs.discovery_s
    overhead_s = (costs.start_s + costs.step_s) / batch
    total_s = identify_s + discover_s + overhead_s
    cores = engines * total_s / DAY_S / busy
    sent = engines * plan.driven_minutes * costs.minute_bytes[2]
    return {
        "identify_cpu_s": identify_s,
        "discover_cpu_s": discover_s,
        "overhead_cpu_s": overhead_s,
        "cores": cores,
        "memory_gib": cores * max(costs.discovery_mib, costs.identification_mib) / 1024.0,
        "sent_gb_a_day": sent / 1e9,
        "network_mbit_s": 8.0 * sent / DAY_S / 1e6,
        "kept_tb_a_year": 365.0 * (sent + engines * costs.verdict_bytes) / 1e12,
        "steps_a_second": engines / batch / DAY_S,
        "record_hours": engines * costs.record_s / 3600.0,
    }


def false_reports(engines: int, healthy: float, alarm: float, discoveries: float) -> float:
    """Healthy engines that raise an alarm in a day, if alarms were independent of each other."""
    return engines * healthy * alarm * discoveries


def measured(costs: Costs) -> Costs:
    """The costs that two minutes can tell, of this machine."""
    code = "import dieseltwin.identification.maximum_likelihood, pandas, pyarrow"
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    start_s = time.perf_counter() - began
    sys.path.insert(0, str(ROOT))
    from dieseltwin.identification.identify import identify_segments
    from tasks import identify as methods
    from tasks.settings import load_settings, own_settings

    own = own_settings(load_settings("quick"), "classical")
    own["identify"]["minutes"] = 20.0
    problems, _ = methods.problems_of(ROOT / "data" / "field", own)
    config = methods._config(own)
    identify_segments(problems[:1], "classical", 1, 0, config=config)
    began = time.process_time()
    identify_segments(problems, "classical", 3, 1, config=config)
    classical_s = (time.process_time() - began) / len(problems) / 3
    print(f"measured here: classical {classical_s:.4f} CPU s a minute and start, a process starts in {start_s:.1f} s")
    return replace(costs, classical_s=classical_s, start_s=start_s)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measure", action="store_true", help="measure identification and process start first")
    parser.add_argument("--engines", type=int, default=100_000)
    parser.add_argument("--busy", type=float, default=0.6, help="share of the day that cores compute")
    parser.add_argument("--batch", type=int, default=1, help="engines a step; the flows have one")
    chosen = parser.parse_args()
    costs = measured(MEASURED) if chosen.measure else MEASURED
    tables = [arithmetic(plan, costs, chosen.engines, busy=chosen.busy, batch=chosen.batch) for plan in PLANS]
    print(f"\n{chosen.engines:,} engines a day, cores busy {chosen.busy:.0%}, {chosen.batch} engines a step\n")
    print("| | " + " | ".join(plan.name for plan in PLANS) + " |")
    print("|---|" + "---|" * len(PLANS))
    for key in tables[0]:
        print(f"| {key} | " + " | ".join(f"{table[key]:.3g}" for table in tables) + " |")
    print()
    for alarm in (0.02, 0.005):
        count = false_reports(chosen.engines, 0.97, alarm, PLANS[1].recordings)
        print(f"false alarms {alarm:.1%}, discovery daily: {count:,.0f} healthy engines a day")
    return 0


if __name__ == "__main__":
    sys.exit(main())
