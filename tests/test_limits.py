"""No test has a limit in seconds: how fast and how busy the machine is decides nothing.

A wait ends after `waiting.BOUND_S` alone; costs are compared by `cost.py`; speed is measured in
`benchmarks/`. These rules find what would break that, with a reason for each. They also find
programs, threads and servers that could outlive a test or hold it up: `beside.py` starts those.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PROCESSOR_TIME = frozenset(
    {"process_time", "process_time_ns", "thread_time", "thread_time_ns", "perf_counter"}
    | {"perf_counter_ns", "timeit", "ru_utime", "ru_stime", "RLIMIT_CPU"}
)
CLOCKS = frozenset({"monotonic", "monotonic_ns", "time", "time_ns"})
WAITS = frozenset(
    {"run", "communicate", "wait", "join", "result", "acquire", "wait_for", "settimeout", "timeout"}
    | {"check_output", "check_call", "call"}
)
LONGEST_STEP_S = 1
"""A shorter wait is a step of a loop."""
STARTERS = frozenset({"Popen", "Thread", "Timer", "create_server"})
"""What starts something that may never end."""
BESIDE = frozenset({"beside.py", "cli/forked.py"})
COST_HELPERS = frozenset({"cost.py", "cli/forked.py", "torture/case.py", "torture/costs.py"})
"""They compare processor times with each other."""


def limits_in(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of each limit in seconds of a module."""
    elapsed = _elapsed_names(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            for compare in ast.walk(node.test):
                if isinstance(compare, ast.Compare) and _limits_time(compare, elapsed):
                    yield node.lineno, "an upper limit of elapsed time"
        elif isinstance(node, ast.Call) and _name(node.func) in WAITS:
            given = [*node.args[:1], *(k.value for k in node.keywords if k.arg == "timeout")]
            if any(_is_seconds(value) for value in given):
                yield node.lineno, "a wait that does not end with waiting.BOUND_S"
        elif isinstance(node, ast.Assign) and "BOUND_S" in map(_name, node.targets):
            yield node.lineno, "a bound that is not waiting.BOUND_S"


def processor_times_in(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and name of each use of processor time."""
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.ImportFrom) else []
        if isinstance(node, ast.Attribute):
            names = [node.attr]
        for name in PROCESSOR_TIME.intersection(names):
            yield node.lineno, f"{name}: compare with cost.grows_linearly, or measure in benchmarks"


def endless_waits_in(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and reason of each thing that may run, or hold up a test, for ever."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        given = [*node.args, *node.keywords]
        if _name(node.func) in STARTERS:
            yield node.lineno, f"{_name(node.func)}: beside.py starts it"
        elif _name(node.func) in ("join", "communicate") and not given:
            yield node.lineno, "a wait without waiting.BOUND_S"


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _is_seconds(node: ast.expr) -> bool:
    value = node.value if isinstance(node, ast.Constant) else None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and value >= LONGEST_STEP_S


def _is_elapsed(node: ast.expr, elapsed: set[str]) -> bool:
    """Whether an expression has a difference to a clock, or a name of one."""
    for part in ast.walk(node):
        if isinstance(part, ast.BinOp) and isinstance(part.op, ast.Sub):
            calls = [one for one in ast.walk(part) if isinstance(one, ast.Call)]
            if any(_name(call.func) in CLOCKS and not call.args for call in calls):
                return True
        if isinstance(part, ast.Name) and part.id in elapsed:
            return True
    return False


def _elapsed_names(tree: ast.Module) -> set[str]:
    assigned = [node for node in ast.walk(tree) if isinstance(node, ast.Assign)]
    return {
        target.id
        for node in assigned
        if _is_elapsed(node.value, set())
        for target in node.targets
        if isinstance(target, ast.Name)
    }


def _limits_time(compare: ast.Compare, elapsed: set[str]) -> bool:
    operands = [compare.left, *compare.comparators]
    for left, operator, right in zip(operands, compare.ops, operands[1:], strict=False):
        smaller = {ast.Lt: left, ast.LtE: left, ast.Gt: right, ast.GtE: right}.get(type(operator))
        if smaller is not None and _is_elapsed(smaller, elapsed):
            return True
    return False


def test_no_test_has_a_limit_in_seconds() -> None:
    for path in sorted(TESTS.rglob("*.py")):
        tree = ast.parse(path.read_text())
        name = path.relative_to(TESTS).as_posix()
        found = [] if name == "waiting.py" else [*limits_in(tree)]
        if name not in COST_HELPERS:
            found += processor_times_in(tree)
        if name not in BESIDE and not name.startswith("torture/"):
            found += endless_waits_in(tree)
        assert found == [], f"tests/{name}: line and reason"


@pytest.mark.parametrize(
    "source",
    [
        "assert monotonic() - start < 5",
        "assert 5 >= time.monotonic() - start",
        "took = time.monotonic() - start\nassert took <= LIMIT_S",
        "assert 0.02 <= time.time() - started < BOUND_S",
        "process.wait(60)",
        "thread.join(timeout=5)",
        "subprocess.run(command, timeout=30)",
        "BOUND_S = 30.0",
        "from time import process_time",
        "time.perf_counter()",
        "usage.ru_utime",
        "with subprocess.Popen(words) as process: pass",
        "threading.Thread(target=serve).start()",
        "thread.join()",
        "process.communicate()",
    ],
)
def test_limits_are_found(source: str) -> None:
    tree = ast.parse(source)
    assert [*limits_in(tree), *processor_times_in(tree), *endless_waits_in(tree)]


@pytest.mark.parametrize(
    "source",
    [
        "assert monotonic() - start >= WAIT_S",
        "assert before_ns <= event.t_ns <= time.time_ns()",
        "process.wait(BOUND_S)",
        "process.communicate(timeout=BOUND_S)",
        "', '.join(words)",
        "session.wait(0.1)",
        "port = opened('rate=1', timeout=5)",
        "assert 1 < count",
    ],
)
def test_what_is_not_a_limit_is_not_found(source: str) -> None:
    tree = ast.parse(source)
    assert not [*limits_in(tree), *processor_times_in(tree), *endless_waits_in(tree)]
