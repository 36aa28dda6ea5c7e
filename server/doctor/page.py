"""The doctor's findings as a table that a terminal of 80 columns holds."""

from collections import Counter
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from asterism.server.doctor.finding import Finding, Verdict

STYLES = {Verdict.UNTOLD: "dim", Verdict.GOOD: "green", Verdict.LOOK: "yellow", Verdict.WRONG: "bold red"}


def table_of(findings: Sequence[Finding]) -> Table:
    """A row for every check: what was measured, and below it what to do."""
    table = Table(box=None, header_style="bold", padding=(0, 2, 0, 0))
    table.add_column("check", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    table.add_column("measured, and what to do")
    for found in findings:
        style = STYLES[found.verdict]
        told: RenderableType = Text(found.measured, "dim" if found.verdict == Verdict.UNTOLD else "")
        if found.advice:
            told = Group(told, Text(f"> {found.advice}", "bold" if found.verdict > Verdict.GOOD else "dim"))
        table.add_row(Text(found.check), Text(found.verdict.words, style), told)
    return table


def summary(findings: Sequence[Finding]) -> str:
    """How many of which, the worst first."""
    counts = Counter(found.verdict for found in findings)
    words = {Verdict.WRONG: "wrong", Verdict.LOOK: "to look at", Verdict.GOOD: "good", Verdict.UNTOLD: "cannot be told"}
    return ", ".join(f"{counts[verdict]} {words[verdict]}" for verdict in words if counts[verdict])
