"""One lock for every parallel kernel: two callers inside numba's `workqueue` threading layer abort the process."""

from __future__ import annotations

import threading

KERNEL_LOCK = threading.Lock()
