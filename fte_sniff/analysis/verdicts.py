"""Verdicts of rules about rows: pass, fail, or not covered."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self

import numpy as np

from fte_sniff.analysis.dataframe import row_frame
from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.feed import BaudChange
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.findings import Finding
from fte_sniff.analysis.measures import RowPosition, Rule
from fte_sniff.analysis.model import RowModel
from fte_sniff.analysis.tally import RowCount
from fte_sniff.protocol import Gap, GapKind, PortEvent
from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.rows import NO_TIME, Bools, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role


class RuleResult(StrEnum):
    """The result of a rule."""

    PASS = "pass"
    FAIL = "fail"
    NOT_COVERED = "not covered"
    """The rows that the measure needs did not come."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a rule found."""

    rule: Rule
    value: float | None
    """The measure, in the rule's unit; None if not covered, and for a failed rate in no time."""
    result: RuleResult
    row: RowPosition | None = None
    """The first row that violates a failed rule, if one row can show it."""
    needs: str = ""
    """What the measure needs to have a value, if the rows lack it."""
    filter: str = ""
    """A filter for rows as the one that is shown; empty for all."""
    finding: Finding | None = None
    """The best finding that a failed rule counts."""

    @property
    def refuses(self) -> bool:
        """Whether the check does not succeed because of this rule."""
        if self.result is RuleResult.NOT_COVERED:
            return not self.rule.may_be_uncovered
        return self.result is RuleResult.FAIL


def _needs_facts(rule: Rule) -> bool:
    """Whether it reads a column that depends on other rows."""
    text = rule.filter_text
    return rule.argument in DERIVED or (text is not None and RowFilter.parse(text).needs_facts)


def _filter_of(conditions: Sequence[str], row: RowPosition | None) -> str:
    """The filter for rows as the one that violates a rule."""
    parts = dict.fromkeys(filter(None, conditions))
    if parts and row is not None and row.motor is not None:
        parts[f"{NAME_OF_ROLE[Role.MOTOR]} = {row.motor}"] = None
    if row is not None and row.t_ns == NO_TIME:
        parts[f"offset = {row.offset}"] = None
    if len(parts) == 1:
        return next(iter(parts))
    return " AND ".join(
        f"({part})" if re.search(r"\bor\b", part, re.IGNORECASE) else part for part in parts
    )


class RuleCheck(RowModel):
    """Measures consecutive rows and judges rules about them."""

    def __init__(self, rules: Sequence[Rule]) -> None:
        self.rules = rules
        self.total = RowCount()
        self.unseen = 0
        """Rows that a view was too slow to receive: what they would change is not known."""
        self._measures = [rule.kind.make(rule) for rule in rules]
        self._filters: dict[str, RowFilter] = {}
        self._names: frozenset[str] = frozenset()
        self._facts = Facts() if any(map(_needs_facts, rules)) else None

    def __getstate__(self) -> Mapping[str, Any]:
        """Everything but the compiled filters."""
        return {**self.__dict__, "_filters": {}, "_names": frozenset()}

    def begin(self, name: str) -> None:
        """Start the next input."""
        for measure in self._measures:
            measure.begin(name)

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        if isinstance(change, Gap):
            self._settle(change)
            if change.kind is GapKind.NOT_SHOWN:
                self.unseen += change.rows or 0
            for measure in self._measures:
                measure.interrupt(change)

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""
        for measure in self._measures:
            measure.observe_events(events)

    def _observe(self, rows: Rows) -> None:
        self.total.observe(rows)
        self._measure(rows if self._facts is None else self._facts.feed(rows))

    def _settle(self, gap: Gap | None = None) -> None:
        """Measure the rows that wait for their facts, at a gap or at the end."""
        if self._facts is not None:
            self._measure(self._facts.interrupt(gap))

    def _measure(self, rows: Rows) -> None:
        if not len(rows):
            return
        masks = self._masks(rows)
        for rule, measure in zip(self.rules, self._measures, strict=True):
            measure.observe(rows, masks[rule.filter_text])

    def _masks(self, rows: Rows) -> dict[str | None, Bools]:
        if not self._filters:
            texts = {rule.filter_text for rule in self.rules if rule.filter_text is not None}
            self._filters = {text: RowFilter.parse(text) for text in texts}
            self._names = frozenset().union(*(one.names for one in self._filters.values()))
        masks: dict[str | None, Bools] = {None: np.ones(len(rows), np.bool_)}
        if self._filters:
            frame = row_frame(rows, self._names or ("offset",))
            masks |= {text: one.mask(frame).to_numpy() for text, one in self._filters.items()}
        return masks

    def merge(self, later: Self) -> None:
        """Add the rows that follow, as if they had been observed here."""
        self._settle()
        later._settle()
        self.unseen += later.unseen
        self.total.merge(later.total)
        for measure, other in zip(self._measures, later._measures, strict=True):
            measure.merge(other)

    def verdicts(self) -> list[Verdict]:
        """By rule, in their order; commands that still wait for an answer are not decided."""
        self._settle()
        found = []
        for rule, measure in zip(self.rules, self._measures, strict=True):
            value = None if self.unseen else measure.value(self.total)
            if value is None:
                needs = "" if self.unseen else self._needs(rule)
                found.append(Verdict(rule, None, self._without_value(rule), None, needs))
            elif rule.holds(value):
                found.append(Verdict(rule, value, RuleResult.PASS))
            else:
                row = measure.row
                shown = _filter_of(measure.conditions(), row)
                finding = measure.finding()
                found.append(Verdict(rule, value, RuleResult.FAIL, row, "", shown, finding))
        return found

    def _without_value(self, rule: Rule) -> RuleResult:
        """Rows in no time have no rate: the rule fails with every comparison."""
        covered = self.total.rows and not self.unseen
        fails = covered and rule.kind.covered_by_any_row
        return RuleResult.FAIL if fails else RuleResult.NOT_COVERED

    def _needs(self, rule: Rule) -> str:
        if not self.total.rows:
            return "a row"
        if rule.kind.is_timed and self.total.first_ns is None:
            return f"{rule.kind.needs}; no row has a time, try --start"
        return rule.kind.needs
