"""Bad inputs through the command line: python -m benchmarks.bad_inputs [--only TEXT] [--list].

Every one must end in one line of at most 300 characters and exit code 2, without a traceback, without a file written
or changed, and within seconds. The commands run in this process; the table of what happened is printed, and the exit
code is 1 when anything else happened.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter

from benchmarks.bad_inputs.cases import cases
from benchmarks.bad_inputs.run import LIMIT_S, run


def main(arguments: list[str] | None = None) -> int:
    """Run them, print every fault and the counts; 1 when there was any."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="cases whose name contains this text")
    parser.add_argument("--list", action="store_true", help="print what every case said")
    parser.add_argument("--skip", type=int, default=0, help="leave out the first so many")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds a case may take")
    asked = parser.parse_args(arguments)
    counts: Counter[str] = Counter()
    numbers = [number for number, case in enumerate(cases()) if asked.only in case.name][asked.skip:]
    for outcome in run(numbers, asked.limit):
        counts["cases"] += 1
        counts.update(outcome.faults)
        if outcome.faults or asked.list:
            what = outcome.traceback or " | ".join(line[:200] for line in outcome.lines)
            print(f"{', '.join(outcome.faults) or 'refused'}: {outcome.name} [{outcome.seconds:.1f} s]: {what}"
                  f"{' CHANGED ' + ', '.join(name[:60] for name in outcome.changed) if outcome.changed else ''}",
                  flush=True)  # fmt: skip
    print(", ".join(f"{count} {name}" for name, count in counts.items()))
    return 0 if len(counts) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
