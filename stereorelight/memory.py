"""Memory that is freed stays with the process, up to a bound, in place of going back to the system after each array.

A recovery of depth makes and drops some hundred arrays of a few megabytes.  glibc gives the end of its heap back whenever enough of it is
free, and each page comes back as a fault that clears it: a tenth of the time of a recovery, two in ten where several threads make arrays."""

from __future__ import annotations

import ctypes
import functools
import os
import sys

KEPT_BYTES = 512 << 20  # free memory that stays: what a recovery at 1920 x 1080 turns over
LARGEST_KEPT_BYTES = 32 << 20  # of one array; glibc allows no more, and larger ones go back as they always did
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's mallopt
OWN_SETTINGS = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "MALLOC_TOP_PAD_", "GLIBC_TUNABLES")


@functools.cache
def keep_freed() -> bool:
    """Tell the C library so, once.  Returns whether it did: not where it is another than glibc, or where the environment says otherwise."""
    if not sys.platform.startswith("linux") or any(name in os.environ for name in OWN_SETTINGS):
        return False
    try:
        library = ctypes.CDLL(None)
        library.gnu_get_libc_version  # noqa: B018  # only glibc has it
        mallopt = library.mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(_MMAP_THRESHOLD, LARGEST_KEPT_BYTES)) and bool(mallopt(_TRIM_THRESHOLD, KEPT_BYTES))
