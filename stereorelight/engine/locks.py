"""One lock for every parallel numba kernel.

Two concurrent calls under numba's `workqueue` threading layer abort the process, so whoever starts a parallel kernel holds
`KERNEL_LOCK` while it runs; inside, the kernel takes every thread anyway."""

from __future__ import annotations

import threading

KERNEL_LOCK = threading.Lock()
