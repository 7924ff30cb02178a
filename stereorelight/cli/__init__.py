"""The command line: one file a command; `stereorelight.cli:main` is the door."""

from stereorelight.cli.group import main as main
