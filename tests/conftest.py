"""What holds for every test: one hypothesis profile without deadlines, and one BLAS thread, as calibration has it."""

from __future__ import annotations

from hypothesis import settings
from threadpoolctl import threadpool_limits

settings.register_profile("stereorelight", deadline=None, max_examples=50)
settings.load_profile("stereorelight")
threadpool_limits(1, user_api="blas")
