"""Captures under faults of the bus, drawn at random: how they end, and whether the arm is left as they say.

In turn on AX servos (protocol 1.0) and on X servos (2.0), with each way to leave the arm, one to three faults of all
kinds that the emulator has, at any time from the start to after the motion's end, some short, some to the end. A
capture has to end as "complete" or "interrupted" with an error of ours; the arm is judged by its servos' registers.

Run: python -m tests.benchmarks.capture_faults [--trials N] [--quick] [--seed N]
"""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path

from tests.benchmarks.arguments import parser, trials_of
from tests.trials.fault_trials import Verdict, try_seed


def show(verdicts: list[Verdict]) -> None:
    """Print how the captures ended, and what was wrong."""
    for title, counts in (
        ("ended", Counter(verdict.ended for verdict in verdicts)),
        ("arm left", Counter(verdict.left or "not said" for verdict in verdicts)),
    ):
        print(f"{title}: {', '.join(f'{what} {count}' for what, count in counts.most_common())}")
    wrong = [verdict for verdict in verdicts if verdict.wrong]
    print(f"{len(verdicts) - len(wrong)} of {len(verdicts)} captures ended as they have to")
    for verdict in wrong:
        print(f"  {verdict.drawn}\n    {verdict.ended}; {'; '.join(verdict.wrong)}")


def main() -> None:
    """Print the table."""
    chosen = parser(__doc__, trials=300, quick=20).parse_args()
    trials, verdicts = trials_of(chosen), []
    for seed in range(chosen.seed, chosen.seed + trials):
        with tempfile.TemporaryDirectory() as name:
            verdicts.append(try_seed(Path(name), seed))
        print(f"\r{len(verdicts)} of {trials}", end="", flush=True)
    print()
    show(verdicts)


if __name__ == "__main__":
    main()
