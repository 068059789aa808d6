"""Tables on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from benchmarks.results import Results
from benchmarks.summary import Cell, Summary, cells, rows_by_method


def print_results(results: Results, console: Console) -> None:
    """Every method in every cell, then the methods' settings."""
    found = cells(results)
    for group in dict.fromkeys(cell.group for cell in found):
        console.print(_group_table(results, group, [cell for cell in found if cell.group == group]))
    for method, settings in results.methods.items():
        console.print(f"[bold]{method}[/]: {_in_words(settings)}", soft_wrap=True, highlight=False)
    for line in results.absent:
        console.print(f"[yellow]{line}[/]")


def _group_table(results: Results, group: str, found: list[Cell]) -> Table:
    table = Table(title=f"{results.benchmark}, {group}", title_justify="left")
    for name in ("turn", "column", "method"):
        table.add_column(name, no_wrap=True)
    for name in (
        "pairs",
        "rot. mean°",
        "median°",
        "std°",
        "<5°",
        "<1°",
        "‖log‖",
        "trans.",
        "centroid",
        "ADD-S ok",
        "s/pair",
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for cell in found:
        for method, rows in rows_by_method(results, cell).items():
            table.add_row(cell.turn, cell.column, method, *_figures(Summary.of(rows)))
        table.add_section()
    return table


def _figures(summary: Summary) -> list[str]:
    return [
        str(summary.pairs),
        f"{summary.rotation_mean:.2f}",
        f"{summary.rotation_median:.2f}",
        f"{summary.rotation_std:.2f}",
        percent(summary.below_5),
        percent(summary.below_1),
        f"{summary.se3_log_mean:.3f}",
        f"{summary.translation_mean:.4f}",
        f"{summary.centroid_mean:.4f}",
        percent(summary.adds_success),
        seconds(summary.seconds_median),
    ]


def percent(share: float | None) -> str:
    """A share as whole per cent, one decimal close to all of it."""
    if share is None:
        return "–"
    return f"{100.0 * share:.1f} %" if 0.95 < share < 1.0 else f"{100.0 * share:.0f} %"


def seconds(value: float | None) -> str:
    """Three decimals, or a dash where nobody measured."""
    return "–" if value is None else f"{value:.3f}"


def _in_words(settings: dict[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in settings.items()) or "no settings"
