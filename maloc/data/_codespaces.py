"""One tag, two names: code spaces that Thelma and Innovasea call differently."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["SYNONYMS", "canonical", "same_tags"]

# Thelma Biotel's name: Innovasea's (both at 69 kHz). Source: actel's table of protocols.
SYNONYMS = {
    "R64K": "A69-1303",
    "S256": "A69-1105",
    "R256": "A69-1008",
    "R04K": "A69-1206",
    "R94K": "A69-1206",
}
OPEN = {"OPS": "OPs", "OPI": "OPi"}  # Open Protocol, in metadata in capitals


def canonical(tag: str) -> str:
    """Return a tag's id in Innovasea's terms: "R64K-345" is "A69-1303-345", "OPS-1" "OPs-1"."""
    space, dash, number = tag.rpartition("-")
    upper = space.upper().removesuffix("-69KHZ")
    known = SYNONYMS.get(upper) or OPEN.get(upper)
    return f"{known}{dash}{number}" if known else tag


def same_tags(tags: Iterable[str]) -> dict[str, str]:
    """Return {other name: name to use} of tags that are there under two names.

    Innovasea's name is used where it is one of them.
    """
    groups: dict[str, list[str]] = {}
    for tag in sorted(set(tags)):
        groups.setdefault(canonical(tag), []).append(tag)
    out = {}
    for names in groups.values():
        if len(names) > 1:
            best = next((n for n in names if canonical(n) == n), names[0])
            out |= {n: best for n in names if n != best}
    return out
