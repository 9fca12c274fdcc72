"""The pages as a reader of Markdown sees them: code blocks, links, headings, inline code."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    str(p.relative_to(ROOT))
    for p in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"))
    if not {"_build", "_generated"} & set(p.parts)
)
_FRONT = re.compile(r"\A---\n.*?\n---\n", re.S)


class Block(NamedTuple):
    """A fenced block: its language as written, its text, the line it starts in."""

    language: str
    text: str
    line: int


@cache
def tokens(page: str) -> tuple[Token, ...]:
    """Parse a page; its front matter is blank lines, so that line numbers hold."""
    text = (ROOT / page).read_text(encoding="utf-8")
    text = _FRONT.sub(lambda m: "\n" * m.group().count("\n"), text)
    return tuple(MarkdownIt("commonmark").enable("table").parse(text))


def blocks(page: str) -> list[Block]:
    """Return the code blocks, those without a fence too (language "")."""
    found = []
    for token in tokens(page):
        if token.type in ("fence", "code_block"):
            assert token.map is not None
            found.append(Block(token.info.strip(), token.content, token.map[0] + 1))
    return found


def inline(page: str, kind: str) -> list[tuple[int, Token]]:
    """Return (line, token) of inline tokens: ``code_inline``, ``link_open``, ``image``."""
    return [
        (token.map[0] + 1, child)
        for token in tokens(page)
        if token.type == "inline" and token.map
        for child in token.children or ()
        if child.type == kind
    ]


@cache
def anchors(page: str) -> frozenset[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    found: list[str] = []
    all_tokens = tokens(page)
    for before, token in zip(all_tokens, all_tokens[1:], strict=False):
        if before.type == "heading_open":
            plain = "".join(c.content for c in token.children or () if c.content)
            slug = re.sub(r"[^\w\- ]", "", plain.strip().lower()).replace(" ", "-")
            same = sum(re.fullmatch(re.escape(slug) + r"(-\d+)?", f) is not None for f in found)
            found.append(f"{slug}-{same}" if same else slug)
    return frozenset(found)
