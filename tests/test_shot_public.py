"""The public names: each can be had, and what a type checker sees is what there is."""

from __future__ import annotations

import re
from pathlib import Path

import stereorelight


def test_every_public_name_is_there() -> None:
    for name in stereorelight.__all__:
        assert getattr(stereorelight, name) is not None


def test_the_type_checker_sees_the_same_names() -> None:
    text = Path(str(stereorelight.__file__)).read_text()
    told = {name: home for home, name in re.findall(r"from stereorelight\.([\w.]+) import (\w+) as \2", text)}
    assert told == stereorelight._HOME
