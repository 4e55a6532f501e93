"""The self-attack: `python -m tests.torture --minutes 10 --seed N`.

It attacks the installed program again and again, checks what docs/testing.md promises, prints how
often each attack was tried and held, and exits with 1 if a promise was broken or an attack was
never tried: each is tried once, however short the time. Each failing case is stored with its files
and the command that repeats it, `--case ATTACK:SEED`. A seed makes the same choices; the moment of
a kill also depends on the machine.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import secrets
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, cycle
from multiprocessing.queues import Queue
from pathlib import Path
from queue import Empty
from random import Random
from tempfile import mkdtemp
from time import monotonic
from traceback import format_exc
from typing import TypeAlias

from tests.torture import command_attacks, feature_attacks, file_attacks, process_attacks
from tests.torture.case import ROOT, Case, PromiseError, SkippedError, adopt_orphans

Attack: TypeAlias = Callable[[Case], None]
Outcome: TypeAlias = tuple[str, int, str, str]
"""Attack, seed, `held`, `broken` or `skipped`, and why."""

_STEP_S = 10.0
"""How often it is checked that the workers live."""

ATTACKS: Mapping[str, tuple[Attack, int]] = {
    "mutate": (file_attacks.mutate, 6),
    "bomb": (file_attacks.bomb, 3),
    "fuzz-logs": (file_attacks.fuzz_logs, 4),
    "fuzz-bytes": (file_attacks.fuzz_bytes, 4),
    "options": (command_attacks.options, 6),
    "names": (command_attacks.names, 2),
    "interrupt": (command_attacks.interrupt, 2),
    "terminal": (command_attacks.terminal, 2),
    "kill-live": (process_attacks.kill_live, 1),
    "kill-recorder": (process_attacks.kill_recorder, 1),
    "kill-bridge": (process_attacks.kill_bridge, 1),
    "kill-conversion": (process_attacks.kill_conversion, 1),
    "faults-live": (process_attacks.faults_of_live, 2),
    "faults-conversion": (process_attacks.faults_of_conversion, 2),
    "taken-away": (process_attacks.taken_away, 1),
    "noisy-line": (process_attacks.noisy_line, 1),
    "hostile-server": (process_attacks.hostile_server, 1),
    "power-cut": (process_attacks.power_cut, 1),
    "rotate-oldest": (feature_attacks.rotate_oldest, 2),
    "follow": (feature_attacks.follow, 1),
}
"""The attacks, and how many cases of each are in a round."""


def cases(seed: int, only: str | None) -> Iterator[tuple[str, int]]:
    """Attack and seed of each case: each attack once, and then round by round, for ever."""
    names = [only] if only else [name for name, (_, share) in ATTACKS.items() for _ in range(share)]
    Random(0).shuffle(names)
    for number, name in enumerate(chain([only] if only else ATTACKS, cycle(names))):
        digest = hashlib.sha256(f"{seed}:{number}".encode()).digest()
        yield name, int.from_bytes(digest[:4])


def play(attack: str, seed: int, keep: Path) -> Outcome:
    """Play one case; the files of a broken promise are moved to `keep`."""
    folder = Path(mkdtemp(prefix="fte-sniff-torture-"))
    case = Case(attack, seed, folder)
    try:
        ATTACKS[attack][0](case)
        outcome: Outcome = (attack, seed, "held", "")
    except SkippedError as reason:
        outcome = (attack, seed, "skipped", str(reason))
    except PromiseError as broken:
        why = str(broken).encode(errors="backslashreplace").decode()
        outcome = (attack, seed, "broken", why)
    except Exception:  # noqa: BLE001 - a mistake of the attack is reported too
        outcome = (attack, seed, "broken", f"the attack itself failed\n{format_exc()}")
    finally:
        case.close()
    if outcome[2] == "broken":
        target = keep / f"{attack}-{seed}"
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder, target, symlinks=True, ignore=_pipes)
        command = f"python -m tests.torture --case {attack}:{seed}\n"
        (target / "why.txt").write_text(f"{command}\n{outcome[3]}\n")
    shutil.rmtree(folder, ignore_errors=True)
    return outcome


def _pipes(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if Path(folder, name).is_fifo()]


def _work(
    number: int, jobs: int, arguments: argparse.Namespace, outcomes: Queue[Outcome | None]
) -> None:
    adopt_orphans()
    until = monotonic() + 60 * arguments.minutes
    for at, (attack, seed) in enumerate(cases(arguments.seed, arguments.attack)):
        if at >= (1 if arguments.attack else len(ATTACKS)) and monotonic() > until:
            break
        if at % jobs == number:
            outcomes.put(play(attack, seed, arguments.keep))
    outcomes.put(None)


def _outcomes(arguments: argparse.Namespace) -> Iterator[Outcome]:
    """Outcomes of all cases, as they come from the workers."""
    outcomes: Queue[Outcome | None] = multiprocessing.Queue()
    workers = [
        multiprocessing.Process(target=_work, args=(n, arguments.jobs, arguments, outcomes))
        for n in range(arguments.jobs)
    ]
    for worker in workers:
        worker.start()
    running = len(workers)
    while running:
        try:
            outcome = outcomes.get(timeout=_STEP_S)
        except Empty:
            if any(worker.is_alive() for worker in workers):
                continue
            raise SystemExit("a worker of the attack died") from None
        if outcome is None:
            running -= 1
        else:
            yield outcome
    for worker in workers:
        worker.join()


def table(counts: Mapping[str, Counter[str]]) -> str:
    """Tried and held cases of each attack."""
    lines = [f"{'attack':<18}{'tried':>7}{'held':>7}{'skipped':>9}"]
    for attack in ATTACKS:
        one = counts.get(attack, Counter())
        tried = one["held"] + one["broken"]
        lines.append(f"{attack:<18}{tried:>7,}{one['held']:>7,}{one['skipped']:>9,}")
    return "\n".join(lines)


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tests.torture", description="Attack fte-sniff."
    )
    parser.add_argument(
        "--minutes",
        type=float,
        default=1.0,
        help="1 by default; 0 for one of each attack",
    )
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6))
    parser.add_argument("--attack", choices=ATTACKS, help="only this attack")
    parser.add_argument("--case", metavar="ATTACK:SEED", help="repeat one case")
    parser.add_argument("--jobs", type=int, default=2, help="cases at once; 2 by default")
    parser.add_argument("--keep", type=Path, default=ROOT / "torture-failures", metavar="FOLDER")
    return parser.parse_args()


def _report(outcome: Outcome, keep: Path) -> None:
    attack, seed, _, why = outcome
    print(f"broken: {attack}:{seed}: {why.strip()}", flush=True)
    print(f"  files: {keep / f'{attack}-{seed}'}", flush=True)
    print(f"  repeat: python -m tests.torture --case {attack}:{seed}", flush=True)


def main() -> int:
    """Attack, and return the exit code."""
    arguments = _parsed()
    if arguments.case:
        adopt_orphans()
        attack, _, seed = arguments.case.partition(":")
        outcome = play(attack, int(seed), arguments.keep)
        print(*outcome[2:])
        return int(outcome[2] == "broken")
    print(f"seed {arguments.seed}, {arguments.minutes:g} minutes", flush=True)
    counts = {attack: Counter[str]() for attack in ATTACKS}
    reasons: dict[str, str] = {}
    for outcome in _outcomes(arguments):
        attack, _, result, why = outcome
        counts[attack][result] += 1
        if result == "skipped" and reasons.get(attack) != why:
            reasons[attack] = why
            print(f"skipped: {attack}: {why}", flush=True)
        elif result == "broken":
            _report(outcome, arguments.keep)
    print(table(counts))
    asked = [arguments.attack] if arguments.attack else ATTACKS
    never = [attack for attack in asked if not counts[attack]["held"] + counts[attack]["broken"]]
    if never:
        print(f"never tried: {', '.join(never)}")
    return int(bool(never) or any(one["broken"] for one in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
