"""The part of YAML that calibration tools write, read without a library: tables, lists, numbers, words.

In: text.  Out: dicts, lists, floats, ints, strings, booleans, None.
OpenCV begins its files with `%YAML:1.0`, which no YAML library takes for a directive, and marks matrices by a tag; Kalibr and ROS
write plain block tables with lists in brackets.  Anchors, merged keys and block texts (`|`, `>`) are refused with their line.
Source: the YAML 1.2 specification, chapters 6 to 8, as far as the above goes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from stereorelight.errors import RigError

NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?")
WORDS: dict[str, Any] = {
    "true": True,
    "false": False,
    "null": None,
    "~": None,
    "": None,
    ".nan": float("nan"),
    ".inf": float("inf"),
    "-.inf": -float("inf"),
}
KEY = re.compile(r"""("[^"]*"|'[^']*'|[^\s"'\[\]{},#&*!|>%@`-][^:\[\]{},]*?|-[^\s:][^:\[\]{},]*?)\s*:(?:\s+(.*))?""")
TAG = re.compile(r"!\S*\s*")


@dataclass(frozen=True)
class _Line:
    number: int
    indent: int
    text: str


def _without_comment(line: str) -> str:
    quote = ""
    for i, c in enumerate(line):
        if quote:
            quote = "" if c == quote else quote
        elif c in "\"'" and (i == 0 or line[i - 1] in " [{,:"):
            quote = c
        elif c == "#" and (i == 0 or line[i - 1].isspace()):
            return line[:i]
    return line


def _depth(text: str) -> int:
    """How many brackets stand open at the end of `text`."""
    plain = re.sub(r""""[^"]*"|'[^']*'""", "", text)
    return sum(plain.count(c) for c in "[{") - sum(plain.count(c) for c in "]}")


def _lines(text: str) -> list[_Line]:
    """Lines that say something, each bracketed list on one of them."""
    out: list[_Line] = []
    open_depth = 0
    for number, raw in enumerate(text.lstrip("\ufeff").splitlines(), start=1):
        line = _without_comment(raw).rstrip()
        if not line.strip() or (open_depth == 0 and (line.startswith("%") or line in ("---", "..."))):
            continue
        if open_depth > 0:
            out[-1] = _Line(out[-1].number, out[-1].indent, f"{out[-1].text} {line.strip()}")
            open_depth += _depth(line)
            continue
        body = line.lstrip(" ")
        if body.startswith("\t"):
            raise RigError(f"line {number}: a tab in the indentation; YAML wants spaces")
        out.append(_Line(number, len(line) - len(body), body))
        open_depth = _depth(body)
    if open_depth > 0:
        raise RigError(f"line {out[-1].number}: a bracket is opened and never closed; is the file cut short?")
    return out


def _scalar(word: str) -> Any:
    if word.lower() in WORDS:
        return WORDS[word.lower()]
    if NUMBER.fullmatch(word):
        return int(word) if re.fullmatch(r"[-+]?\d{1,300}", word) else float(word)
    return word


class _Flow:
    """A value within one line: a bracketed list or table, a quoted text, a bare word."""

    def __init__(self, text: str, line: int) -> None:
        self.text, self.at, self.line = text, 0, line

    def fail(self) -> RigError:
        return RigError(f"line {self.line}: {self.text[self.at : self.at + 20].strip()!r} is not understood here")

    def space(self) -> str:
        while self.at < len(self.text) and self.text[self.at].isspace():
            self.at += 1
        return self.text[self.at : self.at + 1]

    def value(self, *, inside: bool) -> Any:
        c = self.space()
        if c == "!":
            found = TAG.match(self.text, self.at)
            self.at = found.end() if found else len(self.text)
            return self.value(inside=inside)
        if c == "[":
            return self.items("]")
        if c == "{":
            return dict(self.items("}"))
        if c and c in "\"'":
            end = self.text.find(c, self.at + 1)
            if end < 0:
                raise self.fail()
            word, self.at = self.text[self.at + 1 : end], end + 1
            return word
        if c and c in "&*|>":
            raise self.fail()
        start = self.at
        while self.at < len(self.text) and not (inside and (self.text[self.at] in ",]}" or re.match(r":(\s|$)", self.text[self.at :]))):
            self.at += 1
        return _scalar(self.text[start : self.at].strip())

    def items(self, end: str) -> list[Any]:
        self.at += 1
        out: list[Any] = []
        while True:
            if self.space() == end:
                self.at += 1
                return out
            item = self.value(inside=True)
            if end == "}":
                if self.space() != ":":
                    raise self.fail()
                self.at += 1
                item = (str(item), self.value(inside=True))
            out.append(item)
            c = self.space()
            if c == ",":
                self.at += 1
            elif c != end:
                raise self.fail()


def _flow(text: str, line: int) -> Any:
    flow = _Flow(text, line)
    value = flow.value(inside=False)
    if flow.space():
        raise flow.fail()
    return value


def _block(lines: list[_Line], i: int) -> tuple[Any, int]:
    """The table or list that begins at line `i`, and the line after it."""
    indent = lines[i].indent
    if lines[i].text == "-" or lines[i].text.startswith("- "):
        items: list[Any] = []
        while i < len(lines) and lines[i].indent == indent and (lines[i].text == "-" or lines[i].text.startswith("- ")):
            rest = lines[i].text[1:].lstrip(" ")
            if not rest:
                item, i = _nested(lines, i + 1, indent)
            elif KEY.fullmatch(rest) or rest.startswith("- "):
                lines[i] = _Line(lines[i].number, indent + len(lines[i].text) - len(rest), rest)
                item, i = _block(lines, i)
            else:
                item, i = _flow(rest, lines[i].number), i + 1
            items.append(item)
        return items, i
    table: dict[str, Any] = {}
    while i < len(lines) and lines[i].indent == indent:
        found = KEY.fullmatch(lines[i].text)
        if found is None:
            raise RigError(f"line {lines[i].number}: {lines[i].text[:30]!r} is not understood; wanted 'key: value'")
        key, rest = found[1].strip("\"'"), TAG.sub("", found[2] or "", count=1) if (found[2] or "").startswith("!") else found[2] or ""
        if rest:
            table[key], i = _flow(rest, lines[i].number), i + 1
        else:
            table[key], i = _nested(lines, i + 1, indent)
    return table, i


def _nested(lines: list[_Line], i: int, indent: int) -> tuple[Any, int]:
    """What hangs below a key at `indent`: a deeper block, a list beside the key, or nothing."""
    if i < len(lines) and (lines[i].indent > indent or (lines[i].indent == indent and lines[i].text.startswith("- "))):
        return _block(lines, i)
    return None, i


def parse_yaml(text: str) -> Any:
    """What `text` says.  Raises RigError with the line that is not understood."""
    lines = _lines(text)
    if not lines:
        return None
    try:
        if len(lines) == 1 and lines[0].text[0] in "[{":
            return _flow(lines[0].text, lines[0].number)
        value, end = _block(lines, 0)
    except RecursionError:
        raise RigError("nested too deep for a calibration") from None
    if end < len(lines):
        raise RigError(f"line {lines[end].number}: the indentation fits nothing above it")
    return value
