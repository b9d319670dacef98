"""The report's overview of parameters: symbols by joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..estimate.identified import Estimate


def matrix(listing: Mapping[str, Sequence[Estimate]]) -> list[tuple[str, str, list[Estimate | None]]]:
    """A row for each symbol: the symbol, its unit, and the estimate of each joint; None where a joint has none.

    Args:
        listing: Joint -> its estimates.
    """
    cells = {(item.symbol, joint): item for joint, items in listing.items() for item in items}
    rows = []
    for symbol in dict.fromkeys(symbol for symbol, _ in cells):
        mine = [cells.get((symbol, joint)) for joint in listing]
        rows.append((symbol, next((item.unit for item in mine if item and item.unit), ""), mine))
    return rows
